# SPDX-License-Identifier: Apache-2.0
"""What is said of a model and its impacts before a fit begins."""

from dataclasses import replace
from pathlib import Path

import pytest
from two_masses import MODEL

from impact_observer.check.model_check import check_model
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import parse_model, read_model
from impact_observer.plant import simulate
from impact_observer.recording.before_the_fit import (
    check_times,
    doubtful_contacts,
    long_contacts,
    model_warnings,
)
from impact_observer.stamps import NS_PER_S, grid

EPOCH = 10**9
RECORDING = Path("hits.txt")
RIG = MODEL.replace("RESTITUTION", "0.7")


@pytest.fixture(scope="module")
def events() -> list[ImpactEvent]:
    """The impacts of half a minute of the rig."""
    return [*simulate("two_mass", grid(EPOCH, EPOCH + 30 * 10**9, 10.0)).events]


@pytest.mark.parametrize(
    ("right", "wrong"), [("limit: 0.5", "limit: 500"), ("frequency: 2.5", "frequency: 250")]
)
def test_a_contact_that_the_model_hardly_ever_reaches_is_named(
    right: str, wrong: str, events: list[ImpactEvent]
) -> None:
    """A limit in mm, or a force in another unit."""
    assert not [*doubtful_contacts(parse_model(RIG, "rig.yaml"), events)]
    odd = parse_model(RIG.replace(right, wrong), "rig.yaml")
    (line,) = doubtful_contacts(odd, events)
    assert line.startswith("stop: ")


def test_a_contact_that_the_model_reaches_far_too_often_is_named(
    events: list[ImpactEvent],
) -> None:
    """Of twenty impacts the recording has one."""
    (line,) = doubtful_contacts(read_model("two_mass"), [events[0], events[-1]])
    assert line.startswith("stop: ")


def test_a_contact_that_is_closed_most_of_the_time_is_named() -> None:
    """A switch that opens at a hit; the same one read the other way round is not named."""

    def touching(first: Kind, then: Kind) -> list[ImpactEvent]:
        stamps = [EPOCH + k * NS_PER_S + by for k in range(9) for by in (0, NS_PER_S // 20)]
        kinds = (first, then) * 9
        return [
            ImpactEvent(stamp, (Switch("stop", kind),), epoch=EPOCH, sequence=k)
            for k, (stamp, kind) in enumerate(zip(stamps, kinds, strict=True), start=1)
        ]

    (line,) = long_contacts(touching(Kind.OPEN, Kind.CLOSE))
    assert line.startswith("stop: ")
    assert not [*long_contacts(touching(Kind.CLOSE, Kind.OPEN))]


def test_times_in_another_unit_are_refused(events: list[ImpactEvent]) -> None:
    """Milliseconds that are taken for seconds: the key that reads them is named."""
    checked = check_model(read_model("two_mass"))
    check_times(checked, events, RECORDING)
    late = [replace(each, stamp=1000 * each.stamp) for each in events]
    with pytest.raises(UsageError, match="time_unit: ms"):
        check_times(checked, late, RECORDING)


def test_warnings_of_the_model_are_those_of_its_check() -> None:
    """A body that no impact moves; none of a model that is right."""
    assert not [*model_warnings(check_model(read_model("two_mass")))]
    alone = RIG.replace("{name: x2, mass: 1}]", "{name: x2, mass: 1}, {name: x3, mass: 1}]")
    checked = check_model(parse_model(alone, "rig.yaml"))
    assert any("x3" in line for line in model_warnings(checked))
