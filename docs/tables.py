# SPDX-License-Identifier: Apache-2.0
"""Writes what docs and YAML samples take from the code: ./dev docs."""

from collections.abc import Sequence
from pathlib import Path

from docs import rooms
from impact_observer.io.interfaces import INTERFACES, Interface
from impact_observer.observer.laws import OWN_LAWS
from impact_observer.options import OBSERVER_OPTIONS, Option, Value
from impact_observer.ros.parameters import TABLES
from impact_observer.sensor_faults import SENSOR_FAULTS

ROOT = Path(__file__).resolve().parents[1]
_SIM_TIME = Option("use_sim_time", False, "follow /clock, of a simulation or a bag")
_SAMPLES: dict[str, Value] = {"model": "two_mass", "sources": "switch"}
"""What stands in the samples for options that have no default."""
_BEGIN, _END = "<!-- rooms, by ./dev docs -->", "<!-- end of rooms -->"
_COLUMN = 34
"""Where the comments of a sample begin."""
_PAGE = """\
# Options and parameters

Made by `./dev docs` from the tables in the code (`impact_observer/options.py`,
`sensor_faults.py`, `ros/parameters.py`). Nodes read their parameters at the start; the next
table has those that may be set later. Others are read-only: start the node again.
A whole number is accepted for a double: `-p rate:=100`.

## Parameters of an observer that may be set while it runs

`ros2 param set /observer rate 50.0`. The log and `/diagnostics` say from when a value acts.

{live}

## Options of observers

The commands `observe`, `compare --laws` and `sweep` take them as arguments, the node `observer` as
parameters. `--epoch` is in seconds, the parameter in nanoseconds. In `sweep` it is also
the epoch of the simulation, by default 1 s. There the simulated sensor has options of the same
names: those of observers are `--observer-missed` and so on.

{observer}

## Faults of a simulated sensor

Arguments of `simulate`, lists of values in `sweep`, and parameters `sensor.*` of the node `plant`.
Each fault draws from a random stream of its own, so that adding one changes nothing of the others.

{faults}
"""


def cell(value: Value) -> str:
    """A default as YAML writes it; empty for none."""
    if value in {"", ()}:
        return ""
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def row(*cells: str) -> str:
    """A row of a table."""
    escaped = [each.replace("|", "\\|") for each in cells]
    return f"| {' | '.join(escaped)} |"


def arguments(table: Sequence[Option]) -> str:
    """A table of options for the command line."""
    head = row("argument", "parameter", "default", "unit", "allowed", "meaning")
    lines = [head, "|---" * 6 + "|"]
    for each in table:
        flag = "" if each.name == "history" else f"`{each.long_flag}`"
        name = f"`{each.name}`"
        lines.append(row(flag, name, cell(each.default), each.unit, each.limits, each.meaning))
    return "\n".join(lines)


def live_parameters(table: Sequence[Option]) -> str:
    """A table of the parameters that may be set while a node runs."""
    lines = [row("parameter", "acts"), "|---" * 2 + "|"]
    return "\n".join([*lines, *(row(f"`{each.name}`", each.live) for each in table if each.live)])


def parameters(table: Sequence[Option]) -> str:
    """A table of a node's parameters."""
    head = row("parameter", "type", "default", "unit", "allowed", "meaning")
    lines = [head, "|---" * 6 + "|"]
    lines += [
        row(f"`{p.name}`", p.type, cell(p.default), p.unit, p.limits, p.meaning) for p in table
    ]
    return "\n".join(lines)


def page() -> str:
    """docs/parameters.md."""
    parts = [
        _PAGE.format(
            live=live_parameters(TABLES["observer"]),
            observer=arguments(OBSERVER_OPTIONS),
            faults=arguments(SENSOR_FAULTS),
        ),
        *(f"## Node `{node}`\n\n{parameters(table)}\n" for node, table in TABLES.items()),
    ]
    return "\n".join(parts)


def sample(node: str) -> str:
    """The YAML sample of a node: every parameter at its default."""
    lines = [
        f"# Parameters of the node `{node}`, at their defaults, made by ./dev docs.",
        f"#   ros2 run impact_observer {node} --ros-args --params-file {node}.yaml",
        f"#   ros2 launch impact_observer {node}.launch.py params_file:={node}.yaml",
        "# A double needs its point: 100.0, not 100.",
        "",
        "/**: # whatever the node's name and namespace",
        "  ros__parameters:",
    ]
    for each in (*TABLES[node], _SIM_TIME):
        entry = f"    {each.name}: {_yaml(_SAMPLES.get(each.name, each.default))}"
        lines.append(f"{entry:<{_COLUMN}} # {each.summary}")
    return "\n".join(lines) + "\n"


def _yaml(value: Value) -> str:
    """A value as YAML; an empty list of strings needs one empty string, for ROS."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return '[""]'
    if isinstance(value, float):
        text = repr(value)
        return text if "." in text else text.replace("e", ".0e")
    if isinstance(value, str) and (not value or value[0].isdigit()):
        return f'"{value}"'
    return str(value)


def qualities() -> str:
    """The file for ``ros2 bag --qos-profile-overrides-path``.

    ``ros2 bag`` compares exact names. So observers and monitors are listed without a law and with
    each built-in law.
    """
    parts = [
        "# Qualities of service of our topics, made from impact_observer/io/interfaces.py, for",
        "#   ros2 bag play BAG --qos-profile-overrides-path FILE",
        "#   ros2 bag record ... --qos-profile-overrides-path FILE",
    ]
    for each in INTERFACES:
        quality = each.quality
        for topic in _topics(each):
            parts += [
                f"{topic}:",
                f"  history: {'keep_last' if quality.depth else 'keep_all'}",
                f"  depth: {quality.depth}",
                f"  reliability: {'reliable' if quality.reliable else 'best_effort'}",
                f"  durability: {'transient_local' if quality.transient_local else 'volatile'}",
            ]
    return "\n".join(parts) + "\n"


def _topics(each: Interface) -> list[str]:
    """The absolute names of an interface, also those with the name of a built-in law."""
    owner, _, _ = each.name.partition("/")
    if owner not in {"observer", "monitor"}:
        return [each.topic]
    laws = [f"{owner}_{law.replace('-', '_')}" for law in OWN_LAWS]
    return [each.topic, *(f"/{each.name_under(law)}" for law in laws)]


def files() -> dict[Path, str]:
    """All that is made, by file."""
    docs, samples = ROOT / "docs", sorted((ROOT / "config" / "nodes").glob("*.yaml"))
    house = (docs / "house.md").read_text(encoding="utf-8")
    before, _, rest = house.partition(_BEGIN)
    after = rest.partition(_END)[2]
    return {
        docs / "parameters.md": page(),
        docs / "house.md": f"{before}{_BEGIN}\n{rooms.table()}\n{_END}{after}",
        docs / "images" / "rooms.svg": rooms.picture(),
        ROOT / "config" / "rosbag2" / "qos_overrides.yaml": qualities(),
        **{path: sample(path.stem) for path in samples},
    }


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text, encoding="utf-8")
