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

"""The kernel of the file KERNEL_FILE in place of the installed one.

Imported before the package, as ``python -m pytest -p kernel_loaded`` does.
"""

import os
import sys
from importlib.util import module_from_spec, spec_from_file_location

NAME = "impact_observer.kernel._kernel"

_spec = spec_from_file_location(NAME, os.environ["KERNEL_FILE"])
assert _spec is not None
assert _spec.loader is not None
MODULE = module_from_spec(_spec)
_spec.loader.exec_module(MODULE)
sys.modules[NAME] = MODULE
