# SPDX-License-Identifier: Apache-2.0
"""The choice of a detector's options, on signals whose hits are known."""

import numpy as np
import pytest
from numpy.typing import ArrayLike
from signals import Scalar

from impact_observer.detector import Detector, Source
from impact_observer.errors import BagError
from impact_observer.model import parse_model, read_model
from impact_observer.recording.detection_choice import (
    ExpectedImpacts,
    choose_detection,
    expected_impacts,
    simulated_impacts,
)
from impact_observer.states import Stamps, Vector

RATE = 20_000
START = 10**9


def ringing(
    hits: ArrayLike, heights: ArrayLike, *, decay: float = 0.003, noise: float = 0.02
) -> tuple[Stamps, Vector]:
    """Two seconds of a signal that rings at 2 kHz after each hit, with an offset of gravity."""
    t = np.arange(2 * RATE) / RATE
    values = 9.81 + noise * np.random.default_rng(5).normal(size=t.size)
    for hit, height in zip(np.asarray(hits), np.asarray(heights), strict=True):
        s = np.maximum(t - hit, 0.0)
        values += height * np.sin(2 * np.pi * 2000 * s) * np.exp(-s / decay)
    return START + np.round(t * 1e9).astype(np.int64), values


def detected(source: Source, stamps: Stamps, values: Vector) -> Vector:
    """Instants that the detector finds with the declaration ``source``, s."""
    detector = Detector([source.complete("std_msgs/msg/Float64")])
    found = []
    for stamp, value in zip(stamps.tolist(), values.tolist(), strict=True):
        found += detector.feed(0, Scalar(value), stamp)
    found += detector.advance(int(stamps[-1]) + 10**9)
    return np.array([(each.event.stamp - START) / 1e9 for each in found])


BALL = """name: ball
bodies: [{name: height, mass: 1}]
forces: [{body: height, constant: -9.81}]
stops: [{name: floor, body: height, limit: 0, side: below, restitution: 0.5}]
"""
SENSOR = Source(contact="stop", topic="/az")
HITS = np.cumsum([0.1, *([0.04, 0.011] * 18)])
HEIGHTS = np.resize([3.0, 1.0, 0.6], HITS.size)
EXPECTED = ExpectedImpacts(interval=0.01, rate=HITS.size / 2)


@pytest.mark.parametrize(
    ("hits", "expected"), [(HITS, EXPECTED), (HITS[::2], None)], ids=["model", "no model"]
)
def test_hits_in_the_ringing_of_louder_ones_are_found(
    hits: Vector, expected: ExpectedImpacts | None
) -> None:
    """All hits of a signal that still rings when the next one comes, with one instant each."""
    stamps, values = ringing(hits, HEIGHTS[: hits.size])
    chosen = choose_detection(SENSOR, stamps, values, expected)
    found = detected(chosen.source, stamps, values)
    assert found.size == hits.size
    assert np.ptp(found - hits) < 2 / RATE
    assert chosen.source.baseline
    assert not chosen.doubts


def test_echoes_are_refused() -> None:
    """A room that answers each hit twice makes no impacts."""
    echoes = [(HITS[::2], 1.0), (HITS[::2] + 0.006, 0.35), (HITS[::2] + 0.012, 0.2)]
    hits = np.concatenate([each[0] for each in echoes])
    heights = np.concatenate([np.full(each[0].size, each[1]) for each in echoes])
    stamps, values = ringing(hits, heights)
    expected = ExpectedImpacts(interval=0.04, rate=10.0)
    chosen = choose_detection(SENSOR, stamps, values, expected)
    found = detected(chosen.source, stamps, values)
    assert found.size == HITS[::2].size
    assert np.ptp(found - HITS[::2]) < 2 / RATE


def test_a_signal_whose_second_half_wave_is_higher_is_stamped_at_its_onset() -> None:
    """The top of such a signal jumps between half-waves."""
    stamps, values = ringing(HITS[::2], HEIGHTS[::2])
    late, more = ringing(HITS[::2] + 0.00025, 2 * HEIGHTS[::2])
    assert np.array_equal(stamps, late)
    chosen = choose_detection(SENSOR, stamps, values - more, ExpectedImpacts(0.04, 9.5))
    assert chosen.source.instant == "onset"


def test_weaker_knocks_of_another_part_are_refused_and_kept_for_a_picture() -> None:
    """The threshold stands between two kinds of peaks where the model expects one of them."""
    hits, knocks = HITS[::2], HITS[::2] + 0.035
    stamps, values = ringing([*hits, *knocks], [*([2.0] * hits.size), *([0.3] * knocks.size)])
    chosen = choose_detection(SENSOR, stamps, values, ExpectedImpacts(0.04, hits.size / 2))
    assert detected(chosen.source, stamps, values).size == hits.size
    shown = (chosen.refused - START) / 1e9
    assert all(np.min(np.abs(shown - knock)) < 1e-3 for knock in knocks)


