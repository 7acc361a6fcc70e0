"""Estimates against the truth, without ever mixing the two sides of an impact.

A truth sample at an impact's stamp is after the impact, and so is an estimate that has heard of
it. A live estimate that was published before its event arrived is *late*: it is counted and left
out, for its distance is the size of the jump and says nothing of the observer.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_observer.analysis.lyapunov import distance
from impact_observer.errors import BagError
from impact_observer.events import ImpactEvent, Ruling, Verdict, final_rulings
from impact_observer.model import System
from impact_observer.observer import Observer, replay
from impact_observer.observer.order import hits
from impact_observer.stamps import seconds_between, text
from impact_observer.states import Estimate, Stamps, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """States at stamps.

    Attributes:
        stamps: ns, shape (samples,).
        x: states (q, u), shape (samples, 2n).
    """

    stamps: Stamps
    x: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One law's estimate against the truth.

    Attributes:
        system: the system that both move by.
        law: name of the law.
        stamps: of the samples that count, ns, shape (samples,).
        error: estimate minus truth, (dq, du), shape (samples, 2n).
        V: Lyapunov distance, J, shape (samples,).
        late: estimates left out because their event had not arrived.
        events: instants of events, openings included, that the estimate used.
    """

    system: System
    law: str
    stamps: Stamps
    error: NDArray[np.float64]
    V: Vector
    late: int
    events: int

    @property
    def ratio(self) -> float | None:
        """``V`` at the end over ``V`` at the start; None where they start equal."""
        return float(self.V[-1] / self.V[0]) if self.V[0] > 0 else None

    @property
    def rms(self) -> Vector:
        """Root mean square error of each state, shape (2n,)."""
        return np.asarray(np.sqrt(np.mean(self.error**2, axis=0)))

    @property
    def largest(self) -> Vector:
        """Largest absolute error of each state, shape (2n,)."""
        return np.asarray(np.max(np.abs(self.error), axis=0))

    @property
    def final(self) -> Vector:
        """Error of each state at the end, shape (2n,)."""
        return np.asarray(self.error[-1])

    def settling_time(self, threshold: float) -> float | None:
        """Seconds after the first sample from which ``V <= threshold V0`` for good, or None."""
        above = np.flatnonzero(threshold * self.V[0] < self.V)
        if above.size == 0:
            return 0.0
        settled = int(above[-1]) + 1
        if settled == self.V.size or self.V[0] <= 0:
            return None
        return seconds_between(int(self.stamps[0]), int(self.stamps[settled]))

    def largest_rise(self) -> float:
        """Largest rise of ``V`` from one sample to the next over ``V`` at the start."""
        return float(np.max(np.diff(self.V), initial=0.0) / self.V[0]) if self.V[0] > 0 else 0.0


def compare(
    system: System,
    law: str,
    truth: Series,
    estimate: Series,
    *,
    applied: Stamps,
    last_event: Stamps | None = None,
) -> Comparison:
    """Compare at the stamps that both have.

    Args:
        system: gives M and K for V.
        law: name of the estimate's law.
        truth: the plant's states.
        estimate: the observer's.
        applied: stamps of the events that the observer applied, ns, ascending, shape (events,).
        last_event: for each estimate the stamp of the last event it contains, ns, 0 for none,
            shape (samples,); None where every estimate contains the events before it.

    Raises:
        BagError: no stamp is in both.
    """
    # A stamp may come twice: a live estimate is published again when a late event corrects it.
    of_truth, of_estimate = _last_of_each(truth.stamps), _last_of_each(estimate.stamps)
    common, in_truth, in_estimate = np.intersect1d(
        truth.stamps[of_truth], estimate.stamps[of_estimate], True, return_indices=True
    )
    in_truth, in_estimate = of_truth[in_truth], of_estimate[in_estimate]
    if common.size == 0:
        raise BagError(
            f"{law}: truth and estimate have no stamp in common: truth {_range(truth.stamps)},"
            f" estimate {_range(estimate.stamps)}; both must be sampled at the same instants"
        )
    kept = np.ones(common.size, dtype=bool)
    if last_event is not None:
        due = np.concatenate([[0], applied])[np.searchsorted(applied, common, side="right")]
        kept = last_event[in_estimate] >= due
    if not kept.any():
        raise BagError(f"{law}: every estimate came before its events; nothing can be compared")
    error = estimate.x[in_estimate][kept] - truth.x[in_truth][kept]
    n = system.n
    last = int(common[kept][-1])
    return Comparison(
        system=system,
        law=law,
        stamps=common[kept],
        error=error,
        V=distance(system, error[:, :n], error[:, n:]),
        late=int(np.count_nonzero(~kept)),
        events=int(np.count_nonzero(np.unique(applied) <= last)),
    )


def compare_law(
    observer: Observer,
    events: Sequence[ImpactEvent],
    truth: Series,
    *,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Comparison:
    """Run an observer over events and compare what it says with the truth, all in memory.

    Args:
        observer: has seen nothing yet.
        events: in order of episode, stamp and sequence.
        truth: the plant's states; its stamps are where to estimate.
        progress: told the estimates made and the stamps to make them for.

    Raises:
        BagError: no event could be applied, or no estimate made at the truth's stamps.
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    stamps, law = np.unique(truth.stamps), observer.law.name
    estimates: list[Estimate] = []
    verdicts: list[Verdict] = []
    for item in replay(observer, events, stamps):
        if isinstance(item, Verdict):
            verdicts.append(item)
        else:
            estimates.append(item)
            progress(len(estimates), stamps.size)
    applied = applied_in(verdicts)
    if verdicts and not applied.size:
        raise BagError(f"{law}: no event could be applied: {verdicts[0].reason}")
    if not estimates:
        raise BagError(f"{law}: no impact was heard, so there is no estimate to compare")
    made = np.array([each.stamp for each in estimates], dtype=np.int64)
    states = [np.concatenate([each.q, each.u]) for each in estimates]
    return compare(
        observer.system,
        law,
        truth,
        Series(made, np.reshape(states, (made.size, 2 * observer.system.n))),
        applied=applied,
        last_event=np.array([each.last_event for each in estimates], dtype=np.int64),
    )


def applied_in(verdicts: Iterable[Verdict]) -> Stamps:
    """Stamps of what an observer applied or inserted in the end, ns, shape (events,)."""
    last = final_rulings(verdicts).items()
    stamps = {stamp for (stamp, _, _), ruling in last if ruling is not Ruling.REJECTED}
    return np.array(sorted(stamps), dtype=np.int64)


def impacts_in(events: Iterable[ImpactEvent]) -> dict[str, Stamps]:
    """Stamps of the impacts (ns), by contact; a closing is one too, what it supersedes is none."""
    by_contact: dict[str, list[int]] = {}
    for stamp, contact, _ in hits(events):
        by_contact.setdefault(contact, []).append(stamp)
    return {name: np.array(stamps, dtype=np.int64) for name, stamps in sorted(by_contact.items())}


def _last_of_each(stamps: Stamps) -> NDArray[np.int64]:
    """Where each stamp stands for the last time."""
    _, from_behind = np.unique(stamps[::-1], return_index=True)
    return np.asarray(stamps.size - 1 - from_behind)


def _range(stamps: Stamps) -> str:
    if stamps.size == 0:
        return "none"
    return f"{text(int(stamps.min()))} to {text(int(stamps.max()))} s"
