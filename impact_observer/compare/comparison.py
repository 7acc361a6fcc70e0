# SPDX-License-Identifier: Apache-2.0
"""Estimates against the truth; the two sides of an impact are never mixed.

A true sample at the stamp of an impact holds after the impact, and so does an estimate that has
used the event. Two kinds of samples show the size of a jump and not the error of the observer.
Both are counted, and left out of all other metrics: a live estimate that was published before its
event arrived is *late*; a sample between the jumps of truth and estimate is a *mismatch*.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_observer.compare.mismatch import Mismatch, windows
from impact_observer.dynamics import Mechanism, mechanism_of
from impact_observer.errors import BagError, DynamicsError
from impact_observer.events import ImpactEvent, Verdict
from impact_observer.io.pairing import (
    Pairs,
    Samples,
    arrived,
    fresh,
    paired,
    samples_of,
    stamp_range,
)
from impact_observer.model.multibody import Multibody, errors_of
from impact_observer.observer import Observer, replay_batches
from impact_observer.observer.event_order import impacts_of
from impact_observer.observer.event_outcomes import EventOutcomes, outcomes_of
from impact_observer.observer.samples import SensorSample
from impact_observer.options import SETTLED
from impact_observer.stamps import NS_PER_S, seconds_between
from impact_observer.states import Matrix, Stamps, Vector

_FLOOR = 10.0
"""V over V at the end up to which V counts as falling."""
AFTER_HITS = (0.002, 0.05)
"""Begin and end of the time after a hit in which velocities matter most, s: the hit itself may
last 1 ms, and its stamp has an error."""
COVERED = 2.0
"""Standard deviations within which 95 % of the errors should be."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One law's estimate against the truth; ``compare.metrics`` has the printed metrics.

    Attributes:
        system: the system, whose energy is V.
        law: name of the law.
        stamps: of the samples that count, ns, shape (samples,).
        error: estimate minus truth, (dq, du), shape (samples, 2n).
        V: Lyapunov distance, J, shape (samples,).
        deviations: standard deviations of the estimate, shape (samples, 2n), NaN without a
            covariance; shape (samples, 0) of linear systems.
        samples: number of samples that count.
        late: estimates left out because their event had not arrived.
        stale: states left out because they came long after later ones.
        mismatch: samples between the jumps of truth and estimate.
        outcomes: which events the observer applied, rejected and inserted.
        rms: root mean square error of each state, shape (2n,).
        largest: largest absolute error of each state, shape (2n,).
        largest_rise: largest rise of V from one sample to the next, over V at the start.
        settling_time: seconds from the first sample until V stays below ``SETTLED`` V0, or None.
    """

    system: Multibody
    law: str
    stamps: Stamps
    error: NDArray[np.float64]
    V: Vector
    deviations: Matrix
    samples: int
    late: int
    stale: int
    mismatch: Mismatch
    outcomes: EventOutcomes
    rms: Vector
    largest: Vector
    largest_rise: float
    settling_time: float | None

    @property
    def ratio(self) -> float | None:
        """``V`` at the end over ``V`` at the start; None where the start was near the truth."""
        return None if self.starts_near else float(self.V[-1] / self.V[0])

    @property
    def starts_near(self) -> bool:
        """Whether V at the start is so small that ratios to it say nothing.

        Of an observer that may start at encoders, it is small beside the largest V.
        """
        small = SETTLED * np.max(self.V) if self.system.has_encoders else 0.0
        return bool(self.V[0] <= small)

    @property
    def events(self) -> int:
        """Instants of events, openings included, that the estimate used."""
        return int(np.count_nonzero(self.outcomes.instants <= self.stamps[-1]))

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: coordinates, then their velocities."""
        return self.system.state_names

    @property
    def since_hits(self) -> Vector:
        """Seconds since the last hit at each sample, shape (samples,); infinite before any."""
        hits = np.array(self.outcomes.hits, dtype=np.int64)
        last = np.searchsorted(hits, self.stamps, side="right") - 1
        since = np.full(self.stamps.size, np.inf)
        known = last >= 0
        since[known] = (self.stamps[known] - hits[last[known]]) / NS_PER_S
        return since

    @property
    def rms_after_hits(self) -> Vector | None:
        """Root mean square error of each state in ``AFTER_HITS``, shape (2n,); None without."""
        since, (begin, end) = self.since_hits, AFTER_HITS
        chosen = (since >= begin) & (since < end)
        return np.sqrt(np.mean(self.error[chosen] ** 2, axis=0)) if chosen.any() else None

    @property
    def velocity_after_hits(self) -> float | None:
        """Root mean square of the length of the velocity's error in ``AFTER_HITS``.

        None without a sample then, or if velocities have different units.
        """
        rms, n = self.rms_after_hits, self.system.n
        if rms is None or len({*self.system.state_units[n:]}) > 1:
            return None
        return float(np.linalg.norm(rms[n:]))

    @property
    def coverage(self) -> Vector | None:
        """Share of the errors of each state within ``COVERED`` deviations; None without any."""
        known = np.isfinite(self.deviations).all(axis=1)
        if not (self.deviations.size and known.any()):
            return None
        inside = np.abs(self.error[known]) <= COVERED * self.deviations[known]
        return np.asarray(np.mean(inside, axis=0))

    @property
    def rate_per_second(self) -> float | None:
        """Fall of ``ln V`` in a second until V is near its end; None if V does not fall."""
        fall, until = self._fall()
        seconds = seconds_between(int(self.stamps[0]), until)
        return fall / seconds if fall > 0 and seconds > 0 else None

    @property
    def rate_per_impact(self) -> float | None:
        """Fall of ``ln V`` per used impact until V is near its end; None if V does not fall."""
        fall, until = self._fall()
        impacts = self.outcomes.until(until) - self.outcomes.until(int(self.stamps[0]))
        return fall / impacts if fall > 0 and impacts else None

    def _fall(self) -> tuple[float, int]:
        """Fall of ``ln V`` when V is first near its end, and that stamp (ns)."""
        if not (self.V[0] > 0 and self.V[-1] > 0):
            return 0.0, int(self.stamps[-1])
        near = int(np.argmax(is_near_end(self.V)))
        return float(np.log(self.V[0] / self.V[near])), int(self.stamps[near])


