# SPDX-License-Identifier: Apache-2.0
"""Comparing estimates with the truth: the two sides of a jump do not mix."""

from collections.abc import Iterable

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import sample

from impact_observer.compare.comparison import Comparison, compare_replicas, compare_states
from impact_observer.compare.mismatch import windows
from impact_observer.dynamics.lyapunov import distance
from impact_observer.errors import BagError
from impact_observer.events import ImpactEvent, Ruling, Switch, Verdict
from impact_observer.io.pairing import HOLD, Samples, samples_of
from impact_observer.model import read_model
from impact_observer.observer import Options, make_observer
from impact_observer.observer.event_outcomes import outcomes_of
from impact_observer.plant import Plant, Run, SensorModel, simulate, simulate_sensor
from impact_observer.stamps import NS_PER_S, grid

SYSTEM = sample("two_mass").system
EPOCH = NS_PER_S
SECONDS = 20


def run_of(rate: float = 1000.0) -> Run:
    """A run of two_mass over twenty seconds."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    return simulate(plant, grid(EPOCH, EPOCH + SECONDS * NS_PER_S, rate))


RUN = run_of()


def compared(
    truth: Samples,
    estimates: Samples,
    events: Iterable[ImpactEvent] = (),
    verdicts: Iterable[Verdict] | None = None,
) -> Comparison:
    """The comparison of some estimates of two_mass."""
    return compare_states(SYSTEM, "some law", truth, estimates, outcomes_of(events, verdicts))


def shifted(delay: int) -> NDArray[np.float64]:
    """The run's own states, so many samples later: an estimate that jumps late each time."""
    return np.vstack([RUN.states[:1].repeat(delay, axis=0), RUN.states[: len(RUN.states) - delay]])


def test_metrics_are_those_of_plain_formulas() -> None:
    """The formulas give errors, V, settling time and rate of an estimate with a fading error."""
    rng = np.random.default_rng(3)
    x = RUN.states + rng.normal(size=RUN.states.shape) * np.exp(-np.arange(20001) / 3000)[:, None]
    truth, estimate = samples_of(RUN.stamps, RUN.states), samples_of(RUN.stamps, x)
    found = compared(truth, estimate)
    error = x - RUN.states
    V = distance(SYSTEM, error[:, :2], error[:, 2:])
    np.testing.assert_array_equal(found.stamps, RUN.stamps)
    np.testing.assert_array_equal(found.error, error)
    np.testing.assert_array_equal(found.V, V)
    np.testing.assert_allclose(found.rms, np.sqrt(np.mean(error**2, axis=0)), rtol=1e-12)
    np.testing.assert_array_equal(found.largest, np.max(np.abs(error), axis=0))
    np.testing.assert_array_equal(found.error[-1], error[-1])
    assert found.largest_rise == pytest.approx(np.max(np.diff(V)) / V[0], rel=1e-12)
    above = np.flatnonzero(0.01 * V[0] < V)
    assert found.settling_time == pytest.approx((above[-1] + 1) / 1000, abs=1e-9)
    near = np.flatnonzero(10 * V[-1] >= V)[0]
    assert found.rate_per_second == pytest.approx(np.log(V[0] / V[near]) / (near / 1000))


@pytest.mark.parametrize("delay", [1, 3, 8])
def test_a_late_jump_is_a_mismatch_and_no_error(delay: int) -> None:
    """The mismatch at every impact has as many samples as the estimate is late."""
    delayed = [
        ImpactEvent(e.stamp + delay * 1_000_000, e.switches, e.sequence) for e in RUN.events
    ]
    truth, late = samples_of(RUN.stamps, RUN.states), samples_of(RUN.stamps, shifted(delay))
    found = compared(truth, late, delayed)
    assert found.mismatch.windows == len(RUN.events)
    assert found.mismatch.samples == delay * len(RUN.events)
    assert found.mismatch.longest == pytest.approx(delay * 1e-3, abs=1e-9)
    jumps = np.abs(np.diff(RUN.states[:, 3])).max()
    assert 0.4 * jumps**2 < found.mismatch.V, "half the square of the jump, m = 1 kg"
    assert found.largest[3] < 0.2 * jumps, "no jump is among the errors"
    assert found.samples + found.mismatch.samples == RUN.stamps.size
    early = compared(late, truth, RUN.events)
    assert early.mismatch.samples == delay * len(RUN.events), "whichever of the two is late"


