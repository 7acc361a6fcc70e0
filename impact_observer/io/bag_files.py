# SPDX-License-Identifier: Apache-2.0
"""The files of a bag: which there are, and MCAP files without an end, of a killed recorder."""

from collections.abc import Iterable
from contextlib import closing, suppress
from functools import partial
from io import BufferedReader, FileIO
from pathlib import Path
from shlex import quote
from sqlite3 import Error as SqliteError
from sqlite3 import connect

from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader
from mcap.stream_reader import MAGIC_SIZE
from mcap.writer import Writer

from impact_observer.errors import BagError, UnfitBagError, UsageError
from impact_observer.input_files import check_input, open_input
from impact_observer.model.yaml_text import load_yaml
from impact_observer.resources import read_text

_STORAGES = {".mcap": "mcap", ".db3": "sqlite3"}
_SUFFIXES = {".bag", ".mcap", ".db3", ".yaml", ".zstd"}
_FORMS = "a folder with metadata.yaml, a .mcap file or a .db3 file"
FROM_ROS_1 = "messages of ROS 1: `rosbags-convert --src OLD.bag --dst NEW`"
"""The remedy for a bag of ROS 1."""
SOUND_FILES = (".wav", ".flac", ".ogg")
"""Suffixes of sounds."""
SIGNAL_FILES = (".csv", ".txt", ".tsv", ".dat", ".lvm", *SOUND_FILES)
"""Suffixes of tables and sounds, of which commands make bags."""
_CONVERTED = (".m4a", ".mp3", ".aac", ".mp4", ".mov", ".wma", ".opus")
"""Suffixes of sounds and films that another program makes a WAV of."""
_MOST_NESTED = 1000
"""Brackets, and letters of a line, up to which metadata cannot be nested too deeply."""


def storage_of(path: Path) -> str:
    """``mcap`` or ``sqlite3``, by the files at ``path``.

    Raises:
        UsageError: there is nothing.
        BagError: there is no bag.
    """
    if not path.exists():
        raise UsageError(f"{path}: does not exist; expected a bag: {_FORMS}")
    if not path.is_dir():
        if path.suffix in _STORAGES:
            return _STORAGES[path.suffix]
        remedy = "`import` makes one of a table of times, `detect` of a signal, as CSV or WAV"
        if path.suffix == ".bag":
            remedy = FROM_ROS_1
        elif path.suffix.lower() in _CONVERTED:
            remedy = f"`ffmpeg -i {quote(str(path))} NEW.wav` makes a sound that `fit` reads"
        elif path.suffix in (".yaml", ".yml"):
            remedy = "the recording stands first, a model after it"
        raise UnfitBagError(f"{path}: not a bag; expected {_FORMS}; {remedy}")
    # A file that was compressed as a whole has two suffixes.
    suffixes = {each for file in path.iterdir() for each in file.suffixes}
    if ".mcap" in suffixes:  # also without metadata.yaml: the recorder was killed
        return "mcap"
    if (path / "metadata.yaml").is_file():
        return "sqlite3" if ".db3" in suffixes else "mcap"
    if ".db3" in suffixes:
        raise BagError(f"{path}: no metadata.yaml; `{reindex_command(path)}` writes it")
    raise UnfitBagError(f"{path}: no metadata.yaml; expected a bag: {_FORMS}")


def checked_files(path: Path) -> list[Path]:
    """The files of a bag, with its metadata, after checks that the libraries lack.

    Raises:
        UsageError: one of them is no regular file.
        BagError: a database has a view, which may have no end.
        ModelError: the metadata are nested without an end; ``rosbags`` would end the process.
    """
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    files = [each for each in inside if each.suffix in _SUFFIXES]
    for file in files:
        check_input(file)
        if file.suffix == ".db3" and (views := _views_in(file)):
            found = f"{file.name} has a view {views[0]}; expected tables alone"
            raise BagError(f"{path}: cannot be read as a bag: {found}")
        if path.is_dir() and file.name == "metadata.yaml":
            text = read_text(file)
            longest = max(map(len, text.splitlines()), default=0)
            if "&" in text or max(text.count("[") + text.count("{"), longest) > _MOST_NESTED:
                load_yaml(text)
    return files


def _views_in(file: Path) -> list[str]:
    """Names of the views in a database; none in a damaged one."""
    try:
        with closing(connect(f"{file.absolute().as_uri()}?immutable=1", uri=True)) as database:
            database.text_factory = partial(str, encoding="utf-8", errors="replace")
            found = database.execute("SELECT name FROM sqlite_master WHERE type='view'")
            return [str(name) for (name,) in found]
    except (SqliteError, UnicodeDecodeError):  # also of its own error, with a damaged name
        return []


def recover_command(path: Path) -> str:
    """The command that writes what is left of a damaged file, or a file of a bag, to a new one."""
    inside = sorted(path.iterdir()) if path.is_dir() else [path]
    files = [each for each in inside if each.suffix in _STORAGES]
    file = quote(str(files[0])) if len(files) == 1 else "FILE"
    if files and files[0].suffix == ".db3":
        return f"sqlite3 {file} .recover | sqlite3 NEW.db3"
    return f"mcap recover {file} -o NEW.mcap"


def reindex_command(path: Path) -> str:
    """The command that writes the metadata.yaml of the bag at ``path`` anew."""
    return f"ros2 bag reindex {quote(str(path))}"


def has_end(file: Path) -> bool:
    """Whether an MCAP file ends as its writer ends it."""
    with open_input(file) as stream:
        first = stream.read(MAGIC_SIZE)
        stream.seek(max(stream.seek(0, 2) - MAGIC_SIZE, 0))
        return stream.read() == first


class _WholeReads(BufferedReader):
    """A file in which a read beyond the end is the end of all records."""

    def read(self, size: int | None = -1, /) -> bytes:
        """The next ``size`` bytes.

        Raises:
            EndOfFile: there are fewer.
        """
        data = super().read(size)
        if size is not None and len(data) < size:
            raise EndOfFile
        return data


def write_whole(files: Iterable[Path], output: Path) -> int:
    """Write the messages of MCAP files up to the last whole chunk to a file with an end.

    Returns:
        The number of messages.

    Raises:
        Exception: of the library ``mcap``, for a damaged file.
    """
    count, channels = 0, dict[tuple[str, str], int]()
    with output.open("xb") as target:
        writer = Writer(target)
        writer.start("ros2")
        for file in files:
            with _WholeReads(FileIO(file)) as source, suppress(EndOfFile):
                reader = NonSeekingReader(source, validate_crcs=True)
                for schema, channel, message in reader.iter_messages(log_time_order=False):
                    key = channel.topic, schema.name if schema else ""
                    if key not in channels:
                        number = schema and writer.register_schema(
                            schema.name, schema.encoding, schema.data
                        )
                        channels[key] = writer.register_channel(
                            channel.topic, channel.message_encoding, number or 0, channel.metadata
                        )
                    writer.add_message(
                        channels[key], message.log_time, message.data, message.publish_time
                    )
                    count += 1
        writer.finish()  # type: ignore[no-untyped-call]
    return count
