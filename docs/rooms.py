# SPDX-License-Identifier: Apache-2.0
"""The rooms of the package in their order: table and picture of docs/house.md, and its test."""

from typing import NamedTuple
from xml.sax.saxutils import escape


class Room(NamedTuple):
    """A folder of the package.

    Attributes:
        name: of the folder.
        content: one line.
        needs: third-party packages beyond numpy and scipy.
    """

    name: str
    content: str
    needs: str = ""


ROOMS: tuple[tuple[Room, ...], ...] = (
    (Room("model", "systems, model files, forcing, parameters", "ruamel.yaml, msgspec"),),
    (Room("dynamics", "flow of a phase, contact laws, guards and event location"),),
    (Room("robots", "rigid bodies of a URDF: motion, contacts, derivatives", "pinocchio"),),
    (Room("plant", "event-driven plant, sensor and its faults"),),
    (Room("bank", "Kalman filter of impact times: hypotheses as arrays"),),
    (Room("observer", "observer, timeline with roll-back, verdicts, the laws"),),
    (Room("io", "messages, bags in and out, tables and sounds in", "rosbags, mcap, soundfile"),),
    (
        Room("detector", "impacts from switches, accelerations, forces", "msgspec"),
        Room("draw", "pictures and tables of text", "matplotlib"),
    ),
    (Room("batch", "all events at once: parameters, smoothed motion, verdict", "rich"),),
    (
        Room("compare", "estimates against truth: metrics, tables, picture, export", "rich"),
        Room("check", "models and bags: what is wrong with them", "rich"),
    ),
    (
        Room("recording", "from a recording to numbers, a table of impacts and a picture"),
        Room(
            "sweep",
            "Monte Carlo over laws, starts, faults, wrong models",
            "joblib, pandas, pyarrow",
        ),
    ),
    (Room("ros", "nodes, recorder, player, monitor, watch", "rclpy"),),
    (Room("cli", "one short file per subcommand", "rich"),),
)
"""Level by level: a room imports only from rooms of the levels before its own."""

_WIDTH, _HEIGHT, _GAP = 940, 58, 14
_STYLE = 'rx="6" fill="#f2f2f2" stroke="#444"'


def table() -> str:
    """The rooms as a table."""
    lines = ["| room | what is in it | needs |", "|---|---|---|"]
    lines += [f"| `{r.name}/` | {r.content} | {r.needs} |" for level in ROOMS for r in level]
    return "\n".join(lines)


def picture() -> str:
    """The rooms as an SVG, the first level at the bottom; readable in grey."""
    height = len(ROOMS) * (_HEIGHT + _GAP) + _GAP
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}">',
        '<g font-family="sans-serif">',
        f'<rect width="{_WIDTH}" height="{height}" fill="white"/>',
    ]
    for k, level in enumerate(ROOMS):
        y = height - (k + 1) * (_HEIGHT + _GAP)
        width = (_WIDTH - _GAP) / len(level) - _GAP
        for j, room in enumerate(level):
            x = _GAP + j * (width + _GAP)
            parts += _box(room, x, y, width)
    parts.append("</g></svg>")
    return "\n".join(parts) + "\n"


def _box(room: Room, x: float, y: float, width: float) -> list[str]:
    """A box with the name of a room and, on lines as wide as it, its content."""
    letters, lines = int(width / 7), [""]
    for word in room.content.split():
        longer = f"{lines[-1]} {word}".strip()
        if len(longer) > letters:
            lines.append(word)
        else:
            lines[-1] = longer
    found = [
        f'<rect x="{x:g}" y="{y}" width="{width:g}" height="{_HEIGHT}" {_STYLE}/>',
        f'<text x="{x + 10:g}" y="{y + 19}" font-size="14" font-weight="bold">{room.name}</text>',
    ]
    found += [
        f'<text x="{x + 10:g}" y="{y + 35 + 14 * i}" font-size="11">{escape(line)}</text>'
        for i, line in enumerate(lines)
    ]
    return found
