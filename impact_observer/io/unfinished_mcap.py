# SPDX-License-Identifier: Apache-2.0
"""MCAP files without an end, as a killed recorder leaves them."""

from collections.abc import Iterable
from contextlib import suppress
from io import BufferedReader, FileIO
from pathlib import Path

from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader
from mcap.stream_reader import MAGIC_SIZE
from mcap.writer import Writer

from impact_observer.input_files import open_input


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


def has_end(file: Path) -> bool:
    """Whether an MCAP file ends as its writer ends it."""
    with open_input(file) as stream:
        first = stream.read(MAGIC_SIZE)
        stream.seek(max(stream.seek(0, 2) - MAGIC_SIZE, 0))
        return stream.read() == first


def write_whole(files: Iterable[Path], output: Path) -> int:
    """Write the messages of MCAP files up to the last whole chunk to a file with an end.

    Returns:
        The number of messages.

    Raises:
        Exception: of the library ``mcap``, for a damaged file.
    """
    count = 0
    with output.open("xb") as target:
        writer = Writer(target)
        writer.start("ros2")
        channels = dict[tuple[str, str], int]()
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
