# SPDX-License-Identifier: Apache-2.0
"""Paths of the package's shared files: sample models, message definitions, recorded bags."""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

from impact_observer.errors import UsageError
from impact_observer.input_files import check_input, shortened

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
        UsageError: no folder of the package's shared files has ``relative``.
    """
    for root in _roots():
        if (path := root / relative).exists():
            return path
    raise UsageError(f"{relative}: not among the package's shared files; reinstall the package")


MOST_BYTES = 10_000_000
"""Largest text file that is read as a whole: parsing a larger file takes minutes."""


def read_text(path: Path) -> str:
    """The text of a file.

    Raises:
        UsageError: the file is no regular one, no text, or too large.
    """
    if (size := check_input(path)) > MOST_BYTES:
        raise UsageError(
            f"{path}: {size / 1e6:.1f} MB found; expected at most {MOST_BYTES / 1e6:g} MB;"
            " write matrices as .npy files, and tables with fewer rows"
        )
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: cannot be read as text: {reason}") from None


def read_file_or_sample(source: str | Path, folder: str, wanted: str) -> tuple[Path, str]:
    """Path and text of a file, or of a sample in ``folder`` by its name; ``wanted`` is expected.

    Raises:
        UsageError: the file is missing, or no text.
    """
    path = Path(source)
    if not os.path.exists(path) or path.is_dir():  # noqa: PTH110 (false for a name that is too long)
        samples = shared(folder)
        known = {each.stem: each for each in sorted(samples.glob("*.yaml"))}
        if path.parent != Path() or path.name not in known:
            what = "a folder" if os.path.isdir(path) else "no such file"  # noqa: PTH112
            names = ", ".join(known)
            raise UsageError(f"{shortened(path)}: {what}; expected {wanted}: {names}")
        path = known[path.name]
    return path, read_text(path)
