# SPDX-License-Identifier: Apache-2.0
"""Runs the commands of the golden corpus and writes what they give.

The package under test is the ``impact_observer`` on ``PYTHONPATH``::

    PYTHONPATH=/path/of/a/checkout python test/golden/make.py

The bags that the commands write are read with rosbags, so that the corpus does not depend on the
package's own reader.
"""

import ast
import csv
import importlib
import inspect
import io
import itertools
import json
import math
import os
import re
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from ruamel.yaml import YAML

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
LAWS = ("open-loop", "kinematic", "geometric", "unilateral", "minimum-variance")
DETECT = {
    "switch": "--contact stop --topic /switch --latency 0.002 --model two_mass --epoch 1",
    "accelerometer": "--contact stop --topic /imu --threshold 100 --model two_mass --epoch 1",
}
RATES = {"ball_on_table": 25, "rubbing_guide": 0.4}
"""Estimates in a second; of the other bags 0.8: some 25 estimates a bag."""
WORDS = {
    "content",
    "found",
    "line",
    "obstacle",
    "path",
    "remedy",
    "storage",
    "text",
    "wanted",
    "version",
}
"""Keys of JSON whose values are prose, paths or versions, or are new: these are left out."""
ARRAY = "array"
"""Key of a reference to an array in ``commands.json``."""
BROKEN = {
    "negative.yaml": "bodies: [{name: a, mass: -1}]\n",
    "typing_error.yaml": "bodies: [{name: a, mas: 1}]\n",
    "no_yaml.yaml": "bodies: [}\n",
    "penetrating.yaml": """name: p
bodies: [{name: a, mass: 1}]
stops: [{name: s, body: a, limit: 0.5, side: above, restitution: 0.7}]
initial_state: {position: [0.6], velocity: [0]}
""",
    "too_large.yaml": """name: t
bodies: [{name: a, mass: 1}]
stops: [{name: s, body: a, limit: 0.5, side: above, restitution: 1.7}]
initial_state: {position: [0], velocity: [0]}
""",
    "unknown_body.yaml": """name: u
bodies: [{name: a, mass: 1}]
springs: [{between: [ground, b], stiffness: 1}]
""",
    "cradle.yaml": """name: cradle
bodies: [{name: a, mass: 1}, {name: b, mass: 1}]
springs:
  - {between: [ground, a], stiffness: 10, damping: 0.1}
  - {between: [ground, b], stiffness: 10, damping: 0.1}
stops: [{name: ab, between: [a, b], gap: 0.1, restitution: 0.5}]
initial_state: {position: [-0.5, 0], velocity: [0, 0]}
""",
    "events.csv": "time,contact,kind\n0.5,stop,impact\n1.25,stop,close\n1.5,stop,open\n",
    "no_header.csv": "0.5,stop\n1.25,stop\n",
    "backwards.csv": "time,contact\n0.5,stop\n0.25,stop\n",
    "letters.csv": "time,contact\nx,stop\n",
    "kinds.csv": "time,contact,kind\n0.5,stop,bang\n",
    "signal.csv": "time,a\n" + "".join(f"{k},{10 * (k % 250 == 9)}\n" for k in range(1000)),
    "silent.csv": "time,a\n0,0\n0.001,0\n0.002,0\n",
    "sensors.yaml": "measurements:\n  - {name: e, topic: /e, joint: x9, quantity: position}\n",
}
"""Inputs of the commands, by the name of their file."""


def observe(bag: str, law: str, options: str, name: str) -> str:
    """The command that observes ``bag`` as ``bags/expected.yaml`` says."""
    rate = RATES.get(name, 0.8)
    given = f"--law {law} --initial random:1 --ensemble 2 --rate {rate}"
    return f"observe {bag} {given} {options} -o {law}".replace("  ", " ")


