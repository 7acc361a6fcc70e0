# SPDX-License-Identifier: Apache-2.0
"""Estimates against the truth, where the two sides of an impact are never mixed.

A true sample at the stamp of an impact holds after the impact, and so does an estimate that has
used the event. Two kinds of samples say nothing about the observer, since their distance is the
size of a jump. They are counted, and left out of all other metrics: a live estimate that was
published before its event arrived is *late*; a sample where the truth has jumped and the estimate
has not, or the other way round, is a *mismatch*.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from tempfile import TemporaryFile

import numpy as np
from numpy.typing import NDArray

from impact_observer.compare.error_curve import ErrorCurve, ErrorRows, error_type
from impact_observer.compare.mismatch import REACH, Mismatch, windows
from impact_observer.dynamics.lyapunov import distance
from impact_observer.errors import BagError, DynamicsError, UsageError
from impact_observer.events import ImpactEvent, Verdict
from impact_observer.io.pairing import Pairing, Pairs, Samples, arrived, sample_type, samples_of
from impact_observer.model import System
from impact_observer.observer import Observer, replay_batches
from impact_observer.observer.event_order import impacts_of
from impact_observer.observer.event_outcomes import EventOutcomes, outcomes_of
from impact_observer.observer.samples import SensorSample
from impact_observer.stamps import seconds_between, text
from impact_observer.states import Stamps, Vector

SETTLED = 1e-2
"""Default of the ratio V over V at the start below which an estimate has settled."""
_FLOOR = 10.0
"""V over V at the end up to which V counts as falling."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One law's estimate against the truth; ``compare.metrics`` has what is printed of it.

    Attributes:
        system: the system, whose energy is V.
        law: name of the law.
        stamps: of the samples that count, ns, shape (rows,); of very many the peaks of V.
        error: estimate minus truth, (dq, du), shape (rows, 2n).
        V: Lyapunov distance, J, shape (rows,).
        samples: number of samples that count.
        late: estimates left out because their event had not arrived.
        stale: states left out because they came long after later ones.
        mismatch: samples between the jumps of truth and estimate.
        outcomes: which events the observer applied, rejected and inserted.
        rms: root mean square error of each state, shape (2n,).
        largest: largest absolute error of each state, shape (2n,).
        largest_rise: largest rise of V from one sample to the next, over V at the start.
        settled: V over V at the start below which the estimate has settled.
        settling_time: seconds from the first sample until it has settled for good, or None.
    """

    system: System
    law: str
    stamps: Stamps
    error: NDArray[np.float64]
    V: Vector
    samples: int
    late: int
    stale: int
    mismatch: Mismatch
    outcomes: EventOutcomes
    rms: Vector
    largest: Vector
    largest_rise: float
    settled: float
    settling_time: float | None

    @property
    def ratio(self) -> float | None:
        """``V`` at the end over ``V`` at the start; None where they start equal."""
        return float(self.V[-1] / self.V[0]) if self.V[0] > 0 else None

    @property
    def events(self) -> int:
        """Instants of events, openings included, that the estimate used."""
        return int(np.count_nonzero(self.outcomes.instants <= self.stamps[-1]))

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: coordinates, then their velocities."""
        names = self.system.coordinates
        return (*names, *(f"d{name}/dt" for name in names))

    @property
    def rate_per_second(self) -> float | None:
        """Fall of ``ln V`` in a second until V is near its end; None where V does not fall."""
        fall, until = self._fall()
        seconds = seconds_between(int(self.stamps[0]), until)
        return fall / seconds if fall > 0 and seconds > 0 else None

    @property
    def rate_per_impact(self) -> float | None:
        """Fall of ``ln V`` per used impact until V is near its end; None where V does not fall."""
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
    """Where V, samples first, is near its last value; zero has no logarithm and is not."""
    return np.asarray((V > 0) & (_FLOOR * V[-1] >= V))


