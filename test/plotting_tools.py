# SPDX-License-Identifier: Apache-2.0
"""Two plotting tools' ways to find numbers in messages, and a bag with all plotted topics.

Foxglove's message paths follow its grammar; PlotJuggler's names of series follow its parser of ROS
messages. Both are written from the sources of the tools, independently of our layouts.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from impact_observer.dynamics.lyapunov import distance
from impact_observer.events import MeasurementVerdict
from impact_observer.io import BagReader, BagWriter, EstimateError, JointState
from impact_observer.io.messages import bag_messages
from impact_observer.io.recordings import published_model
from impact_observer.io.typestores import typestore
from impact_observer.model import read_model
from impact_observer.observer import Options, make_observer, replay
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S, grid
from impact_observer.states import Estimate

EPOCH = 5 * NS_PER_S
DIAGNOSTICS = {
    "law": "some",
    "events applied": "3",
    "events rejected": "0",
    "impacts inserted": "0",
    "missing sequence numbers": "0",
    "estimates corrected": "1",
    "estimates passed over": "0",
    "largest latency [s]": "0.001200",
    "large innovations": "0",
    "synchronized": "False",
}
"""Diagnostics of an observer node; test_watcher compares them with a running node's."""

_TOPIC = re.compile(r"[/A-Za-z0-9_-]+")
_NAME = re.compile(r"\.([A-Za-z0-9_-]+)")
_SLICE = re.compile(r"\[(-?\d*)(:?)(-?\d*)\]")
_FILTER = re.compile(
    r"""\{([A-Za-z0-9_-]+(?:\.[A-Za-z0-9_-]+)*)(==|!=|>=|<=|>|<)("[^"]*"|'[^']*'|-?\d+)\}"""
)
_MODIFIERS: dict[str, Callable[[float], float]] = {
    "log10": math.log10,
    "sqrt": math.sqrt,
    "abs": abs,
}
_TOO_LONG = 100


class MessagePath(NamedTuple):
    """A parsed path: topic, steps, the function at its end."""

    topic: str
    steps: tuple[tuple[str, object], ...]
    modifier: str


def message_path(text: str) -> MessagePath:
    """``text`` parsed by the grammar of message paths, or an AssertionError."""
    found = _TOPIC.match(text)
    assert found, text
    topic, at = found[0], found.end()
    steps: list[tuple[str, object]] = []
    while at < len(text) and not text.startswith(".@", at):
        if found := _NAME.match(text, at):
            steps.append(("name", found[1]))
        elif found := _SLICE.match(text, at):
            assert steps[-1][0] == "name", text
            first, colon, last = found.groups()
            start = int(first or 0)
            steps.append(("slice", (start, (int(last) if last else None) if colon else start)))
        elif found := _FILTER.match(text, at):
            assert steps[-1][0] != "filter", text
            steps.append(("filter", (found[1], found[2], found[3])))
        else:
            raise AssertionError(f"{text}: not understood from {text[at:]!r} on")
        at = found.end()
    modifier = text[at + 2 :] if text.startswith(".@", at) else ""
    assert not modifier or modifier in _MODIFIERS, text
    return MessagePath(topic, tuple(steps), modifier)


def resolved(path: MessagePath, message: object) -> list[object]:
    """The values of a path in one message, after the path's function."""
    values = list(_walked(message, path.steps))
    if not path.modifier:
        return values
    function = _MODIFIERS[path.modifier]
    return [function(float(cast("float", v))) for v in values if float(cast("float", v)) > 0]


def _walked(value: Any, steps: Sequence[tuple[str, object]]) -> Iterator[object]:  # noqa: ANN401
    if not steps:
        yield value
        return
    (kind, what), *others = steps
    if kind == "name":
        if hasattr(value, str(what)):
            yield from _walked(getattr(value, str(what)), others)
    elif kind == "slice":
        start, end = cast("tuple[int, int | None]", what)
        assert isinstance(value, list | np.ndarray), "a slice of what is no array"
        for each in value[start : None if end is None else end + 1]:
            yield from _walked(each, others)
    else:
        key, operator, wanted = cast("tuple[str, str, str]", what)
        assert operator == "==", "no path of ours compares otherwise"
        found = value
        for name in key.split("."):
            found = getattr(found, name)
        if str(found) == wanted.strip("\"'"):
            yield from _walked(value, others)


def plotjuggler_series(topic: str, message: object) -> dict[str, object]:
    """The values of a message by the names of PlotJuggler's series."""
    name = cast("Any", message).__msgtype__
    if name == "sensor_msgs/msg/JointState":
        return _joint_state(topic, cast("Any", message))
    if name == "diagnostic_msgs/msg/DiagnosticArray":
        return _diagnostics(topic, cast("Any", message))
    return dict(_flat(topic, message))


