# SPDX-License-Identifier: Apache-2.0
"""Files that commands write: their names are checked first, and half a file is never left."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from impact_observer.errors import UsageError


def check_output(path: Path, suffixes: Sequence[str] = (".png", ".svg", ".pdf")) -> None:
    """Raise unless a file can be written to ``path``; by default a picture.

    Raises:
        UsageError: ``path`` has none of the ``suffixes``, its folder does not exist, or ``path``
            is a folder.
    """
    if path.suffix.lower() not in suffixes:
        raise UsageError(f"{path}: expected a name that ends in {', '.join(suffixes)}")
    if not path.absolute().parent.is_dir():
        raise UsageError(f"{path}: no folder {path.parent}; make it first")
    if path.is_dir():
        raise UsageError(f"{path}: is a folder; expected the name of a file")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside ``path`` that replaces ``path`` if the block raises nothing.

    Raises:
        UsageError: the file cannot be written.
    """
    target = path.resolve()
    try:
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=".new") as folder:
            temporary = Path(folder) / target.name
            yield temporary
            temporary.replace(target)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror or error}") from None
