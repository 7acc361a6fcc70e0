# SPDX-License-Identifier: Apache-2.0
"""Files that commands write: never in place of another file, and never half.

Every command checks its outputs first, by :func:`check_outputs`, and writes each beside its place,
by :func:`replacing`.
"""

import errno
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from impact_observer.errors import ImpactObserverError, OutputError, UsageError
from impact_observer.input_files import shortened

PICTURES = (".png", ".svg", ".pdf")
"""What the name of a picture ends with."""
_OF_THE_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENODEV, errno.ESTALE}
_NO_TEMPORARY = "No usable temporary directory"
"""How Python begins to say that no disk takes a file."""


def check_output(path: Path, suffixes: Sequence[str] = PICTURES) -> None:
    """Raise unless a file can be written to ``path``; by default a picture.

    Args:
        path: the file.
        suffixes: what its name may end with; none for any.

    Raises:
        UsageError: ``path`` is no UTF-8 or has none of the ``suffixes``, its folder does not
            exist, or ``path`` is no regular file.
    """
    check_name(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise UsageError(f"{path}: expected a name that ends in {', '.join(suffixes)}")
    try:
        if not path.absolute().parent.is_dir():
            raise UsageError(
                f"{shortened(path)}: no folder {shortened(path.parent)}; make it first"
            )
        if path.is_dir():
            raise UsageError(f"{path}: is a folder; expected the name of a file")
        if path.exists() and not path.is_file():
            raise UsageError(f"{path}: is a device or a pipe; expected the name of a file")
    except UsageError:
        raise
    except (OSError, ValueError) as error:  # too long, a null byte
        raise unwritable(path, error) from None


def check_name(path: Path) -> None:
    """Raise UsageError if a path has no name, or one that is no UTF-8, as YAML and bags need."""
    if not path.name:
        raise UsageError(f"{path}: is a folder; expected a name in it")
    try:
        path.name.encode()
    except UnicodeEncodeError:
        raise UsageError(f"{path}: is not UTF-8; expected another name") from None


@contextmanager
def temporary_beside(path: Path) -> Iterator[Path]:
    """A name like that of ``path`` in a temporary folder beside ``path``.

    Raises:
        UsageError: no file may be made there.
        OutputError: the disk is full or gone.
    """
    try:
        folder = tempfile.TemporaryDirectory(dir=path.absolute().parent, prefix=".new")
    except OSError as error:
        raise unwritable(path, error) from None
    with folder as name:
        yield Path(name) / path.name


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary file beside ``path`` that replaces ``path`` if the block raises nothing.

    Raises:
        UsageError: ``path`` may not be written.
        OutputError: the disk is full or gone.
    """
    check_output(path, ())
    with temporary_beside(path) as temporary:
        try:
            yield temporary
            temporary.replace(path)
        except OSError as error:
            raise unwritable(path, error) from None


def check_outputs(outputs: Sequence[tuple[Path, Sequence[str]]]) -> None:
    """Raise unless all files are new and can be written; each has the suffixes that it may have.

    Raises:
        UsageError: as of :func:`check_output`, or a file exists, or two of the files are one.
    """
    named = set[Path]()
    for path, suffixes in outputs:
        if os.path.lexists(path):
            raise UsageError(f"{path}: exists already; remove it, or choose another name")
        check_output(path, suffixes)
        if path.resolve() in named:
            raise UsageError(f"{path}: named twice; choose another name for one of the files")
        named.add(path.resolve())


def unwritable(path: Path, error: Exception) -> ImpactObserverError:
    """The error for a file that cannot be written: of the disk, or of the name."""
    reason = str(getattr(error, "strerror", None) or error)
    is_disk = getattr(error, "errno", None) in _OF_THE_DISK or reason.startswith(_NO_TEMPORARY)
    kind = OutputError if is_disk else UsageError
    return kind(f"{shortened(path)}: cannot be written: {reason}")
