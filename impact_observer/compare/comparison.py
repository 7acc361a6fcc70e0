# SPDX-License-Identifier: Apache-2.0
"""Estimates against the truth; the two sides of an impact are never mixed.

A true sample at the stamp of an impact holds after the impact, and so does an estimate that has
used the event. Two kinds of samples show the size of a jump and not the error of the observer.
Both are counted, and left out of all other metrics: a live estimate that was published before its
event arrived is *late*; a sample between the jumps of truth and estimate is a *mismatch*.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.compare.mismatch import Mismatch, windows
from impact_observer.dynamics import Mechanism, mechanism_of
from impact_observer.errors import BagError, DynamicsError
from impact_observer.events import ImpactEvent, Verdict
from impact_observer.io.pairing import (
    Samples,
    arrived,
    fresh,
    paired,
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
        late: estimates left out because their event had not arrived.
        stale: states left out because they came long after later ones.
        mismatch: samples between the jumps of truth and estimate.
        outcomes: which events the observer applied, rejected and inserted.
    """

    system: Multibody
    law: str
    stamps: Stamps
    error: NDArray[np.float64]
    V: Vector
    deviations: Matrix
    late: int
    stale: int
    mismatch: Mismatch
    outcomes: EventOutcomes

    @property
    def samples(self) -> int:
        """Number of samples that count."""
        return self.stamps.size

    @property
    def rms(self) -> Vector:
        """Root mean square error of each state, shape (2n,)."""
        return np.asarray(np.sqrt(np.mean(self.error**2, axis=0)))

    @property
    def largest(self) -> Vector:
        """Largest absolute error of each state, shape (2n,)."""
        return np.asarray(np.max(np.abs(self.error), axis=0))

    @property
    def largest_rise(self) -> float:
        """Largest rise of V from one sample to the next, over V at the start."""
        return largest_rise(self.V)

    @property
    def settling_time(self) -> float | None:
        """Seconds from the first sample until V stays below ``SETTLED`` V0; None for never."""
        return settling_time(self.stamps, self.V)

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
    """Compare estimates with the truth at the stamps that both have; each in the order of a bag.

    Raises:
        BagError: no stamp is in both, or every estimate came before its events.
        DynamicsError: an estimate is not finite.
    """
    kept_truth, kept_estimates = fresh(truth), fresh(estimates)
    pairs = paired(kept_truth, kept_estimates)
    if not pairs.size:
        ranges = f"truth {stamp_range(truth)}, estimate {stamp_range(estimates)}"
        raise BagError(
            f"{law}: truth and estimate have no stamp in common: {ranges};"
            " both must be sampled at the same instants"
        )
    many = Many(mechanism_of(system), law, pairs["stamp"], pairs["truth"], pairs["estimate"][None])
    punctual = arrived(pairs["stamp"], pairs["last_event"], outcomes.reported)
    (found,) = _compared(many, outcomes, punctual)
    stale = truth.size - kept_truth.size + estimates.size - kept_estimates.size
    kept = np.isin(pairs["stamp"], found.stamps)
    return replace(found, stale=stale, deviations=pairs["deviation"][kept])


class Many(NamedTuple):
    """Several estimates by one law, shape (N, samples, 2n), at the stamps (ns) of a truth."""

    mechanism: Mechanism
    law: str
    stamps: Stamps
    truth: Matrix
    estimates: NDArray[np.float64]


def _compared(
    many: Many, outcomes: EventOutcomes, punctual: NDArray[np.bool_]
) -> list[Comparison]:
    """The comparison of each of ``many`` estimates; ``punctual`` samples contain all events.

    Raises:
        BagError: every estimate came before its events.
        DynamicsError: an estimate is not finite.
    """
    if not np.isfinite(many.estimates).all():
        raise DynamicsError(f"{many.law}: the estimate has left all bounds")
    system = many.mechanism.system
    error = errors_of(system, many.truth, many.estimates)
    V = many.mechanism.distance(np.broadcast_to(many.truth, error.shape), error)
    found = []
    late = int(np.count_nonzero(~punctual))
    for k, (between, mismatch) in enumerate(_mismatches(many, outcomes)):
        kept = punctual if between is None else punctual & ~between
        if between is not None:
            mismatch.samples = int(np.count_nonzero(between & punctual))
            mismatch.V = float(np.max(V[k, between & punctual], initial=0.0))
        if not kept.any():
            raise BagError(
                f"{many.law}: every estimate came before its events; nothing to compare"
            )
        own = V[k][kept]
        comparison = Comparison(
            system=system,
            law=many.law,
            stamps=many.stamps[kept],
            error=error[k][kept],
            V=own,
            deviations=np.zeros((own.size, 0)),
            late=late,
            stale=0,
            mismatch=mismatch,
            outcomes=outcomes,
        )
        found.append(comparison)
    return found


