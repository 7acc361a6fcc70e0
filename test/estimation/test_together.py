"""Estimates that are made together are those that are made alone, in every bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import (
    EPOCH,
    Harmonic,
    chain,
    examples,
    forcing,
    observer,
    run,
    sample,
    system,
    systems,
    without_faults,
)

from impact_observer.dynamics.flow.flow import Motion
from impact_observer.dynamics.flow.spectral import flow_of
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import System
from impact_observer.observer import Observer, law_names
from impact_observer.stamps import NS_PER_S, grid
from impact_observer.states import Estimate

SIZES = (1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 33, 64, 100, 257, 1000)
"""Of batches: about the widths of vector registers, and about those of blocks of BLAS."""


def motions() -> dict[str, Motion]:
    """One of each kind of flow and of spectrum."""
    loads = [Harmonic(2.5, [0, 4], [1, 0]), Harmonic(0.3, [1, 2], [0, 0])]
    many = chain(12, force=forcing(12, 0.1, [Harmonic(1.7, np.ones(12).tolist(), [0.0] * 12)]))
    made = {
        "free": chain(2),
        "driven": chain(2, force=forcing(2, [1, -2], loads)),
        "many": many,
        "overdamped": system(np.eye(2), 30 * np.eye(2), [[20, -10], [-10, 10]]),
        "resonant": system(1, 0, 4, force=forcing(1, 0, [Harmonic(2.0, [1], [0])])),
        "dense": system(np.eye(2), [[2, 1], [0, 2]], np.eye(2)),
        "soft": system(np.eye(1), 0, 1e-6, force=forcing(1, 9.81)),
    }
    return {name: start(each) for name, each in made.items()}


def start(model: System) -> Motion:
    """A motion with a random state."""
    x = np.random.default_rng(4).normal(size=2 * model.n)
    return flow_of(model).start(0.37, x)


def each_alone(motion: Motion, s: NDArray[np.float64]) -> bytes:
    """The bytes of the states, asked for one by one."""
    return b"".join(motion.state(at).tobytes() for at in s.tolist())


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=pytest.mark.slow if kind in {"resonant", "soft"} else ())
        for kind in motions()
    ],
)
def test_states_are_those_of_each_instant_alone(kind: str) -> None:
    """Whatever the size of the batch and wherever in it an instant stands."""
    motion, random = motions()[kind], np.random.default_rng(7)
    for size in SIZES[: -1 if kind in {"dense", "resonant", "soft"} else None]:
        s = np.sort(random.uniform(0, 50, size))
        assert motion.each(s).tobytes() == each_alone(motion, s)
        assert motion.each(s[::-1]).tobytes() == each_alone(motion, s[::-1])


@examples(60)
@given(systems(), st.sampled_from(SIZES[:12]), st.floats(1e-9, 1e3))
def test_states_of_any_system_are_those_of_each_instant_alone(
    model: System, size: int, longest: float
) -> None:
    """Rigid bodies, critical damping, resonance."""
    motion = start(model)
    s = np.linspace(longest / size, longest, size)
    assert motion.each(s).tobytes() == each_alone(motion, s)


def bits(estimate: Estimate) -> tuple[object, ...]:
    """Everything that an estimate says."""
    arrays = (estimate.q, estimate.u, estimate.covariance)
    others = (estimate.stamp, estimate.law, estimate.closed, estimate.convergence)
    more = (estimate.synchronized, estimate.bound, estimate.inconsistent, estimate.parameters)
    last = (estimate.clock_offset, estimate.last_sequence, estimate.last_event)
    return (*(each.tobytes() for each in arrays), *others, *more, *last)


def checked(watcher: Observer, stamps: NDArray[np.int64]) -> list[int]:
    """Compare what is made together with what is made alone; how many were together."""
    told = list(watcher.estimates(stamps))
    found = [bits(each) for together in told for each in together]
    assert found == [bits(watcher.estimate(stamp)) for stamp in stamps.tolist()]
    for together in told:
        assert together.stamps.size == len(together.x)
        last = together.part(len(together.x) - 1, len(together.x))
        assert bits(last.first) == bits(watcher.estimate(int(last.stamps[0])))
    return [each.stamps.size for each in told]


@pytest.mark.parametrize("law", law_names())
def test_estimates_are_those_of_each_stamp_alone(law: str) -> None:
    """Between events, at their very stamps, and where the known past begins."""
    model = sample("three_mass")
    truth = run(model.system, *model.initial_state(), seconds=3.0)
    start = [0.2, -0.1, 0.1, 0.3, 0.0, -0.2]
    watcher = observer(model.system, law, start, epoch=EPOCH, uncertainty=without_faults())
    for each in truth.events:
        watcher.receive(each)
    own = [each.stamp for each in truth.events]
    stamps = np.unique([*grid(EPOCH, EPOCH + 3 * NS_PER_S, 200.0).tolist(), *own])
    together = checked(watcher, stamps)
    assert sum(together) == stamps.size
    assert law == "minimum-variance" or max(together) > 10
    assert checked(watcher, np.repeat(stamps[:9], 2))


@pytest.mark.parametrize(
    "law",
    [
        pytest.param("kinematic", marks=pytest.mark.slow),
        "geometric",
        pytest.param("unilateral", marks=pytest.mark.slow),
    ],
)
def test_estimates_during_lasting_contact_are_those_of_each_stamp_alone(law: str) -> None:
    """Phase after phase, while the stop stays closed."""
    model = sample("two_mass").system
    watcher = observer(model, law, [0.3, 0.4, 1.0, 2.0], epoch=EPOCH)
    at = EPOCH + NS_PER_S // 3
    watcher.receive(ImpactEvent(at, (Switch("stop", Kind.CLOSE),), 1, 0, EPOCH))
    together = checked(watcher, grid(EPOCH, at + 2 * NS_PER_S, 100.0))
    assert len(together) == 2


def test_estimates_before_the_known_past_are_refused() -> None:
    """As one alone is."""
    watcher = observer(sample("two_mass").system, "geometric", [0.0] * 4, epoch=EPOCH)
    with pytest.raises(UsageError, match="the known past begins at 5"):
        list(watcher.estimates(np.array([EPOCH - 1, EPOCH])))
    assert list(watcher.estimates(np.empty(0, dtype=np.int64))) == []
