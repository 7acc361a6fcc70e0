# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""All replicas of one observer against the truth at once: runs that differ in their start only.

The metrics are those of ``comparison`` for each replica alone, but for rounding. Arrays have the
samples first and the replicas last.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.compare.comparison import Comparison, is_near_end
from impact_observer.compare.mismatch import REACH, Mismatch, windows
from impact_observer.dynamics.lyapunov import distance
from impact_observer.errors import BagError, DynamicsError
from impact_observer.events import ImpactEvent, Verdict
from impact_observer.io.pairing import arrived
from impact_observer.model import System
from impact_observer.observer import Observer, replay_batches
from impact_observer.observer.event_outcomes import EventOutcomes, outcomes_of
from impact_observer.stamps import seconds_between, text
from impact_observer.states import Matrix, Stamps

_AT_ONCE = 2**15
"""States that are made together: they stay in the processor's cache."""


class _ReplicaErrors(NamedTuple):
    """Errors of the replicas.

    Attributes:
        V: distances from the truth at all samples, J, shape (samples, N).
        near: samples near an event, ascending, shape (rows,).
        speeds: contact speeds at these minus the true ones, m/s, shape (m, rows, N).
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

    What is found has no errors of single states, and of V only the start, the end, and where it
    comes near that.

    Args:
        observer: has received nothing yet.
        events: in order of episode, stamp and sequence.
        stamps: where to compare, ns, ascending, shape (samples,).
        truth: states of the plant there, shape (samples, 2n).
        system: of the plant, whose energy V is.
        settled: V over V at the start below which an estimate has settled.

    Raises:
        BagError: there is no estimate at a sample, or for a replica no sample that counts.
        DynamicsError: a replica is not finite.
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    errors = _errors(observer, events, stamps, truth, system)
    V, outcomes = errors.V, errors.outcomes
    counts = errors.punctual[:, None] & ~_between(stamps, truth, errors, system)
    if not counts.any(axis=0).all():
        raise BagError(f"{observer.law.name}: no sample counts")
    # A sample that does not count gets the V of the last one that does, or of the first.
    every, first = np.arange(V.shape[1]), counts.argmax(axis=0)
    V[0] = V[first, every]
    for row in np.flatnonzero(np.count_nonzero(counts, axis=1)[1:] < every.size) + 1:
        V[row] = np.where(counts[row], V[row], V[row - 1])
    last = stamps.size - 1 - counts[::-1].argmax(axis=0)
    near = np.maximum(np.argmax(is_near_end(V), axis=0), first)
    rises = np.max(np.diff(V, axis=0), axis=0, initial=0.0)
    above = settled * V[0] < V
    since = np.where(above.any(axis=0), stamps.size - above[::-1].argmax(axis=0), first)
    samples = np.count_nonzero(counts, axis=0)
    unknown = np.full((3, 2 * system.n), np.nan)
    for i in every:
        start, rise, rows = float(V[0, i]), float(rises[i]), [first[i], near[i], last[i]]
        settling_time = None
        if since[i] < stamps.size and (start > 0 or rise == 0):
            settling_time = seconds_between(int(stamps[first[i]]), int(stamps[since[i]]))
        yield Comparison(
            system=system,
            law=observer.law.name,
            stamps=stamps[rows],
            error=unknown,
            V=V[rows, i],
            samples=int(samples[i]),
            late=int(np.count_nonzero(~errors.punctual)),
            stale=0,
            mismatch=Mismatch(),
            outcomes=outcomes,
            rms=unknown[0],
            largest=unknown[0],
            largest_rise=rise / start if start > 0 else 0.0,
            settled=settled,
            settling_time=settling_time,
        )


def _errors(
    observer: Observer,
    events: Sequence[ImpactEvent],
    stamps: Stamps,
    truth: Matrix,
    system: System,
) -> _ReplicaErrors:
    """Run the observer; see ``compare_replicas``."""
    n, done, size = system.n, 0, observer.ensemble
    about = [_about(stamps, event.stamp) for event in events]
    near = np.unique(np.concatenate([np.empty(0, int), *about]))
    V, speeds = np.empty((stamps.size, size)), np.empty((system.m, near.size, size))
    last_event = np.empty(stamps.size, dtype=np.int64)
    at_once = max(_AT_ONCE // size, 1)
    verdicts: list[Verdict] = []
    for item in replay_batches(observer, events, stamps, only_states=True):
        if isinstance(item, Verdict):
            verdicts.append(item)
            continue
        if item.first.stamp != stamps[done]:
            break
        end = done + item.stamps.size
        last_event[done:end] = item.first.last_event
        for begin in range(done, end, at_once):
            rows = slice(begin, min(begin + at_once, end))
            error = observer.replicas(stamps[rows])
            error -= truth[rows].T[..., None]
            V[rows] = distance(system, *np.split(np.moveaxis(error, 0, -1), 2, axis=-1))
            low, high = np.searchsorted(near, [rows.start, rows.stop])
            chosen = error[n:, near[low:high] - rows.start]
            speeds[:, low:high] = np.tensordot(system.W.T, chosen, 1)
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


def _about(stamps: Stamps, event: int) -> NDArray[np.intp]:
    """The samples in which the jumps of an impact are sought."""
    low, high = np.searchsorted(stamps, [event - REACH, event + REACH + 1])
    return np.arange(max(int(low) - 2, 0), int(high))


def _between(
    stamps: Stamps, truth: Matrix, errors: _ReplicaErrors, system: System
) -> NDArray[np.bool_]:
    """Which samples lie between the jumps of truth and replica, shape (samples, N)."""
    found = np.zeros(errors.V.shape, dtype=np.bool_)
    for c, name in enumerate(system.contact_names):
        own = [at for at, contact in errors.outcomes.impacts if contact == name]
        gamma = truth[:, system.n :] @ system.W[:, c]
        for impact in own:
            before, after = bisect_left(own, impact), bisect_right(own, impact)
            others = [*own[max(before - 1, 0) : before], *own[after : after + 1]]
            rows = _about(stamps, impact)
            replicas = errors.speeds[c, np.searchsorted(errors.near, rows)] + gamma[rows, None]
            begin, end = windows(stamps[rows], gamma[rows], replicas.T, impact, others)
            at = stamps[rows, None]
            found[rows] |= (begin <= at) & (at < end)
    return found