def largest_rise(V: NDArray[np.float64]) -> float:
    """Largest rise of V from one sample to the next, over V at the start; 0 if V starts at 0."""
    rise = float(np.diff(V).max(initial=0.0))
    return rise / float(V[0]) if V[0] > 0 else 0.0


def settling_time(stamps: Stamps, V: NDArray[np.float64]) -> float | None:
    """Seconds from the first of the ``stamps`` (ns) until V has settled for good; None: never."""
    above = np.flatnonzero(SETTLED * V[0] < V)
    since = int(above[-1]) + 1 if above.size else 0
    if since == V.size or (V[0] == 0 and V.any()):
        return None
    return seconds_between(int(stamps[0]), int(stamps[since]))


def _mismatches(
    many: Many, outcomes: EventOutcomes
) -> list[tuple[NDArray[np.bool_] | None, Mismatch]]:
    """Of each estimate, the samples between its jumps and those of the truth, None for no sample.

    A mask of shape (samples,) each, and the windows of these samples.
    """
    found = [(None, Mismatch()) for _ in many.estimates]
    masks: dict[int, NDArray[np.bool_]] = {}
    truth, estimates = (many.mechanism.gaps(each).gamma for each in (many.truth, many.estimates))
    for c, name in enumerate(many.mechanism.system.contact_names):
        for impact, others in impacts_with_neighbours(outcomes, name):
            first, end = windows(many.stamps, truth[:, c], estimates[..., c], impact, others)
            for k in np.flatnonzero(first < end).tolist():
                low, high = np.searchsorted(many.stamps, [first[k], end[k]])
                mask = masks.setdefault(k, np.zeros(many.stamps.size, dtype=np.bool_))
                mask[low:high] = True
                mismatch = found[k][1]
                mismatch.windows += 1
                longest = seconds_between(int(first[k]), int(end[k]))
                mismatch.longest = max(mismatch.longest, longest)
    return [(masks.get(k), mismatch) for k, (_, mismatch) in enumerate(found)]


def impacts_with_neighbours(
    outcomes: EventOutcomes, contact: str
) -> Iterator[tuple[int, list[int]]]:
    """Stamps of a contact's impacts (ns), each with the stamps of the nearest other impacts."""
    stamps = [stamp for stamp, name in outcomes.impacts if name == contact]
    for impact in stamps:
        before, after = bisect_left(stamps, impact), bisect_right(stamps, impact)
        yield impact, [*stamps[max(before - 1, 0) : before], *stamps[after : after + 1]]


def compare_replicas(
    observer: Observer,
    events: Sequence[ImpactEvent],
    truth: Samples,
    *,
    system: Multibody | None = None,
    needs_event: bool = True,
    samples: Sequence[SensorSample] = (),
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> list[Comparison]:
    """Run an observer over events and compare the estimate of each replica with the truth.

    Replicas beside the first are those of a law that moves each by itself. Estimates are made at
    the stamps of the truth.

    Args:
        observer: an observer that has received nothing yet.
        events: in order of episode, stamp and sequence.
        truth: states of the plant.
        system: the system whose energy is V; None for the observer's.
        needs_event: whether it is an error that the observer could not apply any event.
        samples: of the observer's sensors, in order of stamps.
        progress: receives the number of estimates made, and of all.

    Raises:
        BagError: no event could be applied, or no estimate made at the truth's stamps.
        DynamicsError: an estimate is not finite.
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    law = observer.law.name
    stamps, last = np.unique(truth["stamp"][::-1], return_index=True)
    states = truth["x"][truth.size - 1 - last]
    verdicts: list[Verdict] = []
    estimates = list[NDArray[np.float64]]()
    latest, when, made = list[Stamps](), list[Stamps](), 0
    for item in replay_batches(observer, events, stamps, replicas=True, samples=samples):
        if isinstance(item, Verdict):
            verdicts.append(item)
            continue
        assert item.replicas is not None, "they were asked for"
        latest.append(np.full(item.stamps.size, item.first.last_event))
        when.append(item.stamps)
        estimates.append(item.replicas)
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
    at = np.concatenate(when)
    many = Many(
        mechanism_of(system or observer.system),
        law,
        at,
        states[np.searchsorted(stamps, at)],
        np.concatenate(estimates, axis=1),
    )
    punctual = arrived(at, np.concatenate(latest), outcomes.reported)
    return _compared(many, outcomes, punctual)


def impacts_in(events: Iterable[ImpactEvent]) -> dict[str, Stamps]:
    """Stamps of the impacts (ns), by contact.

    A closing is an impact too. An impact with a closing at the same stamp is not counted.
    """
    by_contact: dict[str, list[int]] = {}
    for stamp, contact, _ in impacts_of(events):
        by_contact.setdefault(contact, []).append(stamp)
    return {name: np.array(stamps, dtype=np.int64) for name, stamps in sorted(by_contact.items())}
