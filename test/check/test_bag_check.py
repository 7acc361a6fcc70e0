# SPDX-License-Identifier: Apache-2.0
"""Checking a bag: every fault has its line, and there is no other line."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from faulty_bags import GOOD, MAKE, S, model, state, three, write

from impact_observer.check.bag_check import check_bag
from impact_observer.cli.main import main
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io.typestores import typestore
from impact_observer.model import read_model

TYPES = cast("dict[str, Callable[..., object]]", typestore().types)


pytestmark = pytest.mark.usefixtures("in_tmp_path")


def lines(*, usable: bool, name: str | None = None) -> list[str]:
    """Severity and line of each finding in ``bag``, against a given model or that of the bag."""
    system = None if name is None else read_model(name).system
    report = check_bag(Path("bag"), system)
    assert report.usable is usable
    return [f"{each.severity} {each.line}" for each in report.findings]


def test_no_impacts_names_the_sensors_and_the_command() -> None:
    """A switch, an accelerometer, forces: the line can be copied."""
    vector = TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    header = TYPES["std_msgs/msg/Header"](MAKE.time(S), "")
    wrench = TYPES["geometry_msgs/msg/Wrench"](vector, vector)
    write(
        None,
        types={
            "/switch": "std_msgs/msg/Bool",
            "/force": "geometry_msgs/msg/WrenchStamped",
            "/imu": "sensor_msgs/msg/Imu",
        },
        more=[
            ("/switch", S, TYPES["std_msgs/msg/Bool"](data=True)),
            ("/force", S, TYPES["geometry_msgs/msg/WrenchStamped"](header, wrench)),
        ],
    )
    do = "impact-observer detect bag --contact NAME --topic"
    assert lines(usable=False) == [
        (
            "error bag: no impacts; topics in the bag: /force, /imu, /plant/joint_states,"
            " /plant/model, /switch; expected impact_observer_msgs/msg/ImpactEvent on /impacts;"
            " detect can make them of its sensors"
        ),
        (
            "note /force: geometry_msgs/msg/WrenchStamped looks like a force;"
            f" {do} /force --field wrench.force.z --threshold N -o NEW"
        ),
        (
            "note /imu: sensor_msgs/msg/Imu looks like an accelerometer;"
            f" {do} /imu --threshold N -o NEW"
        ),
        f"note /switch: std_msgs/msg/Bool looks like a switch; {do} /switch -o NEW",
    ]


def test_no_impacts_tells_the_pulse_of_a_drive_from_a_sensor() -> None:
    """The topic phase_reference is never a contact; another header may be a turn of a drive."""
    header = "std_msgs/msg/Header"
    write(None, types={"/phase_reference": header, "/tacho": header})
    said = "\n".join(lines(usable=False))
    assert "note /phase_reference" not in said
    assert f"note /tacho: {header} looks like a message a hit, or a turn of a drive" in said
    assert "detect --pulses" in said


def test_no_impacts_and_no_sensors_names_import() -> None:
    """A table of times will do."""
    write(None)
    assert lines(usable=False) == [
        (
            "error bag: no impacts; topics in the bag: /plant/joint_states, /plant/model;"
            " expected impact_observer_msgs/msg/ImpactEvent on /impacts; a table of impact times"
            " becomes a bag with `impact-observer import CSV -o BAG`"
        )
    ]


def test_impacts_under_another_name_are_pointed_at() -> None:
    """Impacts under another name are recognised by their type."""
    write(
        None,
        types={"/hits": "impact_observer_msgs/msg/ImpactEvent"},
        more=[("/hits", S, MAKE.event(GOOD[0]))],
    )
    assert lines(usable=False)[0].endswith(
        "; play the bag with /hits as /impacts, and record that"
    )


def test_several_topics_of_impacts_are_refused() -> None:
    """A topic without a namespace wins over the others."""
    both = [(f"/{rig}/impacts", S, MAKE.event(GOOD[0])) for rig in ("left", "right")]
    write(None, more=both)
    assert lines(usable=False) == [
        (
            "error /left/impacts and /right/impacts: several topics fit /impacts; expected one"
            " of them; record one only, or play the bag with one as /impacts"
        )
    ]


def test_a_second_topic_of_impacts_is_not_used() -> None:
    """The one at the top is."""
    write(more=[("/left/impacts", 2 * S, MAKE.event(GOOD[0]))])
    assert lines(usable=True) == ["note /left/impacts: not used; /impacts is"]


def test_impacts_of_another_type_are_named() -> None:
    """The error says how messages of another type become events."""
    message = TYPES["std_msgs/msg/Bool"](data=True)
    write(None, types={"/impacts": "std_msgs/msg/Bool"}, more=[("/impacts", S, message)])
    assert lines(usable=False) == [
        (
            "error /impacts: is std_msgs/msg/Bool; expected"
            " impact_observer_msgs/msg/ImpactEvent; detect makes impacts of such a topic"
        )
    ]


def test_no_events_at_all() -> None:
    """A topic without messages."""
    write([])
    assert lines(usable=False) == [
        (
            "error /impacts: no events; expected at least one impact; was the sender running,"
            " and was it subscribed to reliably, transient local?"
        )
    ]


BAD = state(5 * S)
BAD.position = cast("Sequence[float]", np.array([0, np.nan]))


@pytest.mark.parametrize(
    ("changes", "name", "usable", "expected"),
    [
        (
            {"text": ""},
            None,
            True,
            (
                "warning bag: carries no model (/plant/model); name one with --model MODEL;"
                " contacts and epoch are checked then"
            ),
        ),
        (
            {"text": "name: [broken"},
            None,
            True,
            (
                "warning /plant/model: the model it carries is not valid (model: is not YAML at"
                " line 1, column 14: expected ',' or ']', but got '<stream end>'); name one with"
                " --model MODEL"
            ),
        ),
        (
            {"truth": [three(k * S) for k in range(1, 8)]},
            "three_mass",
            False,
            (
                "error /impacts: none of its contacts (stop) is one of the model three_mass;"
                " expected right, left; name the model of this rig with --model"
            ),
        ),
        (
            {"truth": []},
            None,
            True,
            (
                "note bag: carries no truth (/plant/joint_states); observe needs --rate, and"
                " there is nothing to compare with"
            ),
        ),
        (
            {"truth": [state(k * S, ("a", "x2")) for k in range(1, 8)]},
            None,
            True,
            (
                "warning /plant/joint_states: states of a, x2; expected the coordinates x1, x2"
                " of the model two_mass; compare cannot use them; name the model's coordinates"
                " alike"
            ),
        ),
        (
            {"truth": [*(state(k * S) for k in range(1, 7)), state(7 * S, ("x1", "y"))]},
            None,
            False,
            (
                "error /plant/joint_states: 1 message has other coordinates, the first is"
                " message 6: x1, y; expected one finite position and velocity for every"
                " coordinate, the same throughout; observe and compare refuse it; record again,"
                " or leave the topic out"
            ),
        ),
        (
            {"truth": [*(state(k * S) for k in range(1, 8)), BAD, BAD]},
            None,
            False,
            (
                "error /plant/joint_states: 2 messages have no state, the first is message 7:"
                " JointState.position[1] is nan; expected finite numbers; expected one finite"
                " position and velocity for every coordinate, the same throughout; observe and"
                " compare refuse it; record again, or leave the topic out"
            ),
        ),
        (
            {"truth": [state(k * S) for k in range(1, 5)]},
            None,
            True,
            (
                "note /plant/joint_states: the truth is from 1.000000000 to 4.000000000 s, the"
                " impacts are from 2.000000000 to 6.000000000 s; only what is common can be"
                " compared"
            ),
        ),
        (
            {"truth": [state(k * S) for k in range(50, 58)]},
            None,
            True,
            (
                "warning /plant/joint_states: the truth is from 50.000000000 to 57.000000000 s,"
                " the impacts are from 2.000000000 to 6.000000000 s; nothing can be compared;"
                " are both stamped by one clock?"
            ),
        ),
    ],
)
def test_every_fault_of_model_and_truth_has_its_line(
    changes: dict[str, object],
    name: str | None,
    usable: bool,
    expected: str,
) -> None:
    """The check prints one line for each fault, and no other line."""
    write(**changes)  # type: ignore[arg-type]
    assert lines(usable=usable, name=name) == [expected]


def test_a_contact_that_is_never_reported_is_a_warning() -> None:
    """The left stop of three_mass has no event."""
    events = [ImpactEvent(e.stamp, (Switch("right"),), e.sequence, 1, S) for e in GOOD]
    write(events, text=model("three_mass"), truth=[])
    assert lines(usable=True) == [
        (
            "warning /impacts left: this contact of the model three_mass is never reported; if it"
            " was hit, its sensor is silent or has another name"
        ),
        (
            "note bag: carries no truth (/plant/joint_states); observe needs --rate, and there"
            " is nothing to compare with"
        ),
    ]


def test_the_first_fault_among_many_states_is_named() -> None:
    """Messages have two layouts, since the frame is part of a message."""
    truth = [state(S + k * 20_000_000) for k in range(500)]
    for k in (340, 300, 480):
        truth[k].velocity = cast("Sequence[float]", np.array([np.inf, 1]))
    for each in truth[::3]:
        each.header.frame_id = "rig"
    write(truth=truth)
    (line,) = lines(usable=False)
    assert line.startswith(
        "error /plant/joint_states: 3 messages have no state, the first is message 300:"
        " JointState.velocity[0] is inf; expected finite numbers; expected one finite"
    )


@pytest.mark.long
def test_a_true_state_of_another_day_is_named_before_estimates_fill_the_disk(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The check warns of it; observe refuses by the limit that would be exceeded."""
    write(truth=[*(state(k * S) for k in range(1, 7)), state(30 * 86400 * S)])
    (far,) = lines(usable=True)
    assert far.startswith(
        "warning /plant/joint_states: 1 jump of the stamps, the first is message 6, 720 h after"
    )
    command = ["observe", "bag", "--law", "geometric", "-o", "out"]
    assert main([*command, "--rate", "20"]) == 2
    found = capsys.readouterr().err
    assert "51839981 estimates; --most-estimates allows 10000000" in found
    assert "they would go on until 2592000.000000000 s" in found
    assert main([*command, "--rate", "1", "--most-estimates", "1000"]) == 2
    assert not Path("out").exists()
    assert main([*command, "--rate", "0.001"]) == 0