class Comparator:
    """Compares truth and estimates that are added block by block, in constant memory.

    Attributes:
        pairing: where to add the blocks of both.
        law: name of the law.
    """

    def __init__(
        self,
        system: System,
        outcomes: EventOutcomes,
        law: str,
        settled: float = SETTLED,
        *,
        keep: Callable[[ErrorRows], None] | None = None,
        begin: int = 0,
    ) -> None:
        """Begin without any block.

        Args:
            system: gives M and K for V.
            outcomes: which events the observer applied, rejected and inserted.
            law: name of the law.
            settled: V over V at the start below which the estimate has settled.
            keep: receives the rows that count, in order; None to keep them for the result.
            begin: stamp before which samples are left out, ns.
        """
        self.pairing = Pairing()
        self.law = law
        self._system, self._outcomes, self._settled = system, outcomes, settled
        self._curve = ErrorCurve()
        self._keep = keep or self._curve.add
        self._begin = begin
        index = {name: c for c, name in enumerate(system.contact_names)}
        self._impacts = [(at, index[name]) for at, name in outcomes.impacts if name in index]
        self._of_contact = [[at for at, c in self._impacts if c == i] for i in range(system.m)]
        self._searched = 0  # impacts
        self._windows: list[tuple[int, int]] = []
        self._carried: Pairs | None = None
        self._counted = 0  # of the carried ones
        self._samples = self._late = 0
        self._mismatch = Mismatch()
        self._squares, self._largest = np.zeros(2 * system.n), np.zeros(2 * system.n)
        self._first = self._last = -1.0  # V, J
        self._rise = 0.0  # of V from one sample to the next, J
        self._settled_since: int | None = None  # stamp from which on V is small enough, ns

    def update(self, *, done: bool = False) -> None:
        """Compare as far as the blocks that were added allow.

        A pair counts once all windows that may contain it have been found, which needs the pairs
        ``2 REACH`` around it. Until then it is carried over to the next call.

        Args:
            done: whether all blocks have been added.
        """
        waiting = [self._carried, self.pairing.ready(done=done)]
        rows = [each for each in waiting if each is not None and each.size]
        if not rows:
            return
        pairs = np.concatenate(rows)
        last = int(pairs["stamp"][-1])
        self._find_windows(pairs, last + 1 if done else last - REACH)
        due = pairs.size
        if not done:
            due = int(np.searchsorted(pairs["stamp"], last - 2 * REACH, side="right"))
        if due > self._counted:
            own = pairs[self._counted : due]
            self._count(own[own["stamp"] >= self._begin])
        # A jump shows against the two samples before it.
        kept = max(due - 2, 0)
        self._carried, self._counted = pairs[kept:], due - kept

    def _find_windows(self, rows: Pairs, until: int) -> None:
        """Find the windows of all impacts before ``until`` (ns)."""
        last = bisect_left(self._impacts, (until,))
        speeds: dict[int, tuple[Vector, Vector]] = {}
        n = self._system.n
        for impact, c in self._impacts[self._searched : last]:
            if c not in speeds:
                w = self._system.W[:, c]
                speeds[c] = (rows["truth"][:, n:] @ w, rows["estimate"][:, n:] @ w)
            own = self._of_contact[c]
            before, after = bisect_left(own, impact), bisect_right(own, impact)
            others = [*own[max(before - 1, 0) : before], *own[after : after + 1]]
            begin, end = map(int, windows(rows["stamp"], *speeds[c], impact, others))
            if begin < end and end > self._begin:
                self._windows.append((begin, end))
                self._mismatch.windows += 1
                self._mismatch.longest = max(self._mismatch.longest, seconds_between(begin, end))
        self._searched = max(self._searched, last)

    def _count(self, pairs: Pairs) -> None:
        """Count pairs whose windows are all found."""
        if not pairs.size:
            return
        n, stamps = self._system.n, pairs["stamp"]
        rows = np.empty(pairs.size, error_type(2 * n))
        rows["stamp"], rows["error"] = stamps, pairs["estimate"] - pairs["truth"]
        rows["V"] = distance(self._system, rows["error"][:, :n], rows["error"][:, n:])
        punctual = arrived(stamps, pairs["last_event"], self._outcomes.reported)
        between = np.zeros(stamps.size, dtype=np.bool_)
        for begin, end in self._windows:
            between |= (begin <= stamps) & (stamps < end)
        self._windows = [each for each in self._windows if each[1] > stamps[-1]]
        between &= punctual
        self._late += int(np.count_nonzero(~punctual))
        self._mismatch.samples += int(np.count_nonzero(between))
        self._mismatch.V = max(self._mismatch.V, float(np.max(rows["V"][between], initial=0.0)))
        kept = rows[punctual & ~between]
        if kept.size:
            self._sum_up(kept)

    def _sum_up(self, rows: ErrorRows) -> None:
        stamps, error, V = rows["stamp"], rows["error"], rows["V"]
        if not self._samples:
            self._first = self._last = float(V[0])
        self._samples += stamps.size
        self._squares += np.sum(error**2, axis=0)
        self._largest = np.maximum(self._largest, np.max(np.abs(error), axis=0))
        self._rise = max(self._rise, float(np.max(np.diff(V, prepend=self._last))))
        self._last = float(V[-1])
        above = np.flatnonzero(self._settled * self._first < V)
        after = int(above[-1]) + 1 if above.size else 0
        if above.size or self._settled_since is None:
            self._settled_since = int(stamps[after]) if after < stamps.size else None
        self._keep(rows)

    def result(self) -> Comparison:
        """The comparison, when all blocks have been added.

        Raises:
            BagError: no stamp is in both, or every estimate came before its events.
            UsageError: they end before the stamp from which samples count.
        """
        self.update(done=True)
        if not (self._samples or self._late or self._mismatch.samples) and self._begin:
            raise UsageError(
                f"{self.law}: no sample from stamp {text(self._begin)} s on, where --from begins:"
                f" {self.pairing.ranges()}"
            )
        if not (self._samples or self._late or self._mismatch.samples):
            raise BagError(
                f"{self.law}: truth and estimate have no stamp in common: {self.pairing.ranges()};"
                " both must be sampled at the same instants"
            )
        if not self._samples:
            raise BagError(
                f"{self.law}: every estimate came before its events; nothing to compare"
            )
        rows, start = self._curve.rows(), self._first
        settling_time = None
        if self._settled_since is not None and (start > 0 or self._rise == 0):
            settling_time = seconds_between(int(rows["stamp"][0]), self._settled_since)
        return Comparison(
            system=self._system,
            law=self.law,
            stamps=rows["stamp"],
            error=rows["error"],
            V=rows["V"],
            samples=self._samples,
            late=self._late,
            stale=self.pairing.truth.stale + self.pairing.estimates.stale,
            mismatch=self._mismatch,
            outcomes=self._outcomes,
            rms=np.sqrt(self._squares / self._samples),
            largest=self._largest,
            largest_rise=self._rise / start if start > 0 else 0.0,
            settled=self._settled,
            settling_time=settling_time,
        )


