# SPDX-License-Identifier: Apache-2.0
"""Files that are taken for bags of ROS 2 and are none: what they are, and what helps."""

from contextlib import closing
from functools import partial
from pathlib import Path
from shlex import quote
from sqlite3 import Error as SqliteError
from sqlite3 import connect
from typing import NamedTuple

from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from impact_observer.input_files import open_input

ROS_2 = "cdr"
"""Encoding of the messages of ROS 2."""
_ROS_1_BAG = b"#ROSBAG V"
_GIT_LFS_POINTER = b"version https://git-lfs.github.com/spec/v1"
_SUFFIXES = {".bag", ".mcap", ".db3", ".yaml", ".zstd"}


class ForeignFile(NamedTuple):
    """A file that is no bag of ROS 2.

    Attributes:
        found: what the file is.
        remedy: what makes a bag of it.
    """

    found: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.found}; {self.remedy}"


def foreign_file(path: Path) -> ForeignFile | None:
    """What is at ``path`` by its first bytes; None unless it is a ROS 1 bag or a Git LFS pointer.

    Args:
        path: a file, or a folder of which each file is looked at.
    """
    for file in _files(path):
        with open_input(file) as stream:
            first = stream.read(len(_GIT_LFS_POINTER))
        name = f"{file.name} " if file != path else ""
        if first.startswith(_GIT_LFS_POINTER):
            found = f"{name}is a pointer of Git LFS, not the file that it stands for"
            return ForeignFile(found, "`git lfs pull` brings the file")
        if first.startswith(_ROS_1_BAG):
            command = f"rosbags-convert --src {quote(str(file))} --dst NEW"
            return ForeignFile(f"{name}is a ROS 1 bag", f"`{command}` makes a ROS 2 bag of it")
    return None


def foreign_messages(path: Path) -> ForeignFile | None:
    """What the messages in a bag are if none is of ROS 2; None if some are, or unknown.

    Args:
        path: a file, or the folder of a bag.
    """
    encodings = encodings_at(path)
    if not encodings or ROS_2 in encodings:
        return None
    if "ros1" in encodings:
        command = "rosbags-convert --src OLD.bag --dst NEW"
        remedy = f"`{command}` makes a ROS 2 bag of the ROS 1 bag from which it was made"
        return ForeignFile("holds ROS 1 messages, expected those of ROS 2", remedy)
    found = f"holds {' and '.join(encodings)} messages, expected those of ROS 2 ({ROS_2})"
    remedy = "write them to a table (CSV), which `import` and `detect` read"
    return ForeignFile(found, remedy)


def encodings_at(path: Path) -> list[str]:
    """Encodings of the messages in a bag, as far as can be read, sorted: ``cdr`` of ROS 2.

    Args:
        path: a file, or the folder of a bag.
    """
    ways = {".mcap": _encodings_in_mcap, ".db3": _encodings_in_sqlite}
    files = [each for each in _files(path) if each.suffix in ways]
    return sorted({encoding for file in files for encoding in ways[file.suffix](file)})


def _encodings_in_sqlite(file: Path) -> set[str]:
    if first_view(file):
        return set()
    return {*_texts_in_sqlite(file, "SELECT DISTINCT serialization_format FROM topics")}


def first_view(file: Path) -> str:
    """The name of a view in the database of a bag, which may have no end; empty for none."""
    views = _texts_in_sqlite(file, "SELECT name FROM sqlite_master WHERE type='view'")
    return views[0] if views else ""


def _texts_in_sqlite(file: Path, query: str) -> list[str]:
    """The texts that a ``query`` of one column finds; none in a damaged database."""
    try:
        with closing(connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)) as database:
            database.text_factory = partial(str, encoding="utf-8", errors="replace")
            return [str(found) for (found,) in database.execute(query)]
    except (SqliteError, UnicodeDecodeError):  # also of its own error, with a damaged name
        return []


def _encodings_in_mcap(file: Path) -> set[str]:
    found: set[str] = set()
    with open_input(file) as stream:
        try:
            if (summary := make_reader(stream).get_summary()) is not None:
                found = {each.message_encoding for each in summary.channels.values()}
        except Exception:  # noqa: BLE001 (the library raises anything for a damaged file)
            stream.seek(0)
        if found:
            return found
        stream.seek(0)
        try:
            for each in StreamReader(stream).records:
                if isinstance(each, Channel):
                    found.add(each.message_encoding)
                elif isinstance(each, Message):
                    break
        except Exception:  # noqa: BLE001 (as above)
            return found
    return found


def bag_files(path: Path) -> list[Path]:
    """What may be a file of a bag by its name: in the folder of a bag, or the one file."""
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    return [each for each in inside if each.suffix in _SUFFIXES]


def _files(path: Path) -> list[Path]:
    return [each for each in bag_files(path) if each.is_file()]