def test_rates_are_finite_where_an_estimate_is_exact_for_a_moment() -> None:
    """V is zero there, which has no logarithm; the rate is that of the fall before the end."""
    truth, estimate = samples_of(RUN.stamps, RUN.states), samples_of(RUN.stamps, RUN.states)
    decay = np.exp(-np.arange(RUN.stamps.size) / 2000)
    estimate["x"][:, 1] += decay
    estimate["x"][9_000] = truth["x"][9_000]
    found = compared(truth, estimate, RUN.events)
    assert found.V.min() == 0.0
    assert found.rate_per_second == pytest.approx(1.0, rel=1e-9)


def test_jumps_at_the_same_sample_are_no_mismatch() -> None:
    """The estimate's jump may have any size and sign; openings are among the events."""
    for factor in (0.1, 1.0, -0.7):
        found = compared(
            samples_of(RUN.stamps, RUN.states),
            samples_of(RUN.stamps, RUN.states * factor),
            RUN.events,
        )
        assert found.mismatch.windows == found.mismatch.samples == 0
        assert found.samples == RUN.stamps.size


def test_a_jump_of_the_estimate_at_the_next_impact_belongs_to_that_one() -> None:
    """The estimate hardly jumps at the first of two impacts, so no sample is a mismatch there."""
    stamps = np.arange(1, 301) * 1_000_000
    first, second = int(stamps[100]), int(stamps[180])
    falling = -np.arange(300) / 40.0
    truth = falling + 2.0 * (stamps >= first) + 2.0 * (stamps >= second)
    estimate = falling + 0.1 * (stamps >= first) + 2.0 * (stamps >= second)
    for impact, other in ((first, second), (second, first)):
        begin, end = windows(stamps, truth, estimate, impact, [other])
        assert begin == end
    estimates = np.stack([estimate, truth])
    begin, end = windows(stamps, truth, estimates, first)
    assert begin.tolist() == [first, first]
    assert end.tolist() == [second, first], "without another impact it is this one's"


def test_a_spurious_impact_is_an_error_and_no_mismatch() -> None:
    """A jump of the estimate without a jump of the truth is an error."""
    instant = (RUN.events[2].stamp + RUN.events[3].stamp) // 2
    x = RUN.states.copy()
    x[np.searchsorted(RUN.stamps, instant) :, 3] += 5.0
    spurious = ImpactEvent(instant, (Switch("stop"),))
    found = compared(
        samples_of(RUN.stamps, RUN.states), samples_of(RUN.stamps, x), [*RUN.events, spurious]
    )
    assert found.mismatch.windows == 0
    assert found.largest[3] == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("rate", "delay", "least"),
    [(20.0, 0.03, 5), pytest.param(1e3, 4e-3, 31, marks=pytest.mark.slow)],
)
def test_windows_are_as_long_as_the_errors_of_the_stamps(
    rate: float, delay: float, least: int
) -> None:
    """The windows are those between the plant's true instants and the received stamps.

    Also where samples are so coarse that the curvature of a speed shows.
    """
    sampled = run_of(rate)
    sensor = SensorModel(delay=delay, jitter=delay / 2)
    last = int(sampled.stamps[-1])
    sensed = simulate_sensor(sensor, SYSTEM, sampled.switchings, epoch=EPOCH, last=last, seed=2)
    events = [each.event for each in sensed]
    options = Options("geometric", "random:1", clock_error=0.0, ensemble=1)
    observer = make_observer(SYSTEM, options)
    truth = samples_of(sampled.stamps, sampled.states)
    (found,) = compare_replicas(observer, events, truth)
    samples = 0
    for true, received in zip(sampled.events, events, strict=False):
        a, b = sorted(np.searchsorted(sampled.stamps, [true.stamp, received.stamp]))
        samples += b - a
    assert samples >= least
    assert found.mismatch.samples == samples
    assert found.outcomes.until(last) == len(events)


def test_the_last_estimate_at_a_stamp_counts() -> None:
    """A live estimate is published again when a late event corrects it, also much later."""
    wrong = samples_of(RUN.stamps[:5000], RUN.states[:5000] + 7.0)
    right = samples_of(RUN.stamps, RUN.states + 0.5)
    found = compared(samples_of(RUN.stamps, RUN.states), np.concatenate([wrong, right]))
    np.testing.assert_allclose(found.largest, 0.5)
    assert found.stale == 0


def test_states_that_come_long_after_later_ones_are_counted_and_left_out() -> None:
    """A bag that was played twice while it was recorded: the first pass counts."""
    truth = samples_of(RUN.stamps, RUN.states)
    again = samples_of(RUN.stamps, RUN.states + 1.0)
    found = compared(np.concatenate([truth, again]), np.concatenate([truth, again]))
    held = HOLD // 1_000_000
    assert found.samples == RUN.stamps.size
    assert found.stale == 2 * (RUN.stamps.size - held)


