# SPDX-License-Identifier: Apache-2.0
"""Writes what docs and YAML samples take from the code: ./dev docs."""

from collections.abc import Callable, Sequence
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
_COLUMN = 34
"""Where the comments of a sample begin."""


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
    lines = [row("argument", "default", "unit", "allowed", "meaning"), "|---" * 5 + "|"]
    for each in table:
        if each.name != "history":  # of nodes alone
            flag = f"`{each.long_flag}`"
            lines.append(row(flag, cell(each.default), each.unit, each.limits, each.meaning))
    return "\n".join(lines)


def parameters() -> str:
    """A table of the parameters of all nodes, without those that are options of commands."""
    options = {each.name for each in OBSERVER_OPTIONS} - {"history"}
    nodes: dict[Option, list[str]] = {}
    for node, table in TABLES.items():
        for each in table:
            of_commands = node == "observer" and each.name in options
            if not of_commands and not each.name.startswith("sensor."):
                nodes.setdefault(each, []).append(node)
    head = row("parameter", "nodes", "type", "default", "unit", "allowed", "meaning")
    lines = [head, "|---" * 7 + "|"]
    for p, found in nodes.items():
        of = "all" if len(found) == len(TABLES) else ", ".join(found)
        cells = (f"`{p.name}`", of, p.type, cell(p.default), p.unit, p.limits, p.meaning)
        lines.append(row(*cells))
    return "\n".join(lines)


PARTS: dict[str, dict[str, Callable[[], str]]] = {
    "house.md": {"rooms": rooms.table},
    "commands.md": {
        "options of observers": lambda: arguments(OBSERVER_OPTIONS),
        "faults of a sensor": lambda: arguments(SENSOR_FAULTS),
    },
    "nodes.md": {
        "parameters": parameters,
    },
}
"""What pages take from the code, by page and by the name between two comments."""


def page(name: str) -> str:
    """A page of docs with its parts written again."""
    text = (ROOT / "docs" / name).read_text(encoding="utf-8")
    for part, made in PARTS[name].items():
        begin, end = f"<!-- {part}, by ./dev docs -->\n", f"<!-- end of {part} -->"
        before, _, rest = text.partition(begin)
        text = f"{before}{begin}{made()}\n{end}{rest.partition(end)[2]}"
    return text


def sample(node: str) -> str:
    """The YAML sample of a node: every parameter at its default."""
    lines = [
        f"# Parameters of the node `{node}`, at their defaults, made by ./dev docs.",
        f"#   {node} --ros-args --params-file {node}.yaml",
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
    return {
        **{docs / name: page(name) for name in PARTS},
        docs / "images" / "rooms.svg": rooms.picture(),
        ROOT / "config" / "rosbag2" / "qos_overrides.yaml": qualities(),
        **{path: sample(path.stem) for path in samples},
    }


if __name__ == "__main__":
    for path, text in files().items():
        path.write_text(text, encoding="utf-8")
