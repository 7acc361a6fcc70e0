# SPDX-License-Identifier: Apache-2.0
"""The topics and the storage files of a bag."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shlex import quote
from sqlite3 import Error as SqliteError
from sqlite3 import connect

from rosbags.interfaces import Connection, ConnectionExtRosbag2

from impact_observer.errors import BagError, UnfitBagError, UsageError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Quality

_STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}
_SUFFIXES = {".bag", ".mcap", ".db3", ".yaml", ".zstd"}
_FORMS = "a folder with metadata.yaml, a .mcap file or a .db3 file"
SOUND_FILES = (".wav", ".flac", ".ogg")
"""Suffixes of sounds."""
SIGNAL_FILES = (".csv", ".txt", ".tsv", ".dat", ".lvm", *SOUND_FILES)
"""Suffixes of tables and sounds, of which commands make bags."""


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic of a bag.

    Attributes:
        name: the absolute name.
        type: the message type; several joined by `` and `` when publishers disagreed.
        count: messages.
        quality: the quality of service that was offered; None when the bag does not have it.
        definition: the text of the message type; empty when the bag does not have it.
    """

    name: str
    type: str
    count: int
    quality: Quality | None
    definition: str


def storage_of(path: Path) -> str:
    """``mcap`` or ``sqlite3``, by the files at ``path``.

    Raises:
        UsageError: there is nothing.
        BagError: there is no bag.
    """
    if not path.exists():
        raise UsageError(f"{path}: does not exist; expected a bag: {_FORMS}")
    if path.is_dir():
        inside = sorted(file for file in path.iterdir() if file.suffix in _STORAGES)
        if (path / "metadata.yaml").is_file():
            # A file that was compressed as a whole has two suffixes.
            suffixes = [each for file in path.iterdir() for each in file.suffixes]
            return next((_STORAGES[each] for each in suffixes if each in _STORAGES), "mcap")
        if any(file.suffix == ".mcap" for file in inside):
            return "mcap"  # whose recorder was killed
        hint = f"`{reindex_command(path)}` writes it; " if inside else ""
        kind = BagError if inside else UnfitBagError  # a bag that is damaged, or none
        raise kind(f"{path}: no metadata.yaml; {hint}expected a bag: {_FORMS}")
    if path.suffix not in _STORAGES:
        is_signal = path.suffix.lower() in SIGNAL_FILES
        remedy = (
            "`import` makes one of a table of impact times, `detect` of a signal"
            if is_signal
            else "export any other recording as CSV or WAV"
        )
        raise UnfitBagError(f"{path}: not a bag; expected {_FORMS}; {remedy}")
    return _STORAGES[path.suffix]


def bag_files(path: Path) -> list[Path]:
    """What may be a file of a bag by its name: in the folder of a bag, or the one file."""
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    return [each for each in inside if each.suffix in _SUFFIXES]


def views_in(file: Path) -> list[str]:
    """Names of the views in a database; none in a damaged one."""
    try:
        with closing(connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)) as database:
            database.text_factory = partial(str, encoding="utf-8", errors="replace")
            found = database.execute("SELECT name FROM sqlite_master WHERE type='view'")
            return [str(name) for (name,) in found]
    except (SqliteError, UnicodeDecodeError):  # also of its own error, with a damaged name
        return []


def topic_info(topic: str, connections: Sequence[Connection]) -> TopicInfo:
    """A topic with all its connections."""
    offers = [
        Quality.recorded(qos, interfaces.usual_quality(topic).depth)
        for connection in connections
        if isinstance(connection.ext, ConnectionExtRosbag2)
        for qos in connection.ext.offered_qos_profiles
    ]
    return TopicInfo(
        name=topic,
        type=" and ".join(sorted({connection.msgtype for connection in connections})),
        count=sum(connection.msgcount for connection in connections),
        quality=Quality.common(offers) if offers else None,
        definition=connections[0].msgdef.data,
    )


def recover_command(path: Path) -> str:
    """The command that writes what is left of a damaged file to a new one.

    Args:
        path: the file, or the folder of a bag.
    """
    files = sorted(path.glob("*.db3")) + sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    file = quote(str(files[0])) if len(files) == 1 else "FILE"
    if any(each.suffix == ".db3" for each in files):
        return f"sqlite3 {file} .recover | sqlite3 NEW.db3"
    return f"mcap recover {file} -o NEW.mcap"


def reindex_command(path: Path) -> str:
    """The command that writes the metadata.yaml of the bag at ``path`` anew."""
    return f"ros2 bag reindex {quote(str(path))}"
