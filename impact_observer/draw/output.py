# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Names of files that can be written, without what writes them."""

from collections.abc import Sequence
from pathlib import Path

from impact_observer.errors import UsageError


def check_output(path: Path, suffixes: Sequence[str] = (".png", ".svg", ".pdf")) -> None:
    """Raise unless a file can be written to ``path``; by default a picture.

    Raises:
        UsageError: it has none of the ``suffixes``, its folder does not exist, or it is a folder.
    """
    if path.suffix.lower() not in suffixes:
        raise UsageError(f"{path}: expected a name that ends in {', '.join(suffixes)}")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: no folder {path.parent}; make it first")
    if path.is_dir():
        raise UsageError(f"{path}: is a folder; expected the name of a file")
