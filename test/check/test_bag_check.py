# SPDX-License-Identifier: Apache-2.0
"""Checking a bag: every fault is found, under the name of the thing at fault, and no other."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from faulty_bags import GOOD, MAKE, STOP, S, event_message, model, state, three, write

from impact_observer.check.bag_check import Finding, check_bag
from impact_observer.errors import BagError
from impact_observer.events import ImpactEvent, Kind, Ruling, Switch
from impact_observer.io import BagReader, BagWriter
from impact_observer.io.observed_bag import observe_bag
from impact_observer.io.recordings import model_of
from impact_observer.io.typestores import typestore
from impact_observer.model import read_model
from impact_observer.observer import Options, make_observer

TYPES = cast("dict[str, Callable[..., object]]", typestore().types)


pytestmark = pytest.mark.usefixtures("in_tmp_path")


def findings(*, usable: bool, name: str | None = None) -> list[Finding]:
    """The findings in ``bag``, against a given model or that of the bag."""
    report = check_bag(Path("bag"), None if name is None else read_model(name))
    assert report.usable is usable
    assert all("\n" not in each.line for each in report.findings)
    return report.findings


def found(*, usable: bool, name: str | None = None) -> list[tuple[str, str]]:
    """Severity and thing of each finding."""
    return [(each.severity, each.thing) for each in findings(usable=usable, name=name)]


def test_no_impacts_names_the_sensors_and_the_command() -> None:
    """The commands for a switch, an accelerometer and a force can be copied."""
    kinds = {
        "/force": "geometry_msgs/msg/WrenchStamped",
        "/imu": "sensor_msgs/msg/Imu",
        "/switch": "std_msgs/msg/Bool",
    }
    write(None, types={**kinds, "/phase_reference": "std_msgs/msg/Header"})
    first, *sensors = findings(usable=False)
    assert (first.severity, first.thing) == ("error", "bag")
    assert [each.thing for each in sensors] == [*kinds]
    do = "impact-observer detect bag --contact NAME --topic"
    assert [each.remedy for each in sensors] == [
        f"{do} /force --field wrench.force.z --threshold N -o NEW",
        f"{do} /imu --threshold N -o NEW",
        f"{do} /switch -o NEW",
    ]


def test_several_topics_of_impacts_are_refused() -> None:
    """Both are named."""
    both = [(f"/{rig}/impacts", S, MAKE.event(GOOD[0])) for rig in ("left", "right")]
    write(None, more=both)
    assert found(usable=False) == [("error", "/left/impacts and /right/impacts")]


def test_a_second_topic_of_impacts_is_not_used() -> None:
    """The topic without a namespace is."""
    write(more=[("/left/impacts", 2 * S, MAKE.event(GOOD[0]))])
    assert found(usable=True) == []


def test_impacts_of_another_type_are_named() -> None:
    """Found and wanted types are in the line."""
    message = TYPES["std_msgs/msg/Bool"](data=True)
    write(None, types={"/impacts": "std_msgs/msg/Bool"}, more=[("/impacts", S, message)])
    (finding,) = findings(usable=False)
    assert finding.thing == "/impacts"
    assert "std_msgs/msg/Bool" in finding.found
    assert finding.wanted == "impact_observer_msgs/msg/ImpactEvent"


def test_no_events_at_all() -> None:
    """A topic without messages is an error."""
    write([])
    assert found(usable=False) == [("error", "/impacts")]


BAD = state(5 * S)
BAD.position = cast("Sequence[float]", np.array([0, np.nan]))


@pytest.mark.parametrize(
    ("changes", "name", "usable", "expected", "words"),
    [
        ({"text": ""}, None, True, ("warning", "bag"), "/plant/model"),
        ({"text": "name: [broken"}, None, True, ("warning", "bag"), "line 1, column 14"),
        (
            {"truth": [three(k * S) for k in range(1, 8)]},
            "three_mass",
            False,
            ("error", "/impacts"),
            "three_mass",
        ),
        ({"truth": []}, None, True, ("note", "bag"), "/plant/joint_states"),
        (
            {"truth": [state(k * S, ("a", "x2")) for k in range(1, 8)]},
            None,
            True,
            ("warning", "/plant/joint_states"),
            "a, x2",
        ),
        (
            {"truth": [*(state(k * S) for k in range(1, 7)), state(7 * S, ("x1", "y"))]},
            None,
            False,
            ("error", "/plant/joint_states"),
            "lacks x2",
        ),
        (
            {"truth": [*(state(k * S) for k in range(1, 8)), BAD, BAD]},
            None,
            False,
            ("error", "/plant/joint_states"),
            "message 7: JointState.position[1] is nan",
        ),
        (
            {"truth": [state(k * S) for k in range(1, 5)]},
            None,
            True,
            ("note", "/plant/joint_states"),
            "1.000000000 to 4.000000000 s",
        ),
        (
            {"truth": [state(k * S) for k in range(50, 58)]},
            None,
            True,
            ("warning", "/plant/joint_states"),
            "50.000000000 to 57.000000000 s",
        ),
    ],
)
def test_every_fault_of_model_and_truth_is_found(
    changes: dict[str, object],
    name: str | None,
    usable: bool,
    expected: tuple[str, str],
    words: str,
) -> None:
    """Each bag has one fault and one finding, with the value that was found."""
    write(**changes)  # type: ignore[arg-type]
    (finding,) = findings(usable=usable, name=name)
    assert (finding.severity, finding.thing) == expected
    assert words in finding.found


def test_a_contact_that_is_never_reported_is_a_warning() -> None:
    """The left stop of three_mass has no event."""
    events = [ImpactEvent(e.stamp, (Switch("right"),), e.sequence, 1, S) for e in GOOD]
    write(events, text=model("three_mass"), truth=[three(k * S) for k in range(1, 8)])
    (finding,) = findings(usable=True)
    assert (finding.severity, finding.thing) == ("warning", "/impacts")
    assert finding.found.endswith("left")


CASES: dict[str, tuple[list[ImpactEvent], bool, str]] = {
    "unsorted stamps": ([GOOD[0], GOOD[2], GOOD[1], GOOD[3], GOOD[4]], True, ""),
    "a message twice": ([*GOOD, GOOD[4]], True, "message 5 at 6.000000000 s"),
    "a number twice": (
        [*GOOD, ImpactEvent(7 * S, STOP, 5, 1, S)],
        True,
        "message 5 at 7.000000000 s",
    ),
    "a gap": (
        [GOOD[0], GOOD[3], GOOD[4]],
        True,
        "2 events missing, the first is number 2, before 5.000000000 s",
    ),
    "no numbers": ([ImpactEvent(event.stamp, STOP, 0, 1, S) for event in GOOD], True, ""),
    "episodes": (
        [*GOOD[:2], *(ImpactEvent(k * S, STOP, k - 3, 2, S) for k in (4, 5, 6))],
        True,
        "",
    ),
    "no epoch": (
        [ImpactEvent(event.stamp, STOP, event.sequence, 1) for event in GOOD],
        True,
        "5 events without an epoch",
    ),
    "epoch after events": (
        [ImpactEvent(event.stamp, STOP, event.sequence, 1, 3 * S) for event in GOOD],
        True,
        "message 0 at 2.000000000 s",
    ),
    "an unknown contact": (
        [*GOOD[:4], ImpactEvent(6 * S, (Switch("wall"),), 5, 1, S)],
        True,
        "wall",
    ),
    "none but unknown contacts": (
        [ImpactEvent(event.stamp, (Switch("wall"),), event.sequence, 1, S) for event in GOOD],
        False,
        "wall",
    ),
    "OPEN without CLOSE": (
        [*GOOD[:4], ImpactEvent(6 * S, (Switch("stop", Kind.OPEN),), 5, 1, S)],
        True,
        "stop, message 4 at 6.000000000 s",
    ),
    "CLOSE twice": (
        [ImpactEvent(k * S, (Switch("stop", Kind.CLOSE),), k - 1, 1, S) for k in (2, 3)],
        True,
        "stop, message 1 at 3.000000000 s",
    ),
    "IMPACT of a closed contact": (
        [ImpactEvent(2 * S, (Switch("stop", Kind.CLOSE),), 1, 1, S), GOOD[1]],
        True,
        "stop, message 1 at 3.000000000 s",
    ),
}
"""Events, whether an observer applies any of them, and words of the one finding."""


def recorded(events: list[ImpactEvent]) -> None:
    """Record a bag of a plant with these events in this order."""
    with BagWriter(Path("bag")) as writer:
        writer.write("/plant/model", S, MAKE.model(model()))
        for k in range(1, 8):
            writer.write("/plant/joint_states", k * S, state(k * S))
        for k, event in enumerate(events):
            writer.write("/impacts", 2 * S + k, MAKE.event(event))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_fault_of_events_is_found(case: str) -> None:
    """The finding names the first message that has the fault."""
    events, usable, words = CASES[case]
    recorded(events)
    seen = findings(usable=usable)
    assert len(seen) == bool(words)
    for each in seen:
        assert (each.severity, each.thing) == ("warning" if usable else "error", "/impacts")
        assert words in each.found


def observed() -> bool:
    """Whether an observer applies any event of ``bag``.

    The epoch is given to the observer if no event has one.
    """
    with BagReader(Path("bag")) as reader:
        epoch = 0 if any(event.epoch for event in reader.events()) else S
        observer = make_observer(
            model_of(reader).system, Options("kinematic", epoch=epoch, ensemble=1)
        )
        try:
            _, rulings = observe_bag(reader, observer, Path("out"), epoch=epoch)
        except BagError:
            return False
    return rulings[Ruling.APPLIED] > 0


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(
            case, marks=() if case in {"a gap", "none but unknown contacts"} else pytest.mark.slow
        )
        for case in CASES
    ],
)
def test_an_observer_applies_events_of_a_bag_exactly_where_it_is_usable(case: str) -> None:
    """An observer applies no event of a bag with an error."""
    events, usable, _ = CASES[case]
    recorded(events)
    assert observed() is usable


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sec": 0}, "message 1: ImpactEvent.header.stamp is 0.0"),
        ({"nanosec": 4_000_000_000}, "message 1: ImpactEvent.header.stamp.nanosec is 4000000000"),
    ],
)
def test_a_message_without_a_valid_event_is_an_error(changes: dict[str, int], words: str) -> None:
    """The message is named, with what was found."""
    with BagWriter(Path("bag")) as writer:
        writer.write("/plant/model", S, MAKE.model(model()))
        writer.write("/impacts", S, event_message(GOOD[0]))
        writer.write("/impacts", 2 * S, event_message(GOOD[1], **changes))
    first, *_ = findings(usable=False)
    assert (first.severity, first.thing) == ("error", "/impacts")
    assert words in first.found