def is_near_end(V: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether V at each sample is near its last value; a V of zero, without logarithm, is not."""
    return np.asarray((V > 0) & (_FLOOR * V[-1] >= V))


def compare_states(
    system: Multibody,
    law: str,
    truth: Samples,
    estimates: Samples,
    outcomes: EventOutcomes,
) -> Comparison:
    """Compare estimates with the truth at the stamps that both have.

    Args:
        system: gives V.
        law: name of the law.
        truth: true states, in the order of the bag.
        estimates: estimated states, in the order of the bag.
        outcomes: which events the observer applied, rejected and inserted.

    Raises:
        BagError: no stamp is in both, or every estimate came before its events.
        DynamicsError: an estimate is not finite.
    """
    if not np.isfinite(estimates["x"]).all():
        raise DynamicsError(f"{law}: the estimate has left all bounds")
    kept_truth, kept_estimates = fresh(truth), fresh(estimates)
    pairs = paired(kept_truth, kept_estimates)
    mechanism = mechanism_of(system)
    between, mismatch = _mismatch(mechanism, pairs, outcomes)
    ranges = f"truth {stamp_range(truth)}, estimate {stamp_range(estimates)}"
    if not pairs.size:
        raise BagError(
            f"{law}: truth and estimate have no stamp in common: {ranges};"
            " both must be sampled at the same instants"
        )
    punctual = arrived(pairs["stamp"], pairs["last_event"], outcomes.reported)
    between &= punctual
    error = errors_of(system, pairs["truth"], pairs["estimate"])
    V = mechanism.distance(pairs["truth"], error)
    mismatch.samples = int(np.count_nonzero(between))
    mismatch.V = float(np.max(V[between], initial=0.0))
    kept = punctual & ~between
    if not kept.any():
        raise BagError(f"{law}: every estimate came before its events; nothing to compare")
    stamps, error, V = pairs["stamp"][kept], error[kept], V[kept]
    return Comparison(
        system=system,
        law=law,
        stamps=stamps,
        error=error,
        V=V,
        deviations=pairs["deviation"][kept],
        samples=stamps.size,
        late=int(np.count_nonzero(~punctual)),
        stale=truth.size - kept_truth.size + estimates.size - kept_estimates.size,
        mismatch=mismatch,
        outcomes=outcomes,
        rms=np.sqrt(np.mean(error**2, axis=0)),
        largest=np.max(np.abs(error), axis=0),
        largest_rise=largest_rise(V),
        settling_time=settling_time(stamps, V),
    )


def largest_rise(V: NDArray[np.float64]) -> float:
    """Largest rise of V from one sample to the next, over V at the start; 0 if V starts at 0."""
    rise = float(np.diff(V).max(initial=0.0))
    return rise / float(V[0]) if V[0] > 0 else 0.0


def settling_time(stamps: Stamps, V: NDArray[np.float64]) -> float | None:
    """Seconds from the first sample until V has settled for good; None for never.

    Args:
        stamps: of the samples, ns, shape (samples,).
        V: distance from the truth at the samples, J, shape (samples,).
    """
    above = np.flatnonzero(SETTLED * V[0] < V)
    since = int(above[-1]) + 1 if above.size else 0
    if since == V.size or (V[0] == 0 and V.any()):
        return None
    return seconds_between(int(stamps[0]), int(stamps[since]))


def _mismatch(
    mechanism: Mechanism, pairs: Pairs, outcomes: EventOutcomes
) -> tuple[NDArray[np.bool_], Mismatch]:
    """Mask of the samples between the jumps of truth and estimate, and their windows."""
    between, mismatch, stamps = np.zeros(pairs.size, dtype=np.bool_), Mismatch(), pairs["stamp"]
    speeds = [mechanism.gaps(pairs[key]).gamma for key in ("truth", "estimate")]
    for c, name in enumerate(mechanism.system.contact_names):
        truth, estimate = (each[:, c] for each in speeds)
        for impact, others in impacts_with_neighbours(outcomes, name):
            first, end = map(int, windows(stamps, truth, estimate, impact, others))
            low, high = np.searchsorted(stamps, [first, end])
            between[low:high] = True
            if first < end:
                mismatch.windows += 1
                mismatch.longest = max(mismatch.longest, seconds_between(first, end))
    return between, mismatch


def impacts_with_neighbours(
    outcomes: EventOutcomes, contact: str
) -> Iterator[tuple[int, list[int]]]:
    """Stamps of a contact's impacts (ns), each with the stamps of the nearest other impacts."""
    stamps = [stamp for stamp, name in outcomes.impacts if name == contact]
    for impact in stamps:
        before, after = bisect_left(stamps, impact), bisect_right(stamps, impact)
        yield impact, [*stamps[max(before - 1, 0) : before], *stamps[after : after + 1]]


def compare_observer(
    observer: Observer,
    events: Sequence[ImpactEvent],
    truth: Samples,
    *,
    system: Multibody | None = None,
    needs_event: bool = True,
    samples: Sequence[SensorSample] = (),
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Comparison:
    """Run an observer over events and compare its estimates with the truth.

    Args:
        observer: an observer that has received nothing yet.
        events: in order of episode, stamp and sequence.
        truth: states of the plant; estimates are made at their stamps.
        system: the system whose energy is V; None for the observer's.
        needs_event: whether it is an error that the observer could not apply any event.
        samples: of the observer's sensors, in order of stamps.
        progress: receives the number of estimates made, and of all.

    Raises:
        BagError: no event could be applied, or no estimate made at the truth's stamps.
        DynamicsError: an estimate is not finite.
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    stamps, law = np.unique(truth["stamp"]), observer.law.name
    verdicts: list[Verdict] = []
    estimates: list[Samples] = []
    made = 0
    for item in replay_batches(observer, events, stamps, only_states=True, samples=samples):
        if isinstance(item, Verdict):
            verdicts.append(item)
            continue
        last_event = np.full(item.stamps.size, item.first.last_event)
        estimates.append(samples_of(item.stamps, item.x, last_event))
        made += item.stamps.size
        progress(made, stamps.size)
    # A law may revise its verdict on an event later, so outcomes need all verdicts.
    outcomes = outcomes_of(events, verdicts)
    if verdicts and not outcomes.instants.size and (needs_event or not made):
        raise BagError(f"{law}: no event could be applied: {verdicts[0].reason}")
    if not made:
        raise BagError(
            f"{law}: no impact was received, so there is no estimate to compare; expected"
            " impacts, or a bag of observe with the --epoch at which the initial state holds"
        )
    return compare_states(
        system or observer.system,
        law,
        truth,
        np.concatenate(estimates),
        outcomes,
    )


def impacts_in(events: Iterable[ImpactEvent]) -> dict[str, Stamps]:
    """Stamps of the impacts (ns), by contact.

    A closing is an impact too. An impact with a closing at the same stamp is not counted.
    """
    by_contact: dict[str, list[int]] = {}
    for stamp, contact, _ in impacts_of(events):
        by_contact.setdefault(contact, []).append(stamp)
    return {name: np.array(stamps, dtype=np.int64) for name, stamps in sorted(by_contact.items())}
