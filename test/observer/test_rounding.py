# SPDX-License-Identifier: Apache-2.0
"""Ideal runs as accurate as arithmetic allows: the covariance says so, and no more."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import EPOCH, PRESSED, observer, run, sample, without_faults

from impact_observer.model import Forcing, System
from impact_observer.model.angles import Angles
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S, grid

Array = NDArray[np.float64]
EPS = float(np.finfo(np.float64).eps)


def advanced(forcing: Forcing, seconds: int) -> Forcing:
    """The same harmonics ``seconds`` later; their angles are exact but for whole turns."""
    angles = Angles(forcing.frequency).at_stamps(np.array([seconds * NS_PER_S])).T
    c, s, cosine, sine = np.cos(angles), np.sin(angles), forcing.cosine, forcing.sine
    return replace(forcing, cosine=c * cosine + s * sine, sine=c * sine - s * cosine)


def normalised_errors(model: System, x: Array, seconds: float, late: int) -> Array:
    """Errors over their deviations, of an observer that starts at the state ``x``.

    The motion begins ``late`` seconds after the epoch. Shape (samples, 2n), without samples that
    are within 1 ms of a switching.
    """
    start = EPOCH + late * NS_PER_S
    q, u = np.split(x, 2)
    plant = Plant(replace(model, forcing=advanced(model.forcing, late)), q, u, epoch=start)
    stamps = grid(start + NS_PER_S, start + round(seconds * NS_PER_S), 7.3)
    whole = simulate(plant, stamps)
    declared = without_faults(model_error=0.0)
    watcher = observer(model, "minimum-variance", x, uncertainty=declared, epoch=EPOCH)
    watcher.set_state(start, q, u, np.zeros((x.size, x.size)))
    switched = np.array([each.instant.stamp for each in whole.switchings])
    events, found = [replace(each, epoch=EPOCH) for each in whole.events], list[Array]()
    for stamp, state in zip(stamps.tolist(), whole.states, strict=True):
        while events and events[0].stamp <= stamp:
            watcher.receive(events.pop(0))
        if np.min(np.abs(switched - stamp)) < NS_PER_S // 1000:
            continue
        estimate = watcher.estimate(stamp)
        error = np.concatenate([estimate.q, estimate.u]) - state
        found.append(error / np.sqrt(np.diag(estimate.covariance)))
    return np.array(found)


@pytest.mark.parametrize("late", [0, 100_000, 10_000_000])
@pytest.mark.parametrize("name", ["two_mass", "three_mass"])
def test_covariance_of_a_converged_estimate_is_consistent_however_late(
    name: str, late: int
) -> None:
    """The angle of a forcing is then many times the rounding of the product ``omega t``.

    The deviation of a late estimate is that of the rounded time, which is wide.
    """
    model = sample(name)
    x = np.concatenate(model.initial_state())
    z = np.abs(normalised_errors(model.system, x, 30.0, late))
    assert (0.01 if late else 0.05) < float(np.median(z)) < 1.5
    assert float(np.max(z)) < 5


def test_covariance_is_consistent_while_contacts_stay_closed() -> None:
    """They close and open a day after the epoch; a closed contact has a singular covariance."""
    z = np.abs(normalised_errors(PRESSED, np.zeros(4), 8.0, 86_400))
    assert float(np.max(z)) < 5


@pytest.mark.parametrize("name", ["two_mass", "pressed"])
def test_no_deviation_is_below_rounding(name: str) -> None:
    """Nor that of a gap, even where the initial state is declared to be exact."""
    model = PRESSED if name == "pressed" else sample(name).system
    start = (np.zeros(2), np.zeros(2)) if name == "pressed" else sample(name).initial_state()
    whole = run(model, *start, seconds=6.0, rate=10.0)
    declared = without_faults(deviation=0.0, model_error=0.0)
    watcher = observer(
        model, "minimum-variance", np.concatenate(start), uncertainty=declared, epoch=EPOCH
    )
    for event in whole.events:
        watcher.receive(event)
    closed = 0
    for stamp in whole.stamps.tolist():
        found = watcher.estimate(stamp)
        x, n = np.concatenate([found.q, found.u]), model.n
        assert np.all(np.sqrt(np.diag(found.covariance)) >= EPS / 2 * np.abs(x))
        gaps = np.diag(model.W.T @ found.covariance[:n, :n] @ model.W)
        terms = np.max(np.abs(model.W * found.q[:, None]), axis=0)
        assert np.all(np.sqrt(gaps) >= EPS / 2 * terms)
        closed += len(found.closed)
    assert (closed > 0) == (name == "pressed")
