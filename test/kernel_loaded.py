# SPDX-License-Identifier: Apache-2.0
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
