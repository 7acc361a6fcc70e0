# SPDX-License-Identifier: Apache-2.0
"""Comparison of all replicas of one observer at once: runs that differ only in their start.

The metrics of each replica are those of ``compare_states``, but for rounding.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.compare.comparison import (
    Comparison,
    impacts_with_neighbours,
    largest_rise,
    settling_time,
)
from impact_observer.compare.mismatch import REACH, Mismatch, windows
from impact_observer.dynamics.lyapunov import root_of_energy
from impact_observer.errors import BagError, DynamicsError
from impact_observer.events import ImpactEvent, Verdict
from impact_observer.io.pairing import arrived
from impact_observer.model import System
from impact_observer.observer import Observer, replay_batches
from impact_observer.observer.event_outcomes import EventOutcomes, outcomes_of
from impact_observer.stamps import text
from impact_observer.states import Matrix, Stamps

_MOST = 2**22
"""Most numbers in the errors of all replicas that are made together."""
_AT_ONCE = 2**12
"""States that are made together, so that they stay in the processor's cache."""


class _ReplicaErrors(NamedTuple):
    """Errors of the replicas.

    Attributes:
        V: distances from the truth at all samples, J, shape (N, samples).
        near: samples near an event, ascending, shape (rows,).
        speeds: contact speeds at these minus the true ones, m/s, shape (m, N, rows).
        punctual: samples whose events had all arrived, shape (samples,).
        outcomes: which events the observer applied, rejected and inserted.
    """

    V: NDArray[np.float64]
    near: NDArray[np.intp]
    speeds: NDArray[np.float64]
    punctual: NDArray[np.bool_]
    outcomes: EventOutcomes


def compare_replicas(
    observer: Observer,
    events: Sequence[ImpactEvent],
    stamps: Stamps,
    truth: Matrix,
    *,
    system: System,
    settled: float,
) -> Iterator[Comparison]:
    """Run an observer over events, and compare each of its replicas with the truth.

    Each comparison has V, but NaN for the errors of single states.

    Args:
        observer: has received nothing yet.
        events: in order of episode, stamp and sequence.
        stamps: of the samples, ns, ascending, shape (samples,).
        truth: states of the plant at the samples, shape (samples, 2n).
        system: the plant, whose energy is V.
        settled: V over V at the start below which an estimate has settled.

    Raises:
        BagError: there is no estimate at a sample, or for a replica no sample that counts.
        DynamicsError: a replica is not finite.
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    errors = _errors(observer, events, stamps, truth, system)
    counts = errors.punctual & ~_between(stamps, truth, errors, system)
    if not counts.any(axis=1).all():
        raise BagError(f"{observer.law.name}: no sample counts")
    late, unknown = int(np.count_nonzero(~errors.punctual)), np.full_like(truth, np.nan)
    for every, counting in zip(errors.V, counts, strict=True):
        V, own = every[counting], stamps[counting]
        yield Comparison(
            system=system,
            law=observer.law.name,
            stamps=own,
            error=unknown[: V.size],
            V=V,
            deviations=unknown[: V.size, :0],
            samples=V.size,
            late=late,
            stale=0,
            mismatch=Mismatch(),
            outcomes=errors.outcomes,
            rms=unknown[0],
            largest=unknown[0],
            largest_rise=largest_rise(V),
            settled=settled,
            settling_time=settling_time(own, V, settled),
        )


def _errors(
    observer: Observer,
    events: Sequence[ImpactEvent],
    stamps: Stamps,
    truth: Matrix,
    system: System,
) -> _ReplicaErrors:
    """Run the observer; see ``compare_replicas``."""
    done, size = 0, observer.ensemble
    root, contacts = root_of_energy(system), system.W.T
    about = [_about(stamps, event.stamp) for event in events]
    near = np.unique(np.concatenate([np.empty(0, int), *about]))
    V, speeds = np.empty((size, stamps.size)), np.empty((system.m, size, near.size))
    last_event = np.empty(stamps.size, dtype=np.int64)
    verdicts: list[Verdict] = []
    for item in replay_batches(observer, events, stamps, only_states=True):
        if isinstance(item, Verdict):
            verdicts.append(item)
            continue
        if item.first.stamp != stamps[done]:
            break
        last_event[done : done + item.stamps.size] = item.first.last_event
        at_once = max(_MOST // (size * 2 * system.n), 1)
        for first in range(0, item.stamps.size, at_once):
            some = item.stamps[first : first + at_once]
            end = done + some.size
            maps, columns = _of_all(observer, some, truth[done:end])
            low, high = np.searchsorted(near, [done, end])
            closing = np.tensordot(contacts, maps[system.n :, :, near[low:high] - done], 1)
            speeds[:, :, low:high] = closing if columns is None else columns @ closing
            weighted = np.tensordot(root, maps, 1)
            step = max(_AT_ONCE // some.size, 1)
            for begin in range(0, size, step):
                which = slice(begin, begin + step)
                error = weighted[:, which] if columns is None else columns[which] @ weighted
                V[which, done:end] = np.einsum("kis,kis->is", error, error)
            done = end
    if done < stamps.size:
        raise BagError(
            f"{observer.law.name}: no estimate at the sample {text(int(stamps[done]))} s"
        )
    if not np.isfinite(V).all():
        raise DynamicsError(f"{observer.law.name}: a replica has left all bounds")
    outcomes = outcomes_of(events, verdicts)
    punctual = arrived(stamps, last_event, outcomes.reported)
    return _ReplicaErrors(V, near, speeds, punctual, outcomes)


def _of_all(
    observer: Observer, stamps: Stamps, truth: Matrix
) -> tuple[NDArray[np.float64], Matrix | None]:
    """Errors of all replicas as products of maps and columns.

    The maps have the shape (2n, r, samples), the columns (N, r). The columns are None if the maps
    are the errors; then r = N.
    """
    x, maps, differences = observer.replicas(stamps)
    error = (x - truth).T[:, None]
    if differences is None:
        return np.concatenate([error, maps + error], axis=1), None
    columns = np.vstack([np.pad(differences, ((0, 0), (1, 0))), np.ones(observer.ensemble)])
    return np.concatenate([maps, error], axis=1), columns.T


def _about(stamps: Stamps, event: int) -> NDArray[np.intp]:
    """The samples in which the jumps of an impact are sought."""
    low, high = np.searchsorted(stamps, [event - REACH, event + REACH + 1])
    return np.arange(max(int(low) - 2, 0), int(high))


def _between(
    stamps: Stamps, truth: Matrix, errors: _ReplicaErrors, system: System
) -> NDArray[np.bool_]:
    """Mask of the samples between the jumps of truth and replica, shape (N, samples)."""
    between = np.zeros(errors.V.shape, dtype=np.bool_)
    for c, name in enumerate(system.contact_names):
        gamma = truth[:, system.n :] @ system.W[:, c]
        for impact, others in impacts_with_neighbours(errors.outcomes, name):
            rows = _about(stamps, impact)
            replicas = errors.speeds[c][:, np.searchsorted(errors.near, rows)] + gamma[rows]
            begin, end = windows(stamps[rows], gamma[rows], replicas, impact, others)
            between[:, rows] |= (begin[:, None] <= stamps[rows]) & (stamps[rows] < end[:, None])
    return between