def test_soft_hits_are_impacts_where_the_model_has_them_too() -> None:
    """Half of the hits are so soft that they may be of a chatter."""
    stamps, values = ringing(HITS, np.where(np.arange(HITS.size) % 2, 0.2, 3.0))
    expected = ExpectedImpacts(0.01, 0.6 * HITS.size / 2, soft=0.5 * HITS.size / 2)
    chosen = choose_detection(SENSOR, stamps, values, expected)
    assert detected(chosen.source, stamps, values).size == HITS.size
    assert not chosen.doubts


def test_another_number_of_impacts_than_the_model_has_is_a_doubt() -> None:
    """Of a tenth of the expected impacts a line says so."""
    stamps, values = ringing(HITS[:4], HEIGHTS[:4])
    chosen = choose_detection(SENSOR, stamps, values, ExpectedImpacts(0.01, 60.0))
    assert any("stop" in each for each in chosen.doubts)


def test_what_is_declared_is_kept() -> None:
    """The user's options are not chosen again."""
    stamps, values = ringing(HITS, HEIGHTS)
    given = Source("stop", "/az", threshold=0.5, dead_time=0.02, decay=0.0, instant="top")
    chosen = choose_detection(given, stamps, values, EXPECTED).source
    assert (chosen.threshold, chosen.dead_time, chosen.decay, chosen.instant) == (
        0.5,
        0.02,
        0.0,
        "top",
    )


@pytest.mark.parametrize("digits", [0, 6])
def test_noise_alone_is_an_error_that_names_the_topic(digits: int) -> None:
    """No peak is louder than chance has it."""
    stamps, values = ringing([], [])
    with pytest.raises(BagError, match="/az"):
        choose_detection(SENSOR, stamps, np.round(values, digits), EXPECTED)


@pytest.mark.parametrize(("soft", "hum"), [(1.0, 0.2), (0.3, 0.05)])
def test_hits_above_a_hum_are_found(soft: float, hum: float) -> None:
    """White noise of the size of this hum may be louder than the hits."""
    stamps, values = ringing(HITS[::2], np.resize([1.0, soft], HITS[::2].size))
    values += hum * np.sin(100 * np.pi * (stamps - START) / 1e9)
    chosen = choose_detection(SENSOR, stamps, values, ExpectedImpacts(0.04, 9.5))
    assert detected(chosen.source, stamps, values).size == HITS[::2].size


def test_a_long_ringing_is_no_row_of_impacts() -> None:
    """Between hits far apart the signal rings for longer than the shortest usual interval."""
    hits = 0.1 + 0.15 * np.arange(12)
    stamps, values = ringing(hits, np.resize([3.0, 1.0], hits.size), decay=0.025)
    chosen = choose_detection(SENSOR, stamps, values, ExpectedImpacts(0.02, hits.size / 2))
    assert detected(chosen.source, stamps, values).size == hits.size


def test_ever_softer_bounces_are_found() -> None:
    """The ratio of the first two bounces is the largest one and parts no impacts from noise."""
    softer = 0.75 ** np.arange(14)
    heights = np.array([3.0, *(1.8 * softer)])
    stamps, values = ringing(0.1 + np.cumsum([0.0, *(0.3 * softer)]), heights)
    chosen = choose_detection(SENSOR, stamps, values, ExpectedImpacts(0.02, 0.0))
    assert np.sum(heights > 0.2) <= detected(chosen.source, stamps, values).size <= heights.size


def test_a_model_tells_how_often_its_impacts_come() -> None:
    """The period-one motion of three_mass; a ball at rest tells nothing."""
    model = read_model("three_mass")
    found = expected_impacts(simulated_impacts(model, 60.0), model.noticed)
    assert found is not None
    assert 0 < found.interval < 1 / found.rate
    resting = simulated_impacts(parse_model(BALL, "ball.yaml"), 10.0)
    assert expected_impacts(resting, ["floor"]) is None


def test_soft_impacts_of_a_driven_model_are_counted_apart() -> None:
    """A press falls each second and bounces: at half of the speed, a quarter, and so on."""
    text = """name: press
bodies: [{name: ram, mass: 1}]
springs: [{between: [ground, ram], stiffness: 100, damping: 1}]
forces: [{body: ram, constant: -30}, {body: ram, amplitude: 60, frequency: 6.283185307}]
stops: [{name: anvil, body: ram, limit: 0, side: below, restitution: 0.3}]
"""
    simulated = simulated_impacts(parse_model(text, "press.yaml"), 30.0)
    assert simulated is not None
    found = expected_impacts(simulated, ["anvil"])
    assert found is not None
    assert 0 < found.soft <= len(simulated.every) / 30 - found.rate + 0.5
    assert found.rate == pytest.approx(len(simulated.impacts) / 30, rel=0.5)


def test_the_soft_end_of_a_chatter_is_not_expected() -> None:
    """A ball that loses half of its speed at each bounce: below an eighth nothing counts."""
    start = "initial_state: {position: [1], velocity: [0]}\n"
    simulated = simulated_impacts(parse_model(BALL + start, "ball.yaml"), 10.0)
    found = expected_impacts(simulated, ["floor"])
    assert found is not None
    assert found.rate == 0
    assert expected_impacts(simulated, []) is None
    flight = 2 * np.sqrt(2 * 9.81) / 9.81
    assert flight / 16 < found.interval < flight / 4
