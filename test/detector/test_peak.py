# SPDX-License-Identifier: Apache-2.0
"""Peaks of a signal: places finer than a sample, and the peaks that are impacts."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from signals import MS, START, Stamped, Vector3, detections, events, every, header, peak, sampled
from systems import examples

from impact_observer.detector import Detector, Source
from impact_observer.detector.peak import vertex
from impact_observer.detector.sensors import MAX_DELAY
from impact_observer.detector.source import IMU
from impact_observer.errors import UsageError
from impact_observer.events import Kind
from impact_observer.states import Stamps, Vector

S = 1_000_000_000


def half_sines(stamps: Stamps, tops: ArrayLike, length: float, height: float = 100.0) -> Vector:
    """A pulse of ``length`` (s) about each of ``tops`` (s after START): contact of a spring."""
    t, tops = (stamps - START) * 1e-9, np.atleast_1d(tops)
    t -= tops[np.searchsorted((tops[1:] + tops[:-1]) / 2, t)]
    pulse = np.cos(math.pi * t / length)
    return np.asarray(np.where(np.abs(t) < length / 2, height * pulse, 0.0))


@pytest.mark.parametrize("rate", [100, 1000, 10_000])
@pytest.mark.parametrize("samples", [6, 10, 40])
def test_the_top_of_a_half_sine_is_found_to_better_than_a_hundredth_of_a_sample(
    rate: int, samples: int
) -> None:
    """The error is at most w^2 h^2 / 62 of a sample, the parabola's own for a cosine."""
    period = S // rate
    length = samples / rate
    tops = 0.5 + np.arange(100.0) * (3 * length + 0.00371 / rate) + 0.0137 / rate
    stamps = every(period, int((tops[-1] + 2 * length) * rate))
    source = peak(50.0, dead_time=length)
    detected = events(detections(source, sampled(stamps, half_sines(stamps, tops, length))))
    assert len(detected) == len(tops)
    error = np.array([stamp for stamp, _ in detected]) - START - tops * 1e9
    bound = (math.pi / samples) ** 2 / 62
    assert np.abs(error).max() <= bound * 1.05 * period + 1
    assert np.abs(error).max() <= 0.01 * period
    assert np.abs(error).max() >= 0.5 * bound * period - 1, "the bound is sharp"


@examples(100)
@given(st.floats(-0.4, 0.4), st.floats(0.5, 3.0), st.floats(0.5, 3.0), st.floats(0.1, 1e4))
def test_the_top_of_a_parabola_is_exact_for_uneven_samples(
    top: float, left: float, right: float, height: float
) -> None:
    """Distances are arbitrary, as long as the middle sample is the highest."""
    scale = 1e6

    def point(t: float) -> tuple[int, float]:
        stamp = START + round(t * scale)
        return stamp, -height * ((stamp - START) / scale - top) ** 2

    points = point(-left), point(0.0), point(right)
    if points[1][1] >= max(points[0][1], points[2][1]):
        assert vertex(*points) == pytest.approx(top * scale, abs=0.6 + 1e-6 * scale)


def test_points_without_a_parabola_have_their_vertex_in_the_middle() -> None:
    """A signal that is flat, and two samples with one stamp."""
    assert vertex((0, 1.0), (5, 1.0), (9, 1.0)) == vertex((5, 0.0), (5, 1.0), (9, 0.0)) == 0


