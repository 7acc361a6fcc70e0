# SPDX-License-Identifier: Apache-2.0
"""What ``./dev soak`` does to files of other formats: sounds, matrices, databases, robots, tables.

Headers are drawn field by field, since a change of any one byte seldom passes the first check.
"""

import gzip
import random
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer

from benchmarks.soak_inputs import mutated
from impact_observer.check.bag_check import check_bag
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import BagReader, BagWriter, JointState
from impact_observer.io.messages import bag_messages
from impact_observer.io.signals import read_signal
from impact_observer.io.table_times import UNITS
from impact_observer.io.tables import SEPARATORS, TableForm
from impact_observer.io.typestores import typestore
from impact_observer.model import parse_model
from impact_observer.model.document import load_matrix
from impact_observer.resources import shared
from impact_observer.robots.pinocchio_model import pinocchio_model

Attack: TypeAlias = Callable[[random.Random], object]
"""Draws one input and gives it to what is attacked; what it raises is judged by the caller."""
S = 1_000_000_000
EPOCH = 5 * S
_LONG = (0, 1, 2, 3, 16, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1)
_SIDES = (0, 1, 2, -1, 2**31, 10**11)
_KINDS = ("<f8", ">f4", "|O", "<c16", "|S5", "<M8[s]", "[('a','<f8')]", "x", "|V0")
_BROKEN = ("{", "1", "[]*9", "{}", "(" * 99)
_COUNTS = ("2", "2", "0", "-1", "1e9", "99999999999", "x")
_TIMES = (
    *("0", "0.5", "1", "1e999999999", "1e-999999999", "nan", "9" * 400, "-1", "1,5", "0x1", ""),
    *("12:00:00", "99:99:99", "9" * 400 + ":00:00", "2024-02-30 1:2:3", "0000-00-00", "+1", "1_0"),
    *("2024-01-01T00:00:00+99:99", "1.1.2024", "\u0663", '"1', "'", "1e5", "1700000000", "1\0"),
)
_NAMES = (
    *("time", "t", "Time (ms)", "time [furlongs]", "frame", "date", "x", "x", "", "contact", "µs"),
    *("stamp_ns", "voltage", "99999999999 ms", "time(9999e9 s)", "(", "[]", "kind", "sequence"),
)


def write_two_mass(path: Path) -> None:
    """A bag of two_mass with five impacts and states."""
    make, names = bag_messages(), ("x1", "x2")
    with BagWriter(path) as writer:
        model = shared("config/two_mass.yaml").read_text("utf-8")
        writer.write("/plant/model", S, make.model(model))
        for k in range(1, 6):
            event = ImpactEvent(EPOCH + k * S, (Switch("stop"),), k, 0, EPOCH)
            writer.write("/impacts", event.stamp, make.event(event))
            state = JointState(event.stamp, names, np.zeros(2), np.ones(2))
            writer.write("/plant/joint_states", event.stamp, make.joint_state(state))


def sound(folder: Path) -> Attack:
    """A WAV whose header has any fields, or that is changed or cut anywhere."""
    file = folder / "sound.wav"

    def attack(draw: random.Random) -> object:
        order = draw.choice("<<<>")
        pick = partial(_field, draw)
        data = draw.randbytes(draw.choice((0, 1, 7, 64, 500)))
        kind, channels, bits = (draw.choice(each) for each in ((1, 1, 3), (1, 2, 8), (8, 16, 32)))
        frame = channels * bits // 8
        shape = struct.pack(
            f"{order}HHIIHH",
            pick((kind,), 16),
            pick((channels,), 16),
            pick((8000, 44100), 32),
            pick((8000 * frame,), 32),
            pick((frame,), 16),
            pick((bits,), 16),
        )
        shape += draw.randbytes(draw.choice((0, 0, 2, 24)))
        parts = [(b"fmt ", shape, pick((len(shape),), 32))]
        if draw.random() < 0.3:
            extra = draw.choice((b"ds64", b"LIST", b"fact", b"\0\0\0\0"))
            parts.append((extra, draw.randbytes(draw.choice((0, 4, 16, 28))), pick((4, 28), 32)))
        parts.append((b"data", data, pick((len(data),), 32)))
        if draw.random() < 0.1:
            draw.shuffle(parts)
        whole = b"".join(n + struct.pack(f"{order}I", size) + d for n, d, size in parts)
        magic = b"RIFF" if order == "<" else b"RIFX"
        text = magic + struct.pack(f"{order}I", pick((len(whole),), 32)) + b"WAVE" + whole
        if draw.random() < 0.3:
            text = text[: draw.randrange(len(text) + 1)]
        if draw.random() < 0.3:
            text = mutated(draw, text, [text])
        file.write_bytes(text)
        return read_signal(file).stamps.shape

    return attack


def matrix(folder: Path) -> Attack:
    """A matrix in a file of numpy or Matrix Market, packed or not."""

    def attack(draw: random.Random) -> object:
        name, data = draw.choice((_numpy, _numpy, _matrix_market))(draw)
        if draw.random() < 0.4:
            data = mutated(draw, data, [data])
        (folder / name).write_bytes(data)
        return load_matrix("mass", name, folder).shape

    return attack


