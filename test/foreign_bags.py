# SPDX-License-Identifier: Apache-2.0
"""The same messages as recorders of other distributions of ROS 2 store them.

Layouts are those of rosbag2's own sources: metadata of version 5 with quality of service as a
text of numbers (Humble), of version 9 with names (Jazzy, Kilted); sqlite3 without message
definitions (schema 3, Humble) and with them (schema 4).
"""

import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from mcap.writer import CompressionType
from mcap.writer import Writer as McapFileWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from impact_observer.io import BagReader
from impact_observer.io.typestores import typestore

TOPICS = ("/a", "/b", "/c")
TIMES = ("deadline", "lifespan", "liveliness_lease_duration")
HUMBLE_QOS = "\n".join(
    [
        "- history: 3",
        "  depth: 0",
        "  reliability: 1",
        "  durability: 2",
        *(f"  {key}:\n    sec: 9223372036\n    nsec: 854775807" for key in TIMES[:2]),
        "  liveliness: 1",
        f"  {TIMES[2]}:\n    sec: 9223372036\n    nsec: 854775807",
        "  avoid_ros_namespace_conventions: false",
    ]
)
"""As ``ros2 bag record`` of Humble writes it: history unknown, reliable, volatile."""
JAZZY_QOS = (
    HUMBLE_QOS.replace("history: 3", "history: unknown")
    .replace("reliability: 1", "reliability: reliable")
    .replace("durability: 2", "durability: volatile")
    .replace("liveliness: 1", "liveliness: automatic")
)


def metadata(reader: BagReader, file: str, storage: str, *, distro: str) -> str:
    """The text of ``metadata.yaml``, written by hand."""
    old = distro == "humble"
    topics = ""
    for info in reader.topics.values():
        qos = (
            json.dumps(HUMBLE_QOS)
            if old
            else "\n          " + JAZZY_QOS.replace("\n", "\n          ")
        )
        topics += (
            "    - topic_metadata:\n"
            f"        name: {info.name}\n"
            f"        type: {info.type}\n"
            "        serialization_format: cdr\n"
            f"        offered_qos_profiles: {qos}\n"
            + ("" if old else "        type_description_hash: ''\n")
            + f"      message_count: {info.count}\n"
        )
    start, length = reader.start, reader.end - reader.start
    return (
        "rosbag2_bagfile_information:\n"
        f"  version: {5 if old else 9}\n"
        f"  storage_identifier: {storage}\n"
        f"  duration:\n    nanoseconds: {length}\n"
        f"  starting_time:\n    nanoseconds_since_epoch: {start}\n"
        f"  message_count: {reader.message_count}\n"
        f"  topics_with_message_count:\n{topics}"
        "  compression_format: ''\n  compression_mode: ''\n"
        f"  relative_file_paths:\n    - {file}\n"
        f"  files:\n    - path: {file}\n"
        f"      starting_time:\n        nanoseconds_since_epoch: {start}\n"
        f"      duration:\n        nanoseconds: {length}\n"
        f"      message_count: {reader.message_count}\n"
        + ("" if old else f"  custom_data: ~\n  ros_distro: {distro}\n")
    )


def humble_sqlite(source: Path, path: Path) -> Path:
    """A folder as Humble's default recorder makes it: sqlite3 without message definitions."""
    path.mkdir()
    file = f"{path.name}_0.db3"
    with BagReader(source) as reader:
        database = sqlite3.connect(path / file)
        database.executescript(
            "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);"
            "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL,"
            " metadata TEXT NOT NULL);"
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
            " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
            " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
            "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
            "INSERT INTO schema VALUES (3, 'humble');"
        )
        numbers = {}
        for number, info in enumerate(reader.topics.values(), start=1):
            numbers[info.name] = number
            database.execute(
                "INSERT INTO topics VALUES (?, ?, ?, 'cdr', ?)",
                (number, info.name, info.type, HUMBLE_QOS),
            )
        database.executemany(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
            ((numbers[topic], log_time, data) for topic, log_time, data in reader.raw()),
        )
        database.commit()
        database.close()
        (path / "metadata.yaml").write_text(metadata(reader, file, "sqlite3", distro="humble"))
    return path


