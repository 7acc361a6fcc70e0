# SPDX-License-Identifier: Apache-2.0
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
