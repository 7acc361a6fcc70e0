# SPDX-License-Identifier: Apache-2.0
"""The files of a new rig say what was asked for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.detector import parse_sources
from impact_observer.errors import UsageError
from impact_observer.new.parts import (
    FORCE,
    GROUND,
    MASS,
    MODEL_KINDS,
    SENSOR,
    SPRING,
    STOP,
    PartKind,
)
from impact_observer.new.rig import NewRig, complete

NUMBERS = st.floats(1e-9, 1e9)
NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)


def rig(*parts: tuple[PartKind, str]) -> NewRig:
    """A rig of these parts."""
    made = NewRig("rig")
    for kind, text in parts:
        made = made.with_part(kind, text)
    return made


@pytest.mark.slow
@examples(30)
@given(NAMES, st.tuples(*[NUMBERS] * 5), st.floats(-1e9, 1e9), st.floats(0, 1))
def test_the_model_has_the_numbers_that_were_given(
    name: str, numbers: tuple[float, ...], amplitude: float, restitution: float
) -> None:
    """Numbers are equal to the last bit, whatever the names of the parts."""
    mass, stiffness, damping, frequency, limit = numbers
    try:
        MASS.parse(f"{name},1")
    except UsageError:
        assert name.lower() in {"null", "true", "false"}
        return
    if name == "ground":
        return
    made = rig(
        (MASS, f"{name},{mass!r}"),
        (SPRING, f"ground,{name},{stiffness!r},{damping!r}"),
        (FORCE, f"{name},{amplitude!r},{frequency!r},{limit!r}"),
        (FORCE, f"{name},{amplitude!r}"),
        (STOP, f"wall,{name},below,{-limit!r},{restitution!r}"),
    )
    system = made.model().system
    assert system.coordinates == (name,)
    assert system.M.item() == mass
    assert system.K.item() == stiffness
    assert system.C.item() == damping
    (contact,) = system.contacts
    assert (contact.gap, contact.direction.item()) == (limit, 1.0)
    assert contact.restitution == restitution
    assert system.forcing.constant.item() == amplitude
    assert system.forcing.frequency.item() == frequency
    assert np.hypot(system.forcing.cosine, system.forcing.sine).item() == pytest.approx(
        abs(amplitude)
    )


@pytest.mark.parametrize("kind", [*MODEL_KINDS, SENSOR], ids=lambda kind: kind.name)
def test_the_example_of_every_part_is_a_part(kind: PartKind) -> None:
    """The examples in help and errors can be copied; a part with a surplus field is refused."""
    assert kind.parse(kind.example)
    with pytest.raises(UsageError, match=rf"--{kind.name} .*expected.*such as {kind.example}"):
        kind.parse(kind.example + ",x,y,z,1,2")


def test_stops_between_bodies_have_their_gap() -> None:
    """The gap is q_b - q_a + gap."""
    made = rig((MASS, "a,1"), (MASS, "b,2"), (STOP, "bell,a,b,0.25,0.5"))
    system = made.model().system
    assert system.gap(np.array([0.5, 0.75])).tolist() == [0.5]


def test_every_stop_has_a_sensor() -> None:
    """A switch on the topic of its name, where none was given."""
    made = complete(
        rig(
            (MASS, "x1,1"),
            (STOP, "left,x1,below,-1,0.5"),
            (STOP, "right,x1,above,1,0.5"),
            (SENSOR, "right,/imu,30"),
        )
    )
    sources = parse_sources(made.sensors_text(), "sensors")
    assert [(each.contact, each.topic, each.kind) for each in sources] == [
        ("right", "/imu", "peak"),
        ("left", "/left", "switch"),
    ]
    assert sources[0].threshold == 30.0


@pytest.mark.parametrize(
    ("stops", "least"),
    [
        (["anvil,x1,above,-0.1,0.5"], [-0.1, 0.0]),
        (["anvil,x1,below,-0.1,0.5"], [0.0, 0.0]),
        (["between,x1,x2,-0.2,0.5"], [-0.1, 0.1]),
        (["plate,table,x1,0,0.5"], [0.05, 0.0]),  # which is 0.05 high at t = 0
        (["plate,table,x1,0,0.5", "between,x1,x2,0,0.5"], [0.05, 0.05]),
    ],
)
def test_a_simulation_begins_just_outside_the_stops(stops: list[str], least: list[float]) -> None:
    """The start is at the known least positions, with 1 % of the depth as a gap."""
    parts = [(MASS, "x1,1"), (MASS, "x2,1"), (GROUND, "table,0.05,3")]
    made = rig(*parts, *((STOP, each) for each in stops)).model()  # outside, else an error
    assert made.position == pytest.approx(least, rel=0.021)


def test_stops_that_leave_no_room_are_refused() -> None:
    """No position is outside both stops."""
    squeezed = [(MASS, "x1,1"), (STOP, "right,x1,above,-0.1,0.5"), (STOP, "left,x1,below,0.1,0.5")]
    with pytest.raises(UsageError, match="no positions are outside all of right, left; expected"):
        rig(*squeezed)


def test_files_of_a_small_rig_have_its_deviation() -> None:
    """The launch file has the deviation; a rig of the size of a metre has the default."""
    for limit, line in (("0.5", ""), ("0.001", '"initial_deviation": "0.003,0.03",')):
        made = rig((MASS, "x,0.1"), (SPRING, "ground,x,10"), (STOP, f"end,x,above,{limit},0.5"))
        launch = complete(made).launch_text()
        assert [each.strip() for each in launch.splitlines() if "deviation" in each] == (
            [line] if line else []
        )
        compile(launch, "rig.launch.py", "exec")


@pytest.mark.parametrize("drive", ["x1,2", "x1,2,3"])
def test_the_launch_file_names_the_epoch_where_it_is_needed(drive: str) -> None:
    """The launch file is valid Python with and without an epoch."""
    made = complete(rig((MASS, "x1,1"), (FORCE, drive), (STOP, "a,x1,above,1,0.5")))
    text = made.launch_text()
    assert "generate_launch_description" in compile(text, "launch", "exec").co_names
    assert ("epoch:=NANOSECONDS" in text) is ("," in drive.removeprefix("x1,"))
    assert all(len(line) < 100 for line in text.splitlines())


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ([(MASS, "x1,-1")], r"rig\.yaml: bodies\[0\]\.mass: is -1"),
        ([(MASS, "x1,one")], "--mass x1,one: 'one' is no number; expected NAME,MASS"),
        ([(MASS, "1x,1")], "'1x' is no name"),
        ([(MASS, "true,1")], "'true' is no name"),
        ([(MASS, "x1")], "--mass x1: 1 values found between commas"),
        ([(MASS, "x1,1"), (SPRING, "ground,x2,1")], r"springs\[0\]\.between.*x2"),
        ([(MASS, "x1,1"), (STOP, "a,x1,above,1,1.5")], r"restitution: is 1\.5"),
        ([(MASS, "x1,1"), (SENSOR, "a,/a")], "no such stop; there are none"),
        (
            [(MASS, "x1,1"), (STOP, "a,x1,above,1,1"), (SENSOR, "a,/a"), (SENSOR, "a,/b")],
            "'a' has two sensors",
        ),
        ([(MASS, "x1,1"), (STOP, "a,x1,above,1,1"), (SENSOR, "a,a b")], "is no name of a topic"),
    ],
)
def test_a_wrong_part_is_one_line(parts: list[tuple[PartKind, str]], words: str) -> None:
    """The error says what was found and what is expected."""
    with pytest.raises(UsageError, match=words):
        rig(*parts)


@pytest.mark.parametrize("name", ["", "a b", "../a", "1"])
def test_a_name_is_that_of_a_file(name: str) -> None:
    """The name of a rig is also the name of a model."""
    with pytest.raises(UsageError, match=r"NAME: .*expected letters"):
        NewRig(name)


@pytest.mark.parametrize("missing", [MASS, STOP], ids=lambda kind: kind.name)
def test_what_moves_and_what_it_hits_are_needed(missing: PartKind) -> None:
    """A rig without bodies or without stops has nothing to observe."""
    made = NewRig("rig") if missing is MASS else rig((MASS, "x1,1"))
    with pytest.raises(UsageError, match=rf"--{missing.name}: none given; .*{missing.example}"):
        complete(made)