@examples(20)
@given(
    st.lists(st.floats(0.03, 0.2), min_size=1, max_size=10),
    st.integers(0, 2**32 - 1),
    st.sampled_from([1000, 4000]),
)
def test_noise_neither_hides_nor_adds_a_peak(gaps: list[float], seed: int, rate: int) -> None:
    """Each half-sine of 8 ms with a tenth of noise is found once, to within a millisecond."""
    tops = 0.05 + np.cumsum(gaps)
    stamps = every(S // rate, int((tops[-1] + 0.1) * rate))
    noise = np.random.default_rng(seed).normal(0.0, 2.0, stamps.size).clip(-10, 10)
    signal = half_sines(stamps, tops, 0.008) + noise
    detected = events(detections(peak(50.0), sampled(stamps, signal)))
    assert [kind for _, kind in detected] == [Kind.IMPACT] * len(tops)
    error = np.array([stamp for stamp, _ in detected]) * 1e-9 - START * 1e-9 - tops
    assert np.abs(error).max() < 1e-3


def test_a_structure_that_rings_after_a_hit_is_one_impact() -> None:
    """A vibration of 400 Hz fades within 10 ms; the impact is its first peak, in closed form."""
    rate, w, fading = 10_000, 2 * math.pi * 400, 1 / 0.004
    stamps = every(S // rate, 3000)
    t = (stamps - START) * 1e-9 - 0.1
    ringing = np.where(t > 0, 100 * np.exp(-fading * t.clip(0)) * np.sin(w * t), 0.0)
    detected = events(detections(peak(20.0), sampled(stamps, ringing)))
    first = 0.1 + math.atan(w / fading) / w
    assert [kind for _, kind in detected] == [Kind.IMPACT]
    assert detected[0][0] == pytest.approx(START + first * 1e9, abs=0.02 * S / rate)


SPIKES = np.zeros(80)
SPIKES[10], SPIKES[50] = 20.0, -20.0
ABOUT_10 = [0, 9.9, 10.1, 9.9, 10.2, 9.8, 10.1, 6.0, 4.9, 0, 12, 0.0]
PLATEAU = half_sines(every(MS, 200), 0.1003, 0.03).clip(0, 60)
SIGNALS: dict[str, tuple[Source, ArrayLike, list[float]]] = {
    "saturated, to half a sample": (peak(50.0, dead_time=0.04), PLATEAU, [100.3]),
    "noise about the threshold": (peak(10.0, hysteresis=5.0, dead_time=0.0), ABOUT_10, [4, 10]),
    "high from the first sample on": (
        peak(10.0, dead_time=0.001),
        [20.0, 30.0, 20.0, 0.0, 20.0, 0.0],
        [4],
    ),
    "both directions": (peak(10.0), SPIKES, [10, 50]),
    "up": (peak(10.0, direction="up"), SPIKES, [10]),
    "down": (peak(10.0, direction="down"), SPIKES, [50]),
}
"""A source, samples of 1 kHz, and the tops of its impacts, ms."""


@pytest.mark.parametrize("name", SIGNALS)
def test_a_peak_begins_above_the_threshold_after_the_signal_has_fallen(name: str) -> None:
    """A peak has one top, that of a plateau is its middle."""
    source, values, tops = SIGNALS[name]
    signal = np.asarray(values, dtype=float)
    detected = events(detections(source, sampled(every(MS, signal.size), signal)))
    found = [(stamp - START) / MS for stamp, _ in detected]
    assert found == pytest.approx(tops, abs=0.5)


def test_a_signal_that_stays_high_is_one_peak_after_the_dead_time() -> None:
    """The next sample or the time ends the peak; the signal must fall before another peak."""
    stamps = every(MS, 100)
    signal = np.where(np.arange(100) < 10, 0.0, 20.0)
    signal[12] = 30.0
    detected = detections(peak(10.0), sampled(stamps, signal))
    assert events(detected) == [(detected[0].event.stamp, Kind.IMPACT)]
    assert detected[0].event.stamp == pytest.approx(START + 12 * MS, abs=0.5 * MS)
    assert detected[0].decided == START + 30 * MS
    held = detections(peak(10.0), sampled(stamps, signal)[:14], START + 100 * MS)
    assert [(d.event, d.decided) for d in held] == [
        (detected[0].event, START + 30 * MS + MAX_DELAY)
    ]


def test_gravity_is_removed_in_any_orientation() -> None:
    """30 m/s^2 across gravity is found; gravity that slowly turns is not."""
    source = Source("stop", "/imu", threshold=15.0, field="force").complete(IMU)
    detector = Detector([source])
    detected = []
    for k in range(10_000):
        angle = 0.4 * k / 1000
        hit = 30.0 if k % 5000 == 2500 else 0.0
        force = Vector3(9.81 * math.sin(angle) + hit, 0.0, 9.81 * math.cos(angle))
        stamp = START + k * MS
        detected += detector.feed(0, Stamped(header(stamp), force), stamp + 3 * MS)
    wanted = [START + k * 5000 * MS + 2500 * MS for k in range(2)]
    np.testing.assert_allclose([s for s, _ in events(detected)], wanted, rtol=0, atol=0.02 * MS)
    assert 25 < detector.counts[0].largest_signal < 35


def test_a_vector_has_no_direction() -> None:
    """A vector is neither open nor closed: the error asks for one of its components."""
    up = Source("stop", "/t", field="force", threshold=1.0, direction="up")
    for source in (up, Source("stop", "/t", field="force", kind="switch")):
        detector = Detector([source.complete("x/msg/Y")])
        with pytest.raises(UsageError, match="field"):
            detector.feed(0, Stamped(header(START)), START)


def test_an_arrival_is_an_impact_but_for_those_in_the_dead_time() -> None:
    """Arrivals count by the header's stamp, whenever the message is received."""
    source = Source("stop", "/hit", kind="arrival", dead_time=0.01).complete("x/msg/Y")
    detector = Detector([source])
    stamps = [START + k * MS for k in (0, 5, 10, 12, 30)]
    detected = [d for s in stamps for d in detector.feed(0, Stamped(header(s)), s + 7 * MS)]
    assert events(detected) == [(START + k * MS, Kind.IMPACT) for k in (0, 10, 30)]


def test_noise_of_a_peak_is_as_documented() -> None:
    """The error is the deviation over the sum of the differences beside the top, in samples."""
    w, deviation = math.pi / 10, 0.3
    tops = 0.1 + np.arange(400.0) * 0.0500137
    stamps = every(MS, int(tops[-1] * 1000) + 100)
    noise = np.random.default_rng(1).normal(0.0, deviation, stamps.size)
    signal = half_sines(stamps, tops, 0.01) + noise
    detected = events(detections(peak(50.0), sampled(stamps, signal)))
    error = (np.array([stamp for stamp, _ in detected]) - START) / MS - tops * 1e3
    off = tops * 1e3 - np.rint(tops * 1e3)
    beside = 200 * (1 - math.cos(w)) * np.cos(w * off)
    wanted = deviation * math.sqrt(np.mean((0.5 + 6 * off**2) / beside**2))
    assert np.std(error) == pytest.approx(wanted, rel=0.1)
    assert wanted == pytest.approx(deviation * np.mean(1 / beside), rel=0.05)
