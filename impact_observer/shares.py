"""Where the package's shared files lie: sample models, message texts, recorded bags."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from impact_observer.errors import UsageError

_SOURCE = Path(__file__).resolve().parent.parent


def _roots() -> Iterator[Path]:
    """The source tree first, then the prefixes ``ament`` and ``pip`` install to."""
    if (_SOURCE / "package.xml").is_file():
        yield _SOURCE
    for prefix in (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix):
        if prefix:
            yield Path(prefix) / "share" / "impact_observer"


def shared(relative: str) -> Path:
    """The shared file or folder ``relative``, such as ``config/two_mass.yaml``.

    Raises:
        UsageError: it is in none of the places where the package installs its files.
    """
    for root in _roots():
        if (path := root / relative).exists():
            return path
    raise UsageError(f"{relative}: not among the package's shared files; reinstall the package")