def _numpy(draw: random.Random) -> tuple[str, bytes]:
    """Name and bytes of a file of numpy."""
    shape = tuple(draw.choice(_SIDES) for _ in range(draw.randrange(4)))
    header = {
        "descr": draw.choice(_KINDS),
        "fortran_order": draw.random() < 0.5,
        "shape": shape,
    }
    text = repr(header) if draw.random() < 0.8 else draw.choice(_BROKEN)
    line = text.encode() + b" " * draw.randrange(40) + b"\n"
    version = draw.choice((b"\1\0", b"\1\0", b"\2\0", b"\3\0", b"\4\0"))
    size = len(line) if draw.random() < 0.9 else _field(draw, (1,), 16)
    size_text = size.to_bytes(2 if version == b"\1\0" else 4, "little")
    return "m.npy", b"\x93NUMPY" + version + size_text + line + draw.randbytes(32)


def _matrix_market(draw: random.Random) -> tuple[str, bytes]:
    """Name and bytes of a Matrix Market file."""
    words = [
        draw.choice(("coordinate", "array", "vector")),
        draw.choice(("real", "integer", "complex", "pattern", "x")),
        draw.choice(("general", "symmetric", "hermitian")),
    ]
    lines = [f"%%MatrixMarket matrix {' '.join(words)}"]
    lines.append(" ".join(draw.choice(_COUNTS) for _ in range(3)))
    places = [(draw.randrange(4), draw.randrange(4)) for _ in range(2)]
    lines += [f"{row} {column} {draw.choice(_TIMES)}" for row, column in places]
    text = "\n".join(lines).encode()
    name = draw.choice(("m.mtx", "m.mtx.gz"))
    return name, gzip.compress(text) if name.endswith("gz") else text


def signal(folder: Path) -> Attack:
    """A table of a signal or of impacts, of any names, times, separators and options."""
    file = folder / "signal.csv"

    def attack(draw: random.Random) -> object:
        mark = draw.choice([*SEPARATORS.values(), ",", ","])
        count = draw.choice((1, 2, 2, 3, 5))
        rows = [[draw.choice(_NAMES) for _ in range(count)]] if draw.random() < 0.8 else []
        base = draw.random() < 0.7
        for k in range(draw.choice((0, 1, 3, 10, 30))):
            cells = [
                f"{0.01 * k:.6g}" if base and j == 0 else f"{draw.gauss(0, 1):.6g}"
                for j in range(count)
            ]
            if draw.random() < 0.1:
                cells[draw.randrange(count)] = draw.choice(_TIMES)
            rows.append(cells)
        text = "\n".join(mark.join(row) for row in rows) + draw.choice(("\n", ""))
        data = text.encode(draw.choice(("utf-8", "utf-8", "utf-16", "utf-8-sig")), "replace")
        if draw.random() < 0.4:
            data = mutated(draw, data, [data])
        file.write_bytes(data)
        form = TableForm(
            time_unit=draw.choice((None, None, *UNITS)),
            time_column=draw.choice((None, None, "x", "")),
            sort=draw.random() < 0.2,
            separator=draw.choice((None, None, *SEPARATORS)),
            decimal=draw.choice((None, None, "point", "comma")),
            skip_rows=draw.choice((0, 0, 1, 50)),
        )
        return read_signal(file, form, draw.choice((None, None, 1, 2**62))).stamps.shape

    return attack


def robot(folder: Path) -> Attack:
    """The URDF of a robot, or its model file."""
    model = shared("config/hammer_arm.yaml").read_bytes()
    urdf = shared("config/hammer_arm.urdf").read_bytes()

    def attack(draw: random.Random) -> object:
        texts = {"robot.yaml": model, "hammer_arm.urdf": urdf}
        name = draw.choice([*texts])
        texts[name] = mutated(draw, texts[name], [model, urdf])
        (folder / "hammer_arm.urdf").write_bytes(texts["hammer_arm.urdf"])
        text = texts["robot.yaml"].decode("utf-8", "replace")
        description = parse_model(text, "robot.yaml", folder).robot
        return description and pinocchio_model(description)

    return attack


def database(folder: Path) -> Attack:
    """An sqlite3 bag, its metadata or database changed: checked, read."""
    source, bag = folder / "source", folder / "bag"
    write_two_mass(source)
    with (
        BagReader(source) as reader,
        Writer(bag, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer,
    ):
        topics = {
            info.name: writer.add_connection(info.name, info.type, typestore=typestore())
            for info in reader.topics.values()
        }
        for topic, log_time, data in reader.raw():
            writer.write(topics[topic], log_time, data)
    seeds = {file: file.read_bytes() for file in bag.iterdir()}

    def attack(draw: random.Random) -> object:
        chosen = draw.choice([*seeds])
        for file, data in seeds.items():
            file.write_bytes(mutated(draw, data, [data]) if file == chosen else data)
        if draw.random() < 0.5:
            return check_bag(bag)
        with BagReader(bag) as reader:
            return sum(1 for _ in reader.raw())

    return attack


def _field(draw: random.Random, usual: tuple[int, ...], bits: int) -> int:
    """A usual number of a header, or now and then any other that its bits can hold."""
    number = draw.choice(usual) if draw.random() < 0.9 else draw.choice(_LONG)
    return number & ((1 << bits) - 1)
