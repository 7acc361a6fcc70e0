# SPDX-License-Identifier: Apache-2.0
"""What is compiled: C++17 by pybind11, without theory; types are in ``_kernel.pyi``."""

from pathlib import Path

from impact_observer.errors import KernelError
from impact_observer.kernel.sources import checksum

try:
    import impact_observer.kernel._kernel as _compiled
except ModuleNotFoundError:
    raise KernelError("is not built") from None
if checksum(Path(__file__).parent) not in {_compiled.SOURCES, ""}:  # "": installed without them
    raise KernelError("was built from other sources")

from impact_observer.kernel._kernel import (  # another kernel may not have them
    FreeMotion,
    Gaps,
    Impact,
    Sensitivity,
    Sizes,
    falls_at,
    measured,
    sizes_by,
)

__all__ = [
    "FreeMotion",
    "Gaps",
    "Impact",
    "Sensitivity",
    "Sizes",
    "falls_at",
    "measured",
    "sizes_by",
]