def converted(source: Path, path: Path) -> Path:
    """A folder as ``ros2 bag convert`` of Humble makes it: qualities in metadata.yaml alone."""
    with closing(sqlite3.connect(bare(humble_sqlite(source, path)))) as database:
        database.execute("UPDATE topics SET offered_qos_profiles = ''")
        database.commit()
    return path


def mcap_folder(
    source: Path, path: Path, *, distro: str, compression: str = "", chunk: int = 4096
) -> Path:
    """A folder with MCAP as the recorder of a distribution makes it."""
    path.mkdir()
    file = f"{path.name}_0.mcap"
    kinds = {"": CompressionType.NONE, "zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4}
    with BagReader(source) as reader, (path / file).open("wb") as stream:
        writer = McapFileWriter(stream, chunk_size=chunk, compression=kinds[compression])
        writer.start(profile="ros2", library="libmcap 1.1.0")
        channels = {}
        for info in reader.topics.values():
            definition, _ = typestore().generate_msgdef(info.type, ros_version=2)
            schema = writer.register_schema(info.type, "ros2msg", definition.encode())
            qos = HUMBLE_QOS if distro == "humble" else JAZZY_QOS
            channels[info.name] = writer.register_channel(
                info.name, "cdr", schema, {"offered_qos_profiles": qos}
            )
        for topic, log_time, data in reader.raw():
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()  # type: ignore[no-untyped-call]
        (path / "metadata.yaml").write_text(metadata(reader, file, "mcap", distro=distro))
    return path


def rewritten(
    source: Path, path: Path, plugin: StoragePlugin, mode: CompressionMode = CompressionMode.NONE
) -> Path:
    """The folder that ``rosbags`` makes, compressed as a whole, by message, or not at all."""
    writer = Writer(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with BagReader(source) as reader, writer:
        connections = {
            info.name: writer.add_connection(
                info.name,
                info.type,
                typestore=typestore(),
                offered_qos_profiles=[info.quality.offered()] if info.quality else [],
            )
            for info in reader.topics.values()
        }
        for topic, log_time, data in reader.raw():
            writer.write(connections[topic], log_time, data)
    return path


def bare(path: Path) -> Path:
    """The storage file inside a folder."""
    return next(each for each in path.iterdir() if each.suffix in {".mcap", ".db3"})


FORMS: dict[str, Callable[[Path, Path], Path]] = {
    "humble_sqlite3": humble_sqlite,
    "humble_converted_sqlite3": converted,
    "humble_sqlite3_bare": lambda source, path: bare(humble_sqlite(source, path)),
    "humble_mcap_lz4": lambda s, p: mcap_folder(s, p, distro="humble", compression="lz4"),
    "jazzy_mcap": lambda s, p: mcap_folder(s, p, distro="jazzy"),
    "jazzy_mcap_zstd": lambda s, p: mcap_folder(s, p, distro="jazzy", compression="zstd"),
    "kilted_mcap_bare": lambda s, p: bare(mcap_folder(s, p, distro="kilted", compression="zstd")),
    "sqlite3": lambda s, p: rewritten(s, p, StoragePlugin.SQLITE3),
    "sqlite3_bare": lambda s, p: bare(rewritten(s, p, StoragePlugin.SQLITE3)),
    "sqlite3_file": lambda s, p: rewritten(s, p, StoragePlugin.SQLITE3, CompressionMode.FILE),
    "sqlite3_message": lambda s, p: rewritten(
        s, p, StoragePlugin.SQLITE3, CompressionMode.MESSAGE
    ),
    "mcap_storage": lambda s, p: rewritten(s, p, StoragePlugin.MCAP, CompressionMode.STORAGE),
    "mcap_message": lambda s, p: rewritten(s, p, StoragePlugin.MCAP, CompressionMode.MESSAGE),
    "mcap_file": lambda s, p: rewritten(s, p, StoragePlugin.MCAP, CompressionMode.FILE),
}
"""How to make each form of a bag."""
