# SPDX-License-Identifier: Apache-2.0
"""The impacts of a plant: speeds, impulses and energies from the states that it jumps between."""

from collections.abc import Iterable

import numpy as np

from impact_observer.events import ImpactEstimate
from impact_observer.model import System
from impact_observer.plant.switching import Switching
from impact_observer.states import Matrix, Vector


def true_impacts(system: System, switchings: Iterable[Switching]) -> dict[tuple[int, str], Vector]:
    """Speeds before and after, impulse and energy lost, (4,), by stamp and contact.

    The impulses are those that change the momentum of the plant, the energies are those of single
    contacts: of several at one instant, half the impulse times the loss of speed.
    """
    found, n = dict[tuple[int, str], Vector](), system.n
    for each in switchings:
        hit = list(each.contacts)
        if not hit or not each.switches:
            continue
        W, before, after = system.W[:, hit], each.before[n:], each.after[n:]
        impulses = np.linalg.lstsq(W, system.M @ (after - before), rcond=None)[0]
        lost = impulses * (W.T @ (before + after)) / -2
        if len(hit) == 1:
            lost = np.array([before @ system.M @ before - after @ system.M @ after]) / 2
        rows = np.column_stack([-W.T @ before, W.T @ after, impulses, lost])
        stamp = each.instant.stamp
        found |= {(stamp, system.contact_names[i]): r for i, r in zip(hit, rows, strict=True)}
    return found


def numbers(impacts: Iterable[ImpactEstimate]) -> tuple[Matrix, Matrix]:
    """The numbers of ``impacts`` and their deviations, shape (impacts, 4) each."""
    rows = np.array([each[4:] for each in impacts])
    assert np.all(np.isfinite(rows))
    return rows[:, :4], rows[:, 4:]
