# SPDX-License-Identifier: Apache-2.0
"""The table of topics and their quality of service."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.interfaces import QosDurability, QosHistory, QosReliability

from impact_observer.io import interfaces
from impact_observer.io.interfaces import EVENTS, LATCHED, STATES, Interface, Quality

QUALITIES = st.builds(Quality, st.booleans(), st.booleans(), st.integers(0, 10_000))


@pytest.mark.parametrize(
    ("topic", "expected"),
    [
        ("/impacts", interfaces.IMPACTS),
        ("/rig/impacts", interfaces.IMPACTS),
        ("/plant/joint_states", interfaces.PLANT_JOINT_STATES),
        ("/observer/joint_states", interfaces.OBSERVER_JOINT_STATES),
        ("/observer_geometric/state", interfaces.OBSERVER_STATES),
        ("/rig/observer_open_loop/verdicts", interfaces.OBSERVER_VERDICTS),
        ("/observer_geometric/measurements", interfaces.OBSERVER_MEASUREMENTS),
        ("/smoother/state", interfaces.OBSERVER_STATES),
        ("/rig/smoother/impacts", interfaces.SMOOTHED_IMPACTS),
        ("/smoother/impact_estimates", interfaces.SMOOTHED_ESTIMATES),
        ("/observer/impacts", interfaces.OBSERVER_IMPACTS),
        ("/rig/observer_geometric/impacts", interfaces.OBSERVER_IMPACTS),
        ("/monitor_geometric/error", interfaces.MONITOR_ERROR),
        ("/clock", interfaces.SIMULATED_CLOCK),
        ("/joint_states", None),
        ("/observers/state", None),
        ("/state", None),
        ("/rig/clock", None),
        ("/impacts/more", None),
    ],
)
def test_topic_is_recognised_in_any_namespace_and_of_any_law(
    topic: str, expected: Interface | None
) -> None:
    """Topics of other packages are not in the table."""
    assert interfaces.interface(topic) is expected


def test_impacts_of_observers_are_none_of_a_plant() -> None:
    """A rig in a namespace has one topic of events, whatever its observers estimate."""
    topics = ["/rig/impacts", "/rig/observer/impacts", "/rig/smoother/impacts"]
    assert interfaces.IMPACTS.candidates(topics) == ["/rig/impacts"]
    assert interfaces.OBSERVER_IMPACTS.candidates(topics) == ["/rig/observer/impacts"]


def test_table_offers_the_quality_of_the_contract() -> None:
    """Late subscribers receive events and the model, but no states."""
    assert interfaces.IMPACTS.quality == EVENTS == Quality(True, True, 2000)
    assert interfaces.OBSERVER_STATES.quality == STATES == Quality(True, False, 10)
    assert interfaces.PLANT_MODEL.quality == LATCHED == Quality(True, True, 1)


@given(quality=QUALITIES)
def test_quality_survives_a_bag(quality: Quality) -> None:
    """The quality that is offered is read back."""
    assert Quality.of_publisher(quality.offered()) == quality


def test_depth_that_a_recorder_could_not_see_is_the_usual_one() -> None:
    """``ros2 bag record`` writes the history ``unknown``."""
    offered = EVENTS.offered()._replace(history=QosHistory.UNKNOWN, depth=0)
    assert Quality.of_publisher(offered, depth=2000) == EVENTS


def test_quality_left_open_is_read_as_reliable_and_volatile() -> None:
    """A publisher with the system's defaults is reliable and volatile."""
    offered = STATES.offered()._replace(
        reliability=QosReliability.SYSTEM_DEFAULT, durability=QosDurability.UNKNOWN
    )
    assert Quality.of_publisher(offered) == STATES


@given(offers=st.lists(QUALITIES, min_size=1, max_size=4))
def test_common_quality_connects_to_every_publisher(offers: list[Quality]) -> None:
    """The common quality requests no more than any publisher offers, at the largest depth."""
    common = Quality.common(offers)
    assert all(offer.reliable or not common.reliable for offer in offers)
    assert all(offer.transient_local or not common.transient_local for offer in offers)
    assert common.depth == 0 or all(0 < offer.depth <= common.depth for offer in offers)
