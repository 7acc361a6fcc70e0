# SPDX-License-Identifier: Apache-2.0
"""Files that commands and nodes read: regular ones only.

A device or a pipe may never end. Everything that opens a file of the user does so here, or checks
the file here before a library opens it.
"""

import os
import stat
from pathlib import Path
from typing import BinaryIO

from impact_observer.errors import UsageError

_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
_ENDLESS = (Path("/proc"), Path("/sys"))
"""Folders of files that the kernel makes while they are read."""


def check_input(path: Path) -> int:
    """Check that ``path`` is a regular file.

    Returns:
        The size in bytes.

    Raises:
        UsageError: there is no file, or something else.
    """
    try:
        found = path.stat()
    except (OSError, ValueError) as error:  # a name with a null byte is a ValueError
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{shortened(path)}: cannot be read: {reason}") from None
    kind = ""
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "no file")
    elif any(path.resolve().is_relative_to(folder) for folder in _ENDLESS):
        kind = "made by the kernel as it is read"
    if kind:
        raise UsageError(f"{path}: is {kind}; expected a regular file, whose end is known")
    return found.st_size


def open_input(path: Path) -> BinaryIO:
    """Open a regular file for reading bytes.

    Raises:
        UsageError: there is no file, or something else, or the file may not be read.
    """
    check_input(path)
    try:
        return path.open("rb")
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from None


def shortened(path: Path) -> str:
    """A path for an error line; of a long one the beginning and the end."""
    name = os.fspath(path)
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST // 2]}...{name[-_LONGEST // 2 :]}"


_LONGEST = 200
"""Most letters of a path in an error line."""