def compare_observer(
    observer: Observer,
    events: Sequence[ImpactEvent],
    truth: Callable[[], Iterable[Samples]],
    *,
    system: System | None = None,
    settled: float = SETTLED,
    begin: int = 0,
    needs_event: bool = True,
    samples: Sequence[SensorSample] = (),
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Comparison:
    """Run an observer over events and compare its estimates with the truth.

    Estimates wait in a temporary file until all events are through: a law may revise its verdict
    on an event later.

    Args:
        observer: has received nothing yet.
        events: in order of episode, stamp and sequence.
        truth: makes the blocks of the plant's states; their stamps are where to estimate.
        system: whose energy V is; None for the observer's.
        settled: V over V at the start below which the estimate has settled.
        begin: stamp before which samples are left out, ns.
        needs_event: whether it is an error that the observer could not apply any event.
        samples: of the observer's sensors, in order of stamps.
        progress: receives the number of estimates made, and of all.

    Raises:
        BagError: no event could be applied, or no estimate made at the truth's stamps.
        DynamicsError: an estimate is not finite.
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    stamps = np.unique(np.concatenate([block["stamp"] for block in truth()]))
    law = observer.law.name
    verdicts: list[Verdict] = []
    with TemporaryFile() as file:
        made, row = 0, sample_type(2 * observer.system.n)
        for item in replay_batches(observer, events, stamps, only_states=True, samples=samples):
            if isinstance(item, Verdict):
                verdicts.append(item)
                continue
            last_event = np.full(item.stamps.size, item.first.last_event)
            file.write(samples_of(item.stamps, item.x, last_event).tobytes())
            made += item.stamps.size
            progress(made, stamps.size)
        outcomes = outcomes_of(events, verdicts)
        if verdicts and not outcomes.instants.size and (needs_event or not made):
            raise BagError(f"{law}: no event could be applied: {verdicts[0].reason}")
        if not made:
            raise BagError(
                f"{law}: no impact was received, so there is no estimate to compare; expected"
                " impacts, or a bag of observe with the --epoch at which the initial state holds"
            )
        file.seek(0)
        estimates = iter(lambda: file.read(4096 * row.itemsize), b"")
        comparator = Comparator(system or observer.system, outcomes, law, settled, begin=begin)
        _compare_blocks(comparator, truth(), (np.frombuffer(data, row) for data in estimates))
    return comparator.result()


def _compare_blocks(
    comparator: Comparator, truth: Iterable[Samples], estimates: Iterator[Samples]
) -> None:
    """Add blocks of both by turns, so that neither gets far ahead of the other."""
    pairing = comparator.pairing
    for block in truth:
        pairing.truth.add(block)
        while pairing.estimates.newest < pairing.truth.newest:
            if (samples := next(estimates, None)) is None:
                break
            if not np.isfinite(samples["x"]).all():
                raise DynamicsError(f"{comparator.law}: the estimate has left all bounds")
            pairing.estimates.add(samples)
        comparator.update()


def impacts_in(events: Iterable[ImpactEvent]) -> dict[str, Stamps]:
    """Stamps of the impacts (ns), by contact.

    A closing is an impact too; an impact that a closing at the same stamp supersedes is not.
    """
    by_contact: dict[str, list[int]] = {}
    for stamp, contact, _ in impacts_of(events):
        by_contact.setdefault(contact, []).append(stamp)
    return {name: np.array(stamps, dtype=np.int64) for name, stamps in sorted(by_contact.items())}