def recorded(name: str, options: str) -> list[str]:
    """The commands on a bag in ``bags/``."""
    bag = f"bags/{name}"
    commands = [f"check {bag} --json"]
    if name in DETECT:
        commands += [f"detect {bag} {DETECT[name]} -o detected"]
        bag = "detected"
    laws = LAWS[2:] if options else LAWS  # the first two do not mind a wrong stamp
    commands += [observe(bag, law, options, name) for law in laws]
    if options:
        commands += [observe(bag, LAWS[-1], "", name).replace("-o ", "-o default-")]
    return commands


def _is_robot(model: Path) -> bool:
    """Whether a sample model is a robot, which version 0.2.0 did not know."""
    return model.with_suffix(".urdf").exists()


def groups() -> dict[str, list[str]]:
    """The commands in order, by the name of their group; a group has a folder of its own."""
    numbers = YAML(typ="safe").load(ROOT / "bags" / "expected.yaml")
    options = dict.fromkeys(numbers["ideal"], "")
    options |= {name: str(row["observe"]) for name, row in numbers["faulty"].items()}
    made = {f"bag {name}": recorded(name, options[name]) for name in sorted(options)}
    for version in ("0_1", "0_2"):
        bag = f"golden/version_{version}"
        made[f"version {version}"] = [
            f"check {bag} --json",
            f"compare {bag} --json",
            f"observe {bag} --law geometric --initial random:1 -o geometric",
            f"observe {bag} --law minimum-variance --initial random:1 -o minimum-variance",
            f"smooth {bag} --initial random:1 -o smoothed",
            f"export {bag} --what states -o states.csv",
            f"export {bag} --what errors -o errors.csv",
            f"export {bag} --what events -o events.csv",
        ]
    linear = [each for each in (ROOT / "config").glob("*.yaml") if not _is_robot(each)]
    models = [path.stem for path in linear]
    made["models"] = [f"check-model {name} --json" for name in (*sorted(models), "cradle.yaml")]
    made["simulate"] = [
        "simulate two_mass --duration 8 --rate 4 --seed 3 -o ideal",
        (
            "simulate three_mass --duration 8 --rate 4 --seed 3 --jitter 0.001 --missed 0.1"
            " --spurious 0.2 --mislabelled 0.1 --delay 0.01 --transport 0.1 -o faulty"
        ),
        "simulate bouncing_ball --duration 3 --rate 10 --quantisation 0.001 -o ball",
        "simulate yielding_stop --duration 5 --rate 4 -o yielding",
        "simulate rubbing_guide --duration 5 --rate 4 -o guide",
        "simulate cradle.yaml --duration 4 --rate 4 --integrator moreau --step 0.001 -o moreau",
        "simulate bags/pressed_hammer.yaml --duration 6 --rate 4 --impacts-only -o hammer",
        (
            "simulate two_mass --duration 10 --rate 4 --measurements encoder --measurement-rate 20"
            " --seed 5 -o encoder"
        ),
        "observe encoder --law geometric --measurements encoder --initial random:1 -o geometric",
        (
            "observe encoder --law minimum-variance --measurements encoder --initial random:1"
            " -o minimum-variance"
        ),
        "compare geometric minimum-variance --json",
    ]
    made["tables"] = [
        "import events.csv --model two_mass -o imported",
        "import no_header.csv --time-unit ms --time-zero 2 --epoch 1 -o milliseconds",
        "import backwards.csv --sort -o sorted",
        "detect signal.csv --contact stop --topic a --threshold 5 --time-unit ms -o detected",
        "export golden/version_0_2 --what events -o events_again.csv",
        "import backwards.csv -o refused",
        "import letters.csv -o refused",
        "import kinds.csv -o refused",
        "import missing.csv -o refused",
        "import events.csv -o imported",
        "detect silent.csv --contact stop --topic a --threshold 5 -o nothing",
        "detect signal.csv --contact stop --topic b --threshold 5 -o refused",
    ]
    made["identify"] = [
        "identify bags/two_mass --free restitution --json",
        "identify bags/jitter --check --json",
        "identify golden/version_0_2 --free restitution,gap,stiffness-scale --json",
        "identify bags/two_mass --free nonsense --json",
        "identify bags/switch --free restitution",
    ]
    made["observability"] = [
        "check-model two_mass bags/two_mass --json",
        "check-model three_mass bags/three_mass --json",
        "check-model ball_on_table bags/ball_on_table --json",
        "check-model two_mass golden/version_0_1 --json",
    ]
    made["compare"] = [
        "compare golden/version_0_1 golden/version_0_2 --json --csv metrics.csv",
        "compare bags/missed --laws geometric,minimum-variance --initial random:1 --json",
        "compare --figure two_mass --duration 3 --json",
        "compare bags/two_mass --json",
        "compare golden/version_0_1 --observers nobody --json",
    ]
    made["smooth"] = [
        "smooth bags/two_mass --rate 0.8 -o two_mass",
        "smooth bags/missed_and_spurious --clock-error 0 --rate 0.8 -o troubled",
        "smooth bags/jitter --clock-error 0.001 --rate 0.8 -o jitter",
    ]
    made["parameters"] = [
        (
            "observe bags/two_mass --law minimum-variance --initial random:1"
            " --estimate-parameters restitution=0.1 --rate 0.8 -o restitution"
        ),
        "smooth bags/two_mass --estimate-parameters restitution=0.1 --rate 0.8 -o smoothed",
    ]
    made["sweep"] = [
        (
            "sweep two_mass --laws geometric,minimum-variance --runs 2 --duration 5 --jobs 1"
            " --jitter 0,0.001 -o runs.parquet --json"
        )
    ]
    made["wrong use"] = [
        "observ bags/two_mass",
        "observe bags/two_mass",
        "observe bags/two_mass --lav geometric -o out",
        "observe bags/two_mass --law nonsense -o out",
        "observe bags/two_mass --clock-error 5 -o out",
        "observe bags/two_mass --clock-error x -o out",
        "observe bags/two_mass --initial 1,2 -o out",
        "observe bags/two_mass --initial random:x -o out",
        "observe bags/two_mass --deviation -1 --law minimum-variance -o out",
        "observe bags/two_mass --estimate-parameters nonsense --law minimum-variance -o out",
        "observe bags/two_mass --measurements sensors.yaml -o out",
        "observe bags/two_mass --model negative.yaml -o out",
        "observe bags/two_mass --rate 0 -o out",
        "observe bags/two_mass --rate 1000000 -o out",
        "observe bags/two_mass -o golden/version_0_1",
        "observe bags/switch -o out",
        "observe bags/switch --model two_mass -o out",
        "observe events.csv -o out",
        "observe missing -o out",
        "observe bags/two_mass --model three_mass -o out",
        "compare bags/switch --model two_mass --laws geometric",
        "simulate nonsense -o out",
        "simulate two_mass --duration -1 -o out",
        "simulate two_mass --jitter -1 -o out",
        "simulate negative.yaml -o out",
        "simulate typing_error.yaml -o out",
        "simulate no_yaml.yaml -o out",
        "simulate penetrating.yaml -o out",
        "simulate too_large.yaml -o out",
        "simulate unknown_body.yaml -o out",
        "check-model missing.yaml",
        "check missing",
        "export bags/two_mass -o table.xls",
        "plot bags/two_mass -o picture.doc",
        "detect bags/two_mass --contact stop --topic /missing -o out",
        "smooth bags/switch --model two_mass -o out",
    ]
    made["failed jobs"] = [
        "check truncated --json",
        "observe truncated -o out",
        "check truncated --salvage -o salvaged --json",
        "simulate two_mass --duration 1 -o negative.yaml/out",
        "check bags/switch --json",
        "import events.csv --model two_mass -o imported",
        "identify imported --free restitution",
    ]
    return made


