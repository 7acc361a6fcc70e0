# SPDX-License-Identifier: Apache-2.0
"""Rows of bounces: a debounced switch reports their first edges, and a force may be other."""

import numpy as np
from systems import press

from impact_observer.events import ImpactEvent, Kind, Ruling, Switch
from impact_observer.model import System
from impact_observer.observer import make_observer, replay
from impact_observer.options import Options
from impact_observer.plant import Plant, simulate
from impact_observer.plant.simulation import Run
from impact_observer.stamps import from_seconds, grid
from impact_observer.states import Estimate, Matrix, Stamps

EPOCH = 1_700_000_000 * 10**9
SECONDS = 15.0


def stroke(system: System, start: float) -> Run:
    """The motion from rest at a position of both bodies, m, with five samples a second."""
    stamps = grid(EPOCH, EPOCH + from_seconds(SECONDS), 5.0)
    return simulate(Plant(system, np.full(2, start), np.zeros(2), epoch=EPOCH), stamps)


def numbered(hits: list[tuple[int, Kind]]) -> list[ImpactEvent]:
    """Events of stamps, ns, and kinds."""
    return [
        ImpactEvent(stamp, (Switch("die", kind),), k, 1, EPOCH)
        for k, (stamp, kind) in enumerate(hits, start=1)
    ]


def switched(run: Run) -> list[tuple[int, Kind]]:
    """Stamp and kind of each switch of a plant."""
    return [(s.instant.stamp, each.kind) for s in run.switchings for each in s.switches]


def observed(
    model: System, hits: list[tuple[int, Kind]], stamps: Stamps
) -> tuple[list[Estimate], set[str]]:
    """Estimates with defaults, and the reasons of applied events."""
    observer = make_observer(model, Options(law="minimum-variance", epoch=EPOCH))
    found = [*replay(observer, numbered(hits), stamps)]
    reasons = {
        each.reason.partition(":")[2].strip()
        for each in found
        if not isinstance(each, Estimate) and each.ruling is Ruling.APPLIED
    }
    return [each for each in found if isinstance(each, Estimate)], reasons


def errors(found: list[Estimate], run: Run) -> tuple[Matrix, Matrix]:
    """Errors and deviations of (q, u) in the last half of a run, shape (samples, 2n)."""
    half = found[len(found) // 2 :]
    states = np.array([np.concatenate([each.q, each.u]) for each in half])
    n = states.shape[1]
    variances = [np.diag(np.reshape(each.covariance, (n, n))) for each in half]
    return states - run.states[-len(half) :], np.sqrt(variances)


def test_a_close_without_restitution_is_a_rest_at_once() -> None:
    """Nothing bounces on a plastic die, so that no CLOSE is taken for a first edge."""
    run = stroke(press(restitution=0.0).system, 0.0)
    found, reasons = observed(press(restitution=0.0).system, switched(run), run.stamps)
    assert np.max(np.abs(errors(found, run)[0])) < 1e-7
    assert not any("first edge" in each for each in reasons)


def test_a_close_after_reported_bounces_is_a_rest() -> None:
    """The row of a switch that reports all bounces ends with a slow CLOSE."""
    run = stroke(press().system, 0.0)
    found, reasons = observed(press().system, switched(run), run.stamps)
    assert np.max(np.abs(errors(found, run)[0])) < 1e-7
    assert not any("first edge" in each for each in reasons)