def _joint_state(topic: str, message: Any) -> dict[str, object]:  # noqa: ANN401
    found: dict[str, object] = dict(_flat(f"{topic}/header", message.header))
    for field in ("position", "velocity", "effort"):
        values = zip(message.name, getattr(message, field), strict=False)
        found.update({f"{topic}/{name}/{field}": float(value) for name, value in values})
    return found


def _diagnostics(topic: str, message: Any) -> dict[str, object]:  # noqa: ANN401
    found: dict[str, object] = dict(_flat(f"{topic}/header", message.header))
    for status in message.status:
        owner = "/".join(part for part in (topic, status.hardware_id, status.name) if part)
        found |= {f"{owner}/level": float(status.level), f"{owner}/message": status.message}
        found |= {f"{owner}/{each.key}": _number(each.value) for each in status.values}
    return found


def _number(text: str) -> object:
    """A text as a number, if the text is a number."""
    try:
        return float(text)
    except ValueError:
        return text


def _flat(name: str, value: object) -> Iterator[tuple[str, object]]:
    fields = getattr(value, "__dataclass_fields__", None)
    if fields is not None:
        for field in fields:
            if field != "__msgtype__" and not field.isupper():  # capitals are constants
                yield from _flat(f"{name}/{field}", getattr(value, field))
    elif isinstance(value, list | np.ndarray):
        for i, each in enumerate(value if len(value) <= _TOO_LONG else []):
            yield from _flat(f"{name}[{i}]", each)
    else:
        yield name, value if isinstance(value, str) else float(cast("float", value))


def messages_in(bag: Path) -> dict[str, list[object]]:
    """All messages of a bag, by topic."""
    with BagReader(bag) as reader:
        return {
            topic: [message for _, message in reader.messages(topic)] for topic in reader.topics
        }


def everything(
    path: Path, laws: Mapping[str, str], *, model: str = "two_mass", duration: float = 3.0
) -> Path:
    """A bag of a plant and of observers, as nodes would have published it.

    Args:
        path: the bag to make.
        laws: the observers' laws by the names of their nodes.
        model: of the plant.
        duration: s.
    """
    read, make = read_model(model), bag_messages()
    system = read.system
    stamps = grid(EPOCH, EPOCH + round(duration * NS_PER_S), 20.0)
    run = simulate(Plant(system, *read.initial_state(), epoch=EPOCH), stamps)
    n, names = system.n, system.coordinates
    with BagWriter(path) as writer:
        writer.write("/plant/model", EPOCH, make.model(published_model(read, 0)))
        for stamp, x in zip(run.stamps.tolist(), run.states, strict=True):
            state = JointState(stamp, names, x[:n], x[n:])
            writer.write("/plant/joint_states", stamp, make.joint_state(state))
        for event in run.events:
            writer.write("/impacts", event.stamp, make.event(event))
        for name, law in laws.items():
            observer = make_observer(system, Options(law=law, initial_state="random:1"))
            truths = dict(zip(run.stamps.tolist(), run.states, strict=True))
            monitor, bound = name.replace("observer", "monitor"), -1.0
            for item in replay(observer, run.events, run.stamps):
                if not isinstance(item, Estimate):
                    message = make.verdict(item, 0.001)
                    writer.write(f"/{name}/verdicts", item.stamp, message)
                    judged = MeasurementVerdict(item.stamp, "encoder", 0.1, 0.001, 1.0, True)
                    message = make.measurement_verdict(judged)
                    writer.write(f"/{name}/measurements", item.stamp, message)
                    continue
                state = JointState(item.stamp, names, item.q, item.u)
                x = truths[item.stamp]
                q, u = item.q - x[:n], item.u - x[n:]
                error = EstimateError(item.stamp, law, float(distance(system, q, u)), names, q, u)
                writer.write(f"/{name}/joint_states", item.stamp, make.joint_state(state))
                writer.write(f"/{name}/state", item.stamp, make.estimate(item, names))
                writer.write(f"/{monitor}/error", item.stamp, make.estimate_error(error))
                if item.bound != bound:
                    bound = item.bound
                    writer.write(f"/{name}/bound", item.stamp, make.bound(item))
            writer.write("/diagnostics", EPOCH + NS_PER_S, diagnostics(f"/{name}", system.name))
    return path


def diagnostics(name: str, model: str, level: int = 0, message: str = "fine") -> object:
    """Diagnostics as the observer node ``name`` publishes them."""
    types = cast("Any", typestore().types)
    values = [
        types["diagnostic_msgs/msg/KeyValue"](key=key, value=value)
        for key, value in DIAGNOSTICS.items()
    ]
    status = types["diagnostic_msgs/msg/DiagnosticStatus"](
        level=level, name=f"{name}: impacts", message=message, hardware_id=model, values=values
    )
    stamp = bag_messages().time(EPOCH + NS_PER_S)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    return types["diagnostic_msgs/msg/DiagnosticArray"](header=header, status=[status])