@contextmanager
def workspace() -> Iterator[Path]:
    """A working folder of its own, with all inputs; paths in the commands are relative to it."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "bags").symlink_to(ROOT / "bags")
        (folder / "golden").symlink_to(HERE)
        for file, text in BROKEN.items():
            (folder / file).write_text(text, encoding="utf-8")
        shutil.copytree(ROOT / "bags" / "two_mass", folder / "truncated")
        with (folder / "truncated" / "two_mass_0.mcap").open("r+b") as file_:
            file_.truncate(200_000)
        (folder / "garbage.mcap").write_bytes(bytes(range(256)) * 8)
        os.chdir(folder)
        try:
            yield folder
        finally:
            os.chdir(before)


def run(command: str) -> dict[str, Any]:
    """What a command gives: exit code, error line, JSON, and what it wrote."""
    from impact_observer.cli.main import main

    words = shlex.split(command)
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            # Where the version of the corpus replaced a file, --force is needed now.
            code = main([*words, "--force"] if words[0] == "export" else words)
        except SystemExit as end:
            code = int(end.code or 0)
    given: dict[str, Any] = {"exit": code}
    if code and "--json" not in words:
        given["error"] = err.getvalue().strip().splitlines()[-1:]
    if "--json" in words and out.getvalue():
        given["json"] = without_words(json.loads(out.getvalue()))
    options = dict(itertools.pairwise(words))
    for option in ("-o", "--csv"):
        path = Path(options.get(option, "/nonexistent"))
        if not code and path.is_dir():
            given |= bag_content(path, words[0])
        elif not code and path.suffix == ".csv":
            given |= table_content(path)
    return given


def without_words(value: object) -> object:
    """JSON without prose, paths and versions."""
    if isinstance(value, dict):
        return {key: without_words(each) for key, each in value.items() if key not in WORDS}
    return [without_words(each) for each in value] if isinstance(value, list) else value


class Stamp(Protocol):
    """The time in the header of a message."""

    sec: int
    nanosec: int


def nanoseconds(stamp: Stamp) -> int:
    """The stamp of a message, ns."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def bag_content(path: Path, command: str) -> dict[str, Any]:
    """What a bag holds: counts of messages, and the content of the topics that are new in it."""
    made: dict[str, Any] = {}
    messages: dict[str, list[Any]] = {}
    with AnyReader([path]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append(message)
    counted = sorted(messages.keys() - LATER_TOPICS)
    made["messages"] = {topic: len(messages[topic]) for topic in counted}
    for topic in NEW_TOPICS.get(command, ()):
        if topic in messages:
            fields = READERS[topic](messages[topic])
            made |= {f"{topic} {field}": value for field, value in fields.items()}
    return made


def events(messages: Sequence[Any]) -> dict[str, Any]:
    """The events of a sender, in order of reception."""
    return {
        "stamp": np.array(stamps(messages)),
        "epoch": [nanoseconds(messages[0].epoch)],
        "switches": [
            f"{m.sequence} " + ",".join(f"{s.contact}:{s.kind}" for s in m.switches)
            for m in messages
        ],
    }


def stamps(messages: Sequence[Any]) -> list[int]:
    """The stamps of messages, ns."""
    return [nanoseconds(m.header.stamp) for m in messages]


def joint_states(messages: Sequence[Any]) -> dict[str, Any]:
    """The true states, shape (samples, 2n)."""
    x = np.array([[*m.position, *m.velocity] for m in messages])
    return {"first": stamps(messages[:1]), "last": stamps(messages[-1:]), "x": x}


def estimates(messages: Sequence[Any]) -> dict[str, Any]:
    """States, shape (samples, 2n), standard deviations, and what is said beside them."""
    made: dict[str, Any] = {
        "first": stamps(messages[:1]),
        "last": stamps(messages[-1:]),
        "x": np.array([[*m.position, *m.velocity] for m in messages]),
        "closed": runs(",".join(m.closed) for m in messages),
        "synchronized": runs(str(bool(m.synchronized)) for m in messages),
        "last_sequence": runs(str(m.last_sequence) for m in messages),
    }
    if messages[0].covariance.size:
        size = round(messages[0].covariance.size ** 0.5)
        variances = [m.covariance.reshape(size, size).diagonal() for m in messages]
        made["deviation"] = np.sqrt(np.array(variances)).astype(np.float32)
    if messages[-1].parameter_name:
        made["parameter_name"] = list(messages[-1].parameter_name)
        made["parameter"] = [float(each) for each in messages[-1].parameter]
        made["parameter_deviation"] = [float(e) for e in messages[-1].parameter_deviation]
    return made


def runs(words: Iterator[str]) -> list[str]:
    """Successive equal words as one, with their number in front."""
    made: list[list[Any]] = []
    for word in words:
        if made and made[-1][1] == word:
            made[-1][0] += 1
        else:
            made.append([1, word])
    return [f"{count} {word}" for count, word in made]


def verdicts(messages: Sequence[Any]) -> dict[str, Any]:
    """Verdicts in order: kind, number, contact, revised or not; stamps and innovations."""
    return {
        "stamp": np.array(stamps(messages)),
        "verdict": [
            f"{m.verdict} {m.sequence} {m.contact}{' revised' * m.reason.startswith('revised')}"
            for m in messages
        ],
        "innovation": np.array([m.innovation for m in messages], np.float32),
    }


def smoothed_impacts(messages: Sequence[Any]) -> dict[str, Any]:
    """Impacts of a smoothed recording: kind, number, contact; stamps and deviations."""
    return {
        "stamp": np.array(stamps(messages)),
        "impact": [f"{m.verdict} {m.sequence} {m.contact}" for m in messages],
        "deviation": np.array([m.deviation for m in messages], np.float32),
    }


def measurement_verdicts(messages: Sequence[Any]) -> dict[str, Any]:
    """Verdicts on samples: whether each was accepted, and its innovation."""
    return {
        "accepted": runs(f"{m.name} {bool(m.accepted)}" for m in messages),
        "innovation": np.array([m.innovation for m in messages], np.float32),
    }


def bounds(messages: Sequence[Any]) -> dict[str, Any]:
    """Certified bounds of V, J."""
    return {"v": np.array([float(m.v) for m in messages])}


READERS = {
    "/impacts": events,
    "/plant/joint_states": joint_states,
    "/observer/state": estimates,
    "/observer/verdicts": verdicts,
    "/observer/measurements": measurement_verdicts,
    "/observer/bound": bounds,
    "/smoother/state": estimates,
    "/smoother/impacts": smoothed_impacts,
}
"""What is read of each topic."""
LATER_TOPICS = {"/observer/impacts", "/smoother/impact_estimates"}
"""Topics that version 0.2.0 did not write; test/observer and test/smooth check them."""
_OBSERVED = ("/observer/state", "/observer/verdicts", "/observer/measurements", "/observer/bound")
NEW_TOPICS = {
    "simulate": ("/impacts", "/plant/joint_states"),
    "detect": ("/impacts",),
    "import": ("/impacts",),
    "observe": _OBSERVED,
    "smooth": ("/smoother/state", "/smoother/impacts"),
}
"""The topics that a command makes; it copies the others."""


def table_content(path: Path) -> dict[str, Any]:
    """The header of a CSV file, its words, and its numbers, shape (rows, columns)."""
    header, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
    words = sorted({word for row in rows for word in row if not is_number(word)})
    numbers = [[float(word) if is_number(word) else -1.0 for word in row] for row in rows]
    return {"header": header, "words": words, "numbers": np.array(numbers)}


def is_number(word: str) -> bool:
    """Whether a cell holds a number."""
    return re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", word) is not None


def run_group(commands: Sequence[str]) -> dict[str, dict[str, Any]]:
    """What the commands of a group give, by the command."""
    with workspace():
        return {command: run(command) for command in commands}


API = ROOT / "docs" / "api.md"


def public_modules() -> list[str]:
    """The rooms that have an ``__all__``, and the modules that the site documents."""
    import impact_observer

    package = Path(str(impact_observer.__file__)).parent
    rooms = [
        ".".join(("impact_observer", *path.parent.relative_to(package).parts))
        for path in package.rglob("__init__.py")
        if "\n__all__ = " in path.read_text("utf-8")
    ]
    documented = re.findall(r"^\.\. automodule:: (\S+)", API.read_text("utf-8"), re.MULTILINE)
    return sorted({*rooms, *documented})


def names_of(module: ModuleType) -> list[str]:
    """The public names of a module: its ``__all__``, else what it defines."""
    if hasattr(module, "__all__"):
        return sorted(module.__all__)
    made: set[str] = set()
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            made.add(node.name)
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            made.add(node.target.id)
        elif isinstance(node, ast.Assign):
            made |= {each.id for each in node.targets if isinstance(each, ast.Name)}
    return sorted(name for name in made if not name.startswith("_"))


def public_names() -> list[str]:
    """Every public name of Python, and once the public members of each public class."""
    made: list[str] = []
    seen: set[object] = set()
    for name in sorted(public_modules(), key=len, reverse=True):
        module = importlib.import_module(name)
        for each in names_of(module):
            value = getattr(module, each)
            made.append(f"{name}.{each}")
            if inspect.isclass(value) and value not in seen:
                seen.add(value)
                bases = [b for b in value.__mro__ if b.__module__.startswith("impact_observer")]
                members = {m for base in bases for m in (*vars(base), *annotations(base))}
                made += [f"{name}.{each}.{m}" for m in sorted(members) if not m.startswith("_")]
    return sorted(made)


def annotations(cls: type) -> Mapping[str, object]:
    """The annotated attributes of a class itself."""
    return inspect.get_annotations(cls)


def write(folder: Path) -> None:
    """Write the corpus: ``commands.json``, ``arrays.npz`` and ``public_names.txt``."""
    made: dict[str, dict[str, dict[str, Any]]] = {}
    arrays: dict[str, list[NDArray[Any]]] = {}
    for group, commands in groups().items():
        made[group] = run_group(commands)
        sys.stderr.write(f"{group}\n")
        for given in made[group].values():
            for field in [f for f, value in given.items() if isinstance(value, np.ndarray)]:
                array = given[field]
                same = arrays.setdefault(array.dtype.name, [])
                start = sum(each.size for each in same)
                given[field] = {ARRAY: array.dtype.name, "from": start, "shape": array.shape}
                same.append(array.ravel())
    lines = [
        f"{json.dumps(group)}: {{\n"
        + ",\n".join(f"{json.dumps(c)}: {json.dumps(given)}" for c, given in commands.items())
        for group, commands in made.items()
    ]
    text = "\n},\n".join(lines)
    (folder / "commands.json").write_text(f"{{\n{text}\n}}}}\n", encoding="utf-8")
    joined = {name: np.concatenate(each) for name, each in arrays.items()}
    np.savez_compressed(folder / "arrays.npz", **joined)  # type: ignore[arg-type]
    (folder / "public_names.txt").write_text("\n".join(public_names()) + "\n", encoding="utf-8")


def read(folder: Path = HERE) -> dict[str, dict[str, dict[str, Any]]]:
    """What :func:`write` has written, by group and command."""
    made = json.loads((folder / "commands.json").read_text(encoding="utf-8"))
    with np.load(folder / "arrays.npz") as stored:
        arrays = dict(stored)
    for commands in made.values():
        for given in commands.values():
            for field, value in given.items():
                if isinstance(value, dict) and ARRAY in value:
                    part = arrays[value[ARRAY]][value["from"] :][: math.prod(value["shape"])]
                    given[field] = part.reshape(value["shape"])
    return dict(made)


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