def test_an_estimate_without_its_event_is_late() -> None:
    """A late estimate is counted and left out: neither an error nor a mismatch."""
    stamps = RUN.stamps
    instants = np.array([e.stamp for e in RUN.events])
    last_event = np.concatenate([[0], instants])[np.searchsorted(instants, stamps, side="right")]
    here = int(np.searchsorted(stamps, instants[4]))
    last_event[here : here + 6] = instants[3]
    x = RUN.states.copy()
    x[here : here + 6, 3] -= 3.0
    found = compared(samples_of(stamps, RUN.states), samples_of(stamps, x, last_event), RUN.events)
    assert found.late == 6
    assert found.mismatch.samples == 0
    assert not found.largest.any()


def test_a_missed_impact_makes_no_estimate_late() -> None:
    """Until the missed impact is inserted the estimate has an error, but is not late."""
    stamps, missed, later = RUN.stamps, RUN.events[4], 60
    instants = np.array([e.stamp for e in RUN.events])
    last_event = np.concatenate([[0], instants])[np.searchsorted(instants, stamps, side="right")]
    here = int(np.searchsorted(stamps, missed.stamp))
    last_event[here : here + later] = instants[3]
    x = RUN.states.copy()
    x[here : here + later, 1] += 2.0
    verdicts = [
        Verdict(e.stamp, Ruling.INSERTED if e is missed else Ruling.APPLIED, 0, "stop")
        for e in RUN.events
    ]
    received = [e for e in RUN.events if e is not missed]
    found = compared(
        samples_of(stamps, RUN.states), samples_of(stamps, x, last_event), received, verdicts
    )
    assert found.late == 0
    assert found.largest[1] == pytest.approx(2.0)
    assert found.outcomes.until(int(stamps[-1])) == len(RUN.events)


def test_a_withdrawn_insertion_is_no_rejected_event() -> None:
    """A withdrawn insertion has no event at its stamp."""
    events = [ImpactEvent(2 * NS_PER_S, (Switch("stop"),), 1)]
    verdicts = [
        Verdict(2 * NS_PER_S, Ruling.APPLIED, 1, "stop"),
        Verdict(3 * NS_PER_S, Ruling.INSERTED, 0, "stop"),
        Verdict(3 * NS_PER_S, Ruling.REJECTED, 0, "stop", revises=True),
    ]
    outcomes = outcomes_of(events, verdicts)
    assert outcomes.rulings == {Ruling.APPLIED: 1}
    assert outcomes.impacts == ((2 * NS_PER_S, "stop"),)


def test_both_ranges_are_named_where_they_do_not_overlap() -> None:
    """The error names both ranges in seconds, in one line."""
    truth = samples_of(RUN.stamps, RUN.states)
    estimate = samples_of(RUN.stamps + 3600 * NS_PER_S, RUN.states)
    with pytest.raises(BagError) as error:
        compared(truth, estimate)
    assert str(error.value) == (
        "some law: truth and estimate have no stamp in common: truth 1.000000000 to 21.000000000"
        " s, estimate 3601.000000000 to 3621.000000000 s; both must be sampled at the same"
        " instants"
    )


def test_rejected_impacts_are_not_used_and_inserted_ones_are() -> None:
    """The last verdict on each switch counts."""
    events = [ImpactEvent(s * NS_PER_S, (Switch("stop"),), s) for s in (2, 3, 4)]
    verdicts = [
        Verdict(2 * NS_PER_S, Ruling.APPLIED, 2, "stop"),
        Verdict(3 * NS_PER_S, Ruling.APPLIED, 3, "stop"),
        Verdict(3 * NS_PER_S, Ruling.REJECTED, 3, "stop", revises=True),
        Verdict(4 * NS_PER_S, Ruling.REJECTED, 4, "stop"),
        Verdict(5 * NS_PER_S, Ruling.INSERTED, 0, "stop"),
    ]
    outcomes = outcomes_of(events, verdicts)
    assert outcomes.impacts == ((2 * NS_PER_S, "stop"), (5 * NS_PER_S, "stop"))
    assert outcomes.instants.tolist() == [2 * NS_PER_S, 5 * NS_PER_S]
    assert outcomes.rulings == {Ruling.APPLIED: 1, Ruling.REJECTED: 2, Ruling.INSERTED: 1}
    assert outcomes.until(3 * NS_PER_S) == 1
