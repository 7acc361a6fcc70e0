"""Estimates against the truth, without ever mixing the two sides of an impact.

A truth sample at an impact's stamp is after the impact, and so is an estimate that has heard of
it. Two kinds of samples say nothing of the observer and are counted apart, for their distance is
the size of a jump: a live estimate that was published before its event arrived is *late*; where
the truth has jumped and the estimate has not, or the other way round, is a *mismatch*.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import IO

import numpy as np
from numpy.typing import NDArray

from impact_observer.compare.mismatch import Impact
from impact_observer.compare.tally import ErrorCurve, ErrorRows, ErrorTally
from impact_observer.errors import BagError, DynamicsError
from impact_observer.events import ImpactEvent, Verdict
from impact_observer.io.pairing import Pairing, Series
from impact_observer.model import System
from impact_observer.observer import Observer, replay
from impact_observer.observer.event_order import impacts_of
from impact_observer.observer.event_outcomes import EventOutcomes, outcomes_of
from impact_observer.stamps import seconds_between
from impact_observer.states import Estimate, Stamps, Vector

_NEAR_END = 10.0
"""V over V at the end up to which V counts as falling still."""
_BLOCK = 4096
"""Estimates that are put aside together."""
SETTLED = 1e-2
"""V over V at the start below which an estimate counts as settled, unless told otherwise."""


@dataclass(frozen=True, slots=True)
class Mismatch:
    """Where truth and estimate did not jump between the same samples.

    Attributes:
        windows: impacts at which that was so.
        samples: between the two jumps, left out of all other figures.
        longest: the longest window, s.
        V: the largest distance there, J.
    """

    windows: int
    samples: int
    longest: float
    V: float


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One law's estimate against the truth.

    Attributes:
        system: the system that both move by.
        law: name of the law.
        stamps: of the samples that count, ns, shape (rows,); of very many the peaks of V.
        error: estimate minus truth, (dq, du), shape (rows, 2n).
        V: Lyapunov distance, J, shape (rows,).
        samples: how many samples count.
        late: estimates left out because their event had not arrived.
        stale: states left out because they came long after later ones.
        mismatch: where one had jumped and the other had not.
        heard: what the observer made of the events.
        rms: root mean square error of each state, shape (2n,).
        largest: largest absolute error of each state, shape (2n,).
        largest_rise: largest rise of V from one sample to the next, over V at the start.
        threshold: V over V at the start below which the estimate has settled.
        settling_time: seconds after the first sample from which on it has, or None.
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
    heard: EventOutcomes
    rms: Vector
    largest: Vector
    largest_rise: float
    threshold: float
    settling_time: float | None

    @property
    def ratio(self) -> float | None:
        """``V`` at the end over ``V`` at the start; None where they start equal."""
        return float(self.V[-1] / self.V[0]) if self.V[0] > 0 else None

    @property
    def final(self) -> Vector:
        """Error of each state at the end, shape (2n,)."""
        return np.asarray(self.error[-1])

    @property
    def events(self) -> int:
        """Instants of events, openings included, that the estimate used."""
        return int(np.count_nonzero(self.heard.instants <= self.stamps[-1]))

    @property
    def rate_per_second(self) -> float | None:
        """By which ``ln V`` falls in a second, until V is near its end; None where it does not."""
        fall, until = self._fall()
        seconds = seconds_between(int(self.stamps[0]), until)
        return fall / seconds if fall > 0 and seconds > 0 else None

    @property
    def rate_per_impact(self) -> float | None:
        """By which ``ln V`` falls an impact used, until V is near its end; None likewise."""
        fall, until = self._fall()
        impacts = self.heard.until(until)
        return fall / impacts if fall > 0 and impacts else None

    def _fall(self) -> tuple[float, int]:
        """By how much ``ln V`` has fallen when V is first near its end, and when that is."""
        if not (self.V[0] > 0 and self.V[-1] > 0):
            return 0.0, int(self.stamps[-1])
        near = int(np.flatnonzero(_NEAR_END * self.V[-1] >= self.V)[0])
        return float(np.log(self.V[0] / self.V[near])), int(self.stamps[near])


class Comparing:
    """Compares while truth and estimate go by, block by block.

    Attributes:
        pairing: takes the blocks of both.
    """

    def __init__(
        self,
        system: System,
        heard: EventOutcomes,
        threshold: float = SETTLED,
        keep: Callable[[ErrorRows], None] | None = None,
    ) -> None:
        """Compare an observer's estimates.

        Args:
            system: gives M and K for V.
            heard: what the observer made of the events.
            threshold: V over V at the start below which the estimate has settled.
            keep: given the rows that count, in order; None to keep them for the result.
        """
        index = {name: c for c, name in enumerate(system.contact_names)}
        impacts = [Impact(stamp, index[name]) for stamp, name in heard.impacts if name in index]
        self.pairing = Pairing()
        self._system, self._heard, self._threshold = system, heard, threshold
        self._curve = ErrorCurve(2 * system.n)
        self._tally = ErrorTally(
            system, heard.reported, impacts, threshold, keep or self._curve.add
        )

    def proceed(self) -> None:
        """Compare what can be compared of the blocks that were added."""
        self._tally.add(self.pairing.settled())

    def finish(self) -> None:
        """Compare what is left, when all blocks have been added."""
        self._tally.add(self.pairing.settled(done=True), done=True)

    def result(self, law: str) -> Comparison:
        """The comparison, when all blocks have been added.

        Raises:
            BagError: no stamp is in both, or every estimate came before its events.
        """
        self.finish()
        tally = self._tally
        if not (tally.samples or tally.late or tally.between):
            raise BagError(
                f"{law}: truth and estimate have no stamp in common: {self.pairing.ranges()};"
                " both must be sampled at the same instants"
            )
        if not tally.samples:
            raise BagError(f"{law}: every estimate came before its events; nothing to compare")
        rows = self._curve.rows()
        start = float(rows.V[0])
        settled = tally.settled if start > 0 or tally.rise == 0 else None
        return Comparison(
            system=self._system,
            law=law,
            stamps=rows.stamps,
            error=rows.error,
            V=rows.V,
            samples=tally.samples,
            late=tally.late,
            stale=self.pairing.truth.stale + self.pairing.estimates.stale,
            mismatch=Mismatch(tally.windows, tally.between, tally.longest, tally.peak),
            heard=self._heard,
            rms=np.sqrt(tally.squares / tally.samples),
            largest=tally.largest,
            largest_rise=tally.rise / start if start > 0 else 0.0,
            threshold=self._threshold,
            settling_time=None
            if settled is None
            else seconds_between(int(rows.stamps[0]), settled),
        )


def compare_law(
    observer: Observer,
    events: Sequence[ImpactEvent],
    truth: Callable[[], Iterable[Series]],
    *,
    threshold: float = SETTLED,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Comparison:
    """``compare_run`` where some event has to be applied.

    Raises:
        BagError: no event could be applied, or no estimate made at the truth's stamps.
        DynamicsError, ImpactLawError, UsageError: as ``compare_run``.
    """
    comparison, verdicts = compare_run(
        observer, events, truth, threshold=threshold, progress=progress
    )
    if verdicts and not comparison.heard.instants.size:
        raise BagError(_unheard(observer, verdicts))
    return comparison


def compare_run(
    observer: Observer,
    events: Sequence[ImpactEvent],
    truth: Callable[[], Iterable[Series]],
    *,
    system: System | None = None,
    threshold: float = SETTLED,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> tuple[Comparison, list[Verdict]]:
    """Run an observer over events and compare what it says with the truth.

    Estimates are put aside in a file: what a law thinks of an event may change later.

    Args:
        observer: has seen nothing yet.
        events: in order of episode, stamp and sequence.
        truth: makes the blocks of the plant's states; their stamps are where to estimate.
        system: whose energy V is; None for the observer's.
        threshold: V over V at the start below which the estimate has settled.
        progress: told the estimates made and the stamps to make them for.

    Returns:
        The comparison, and every verdict.

    Raises:
        BagError: no estimate could be made at the truth's stamps.
        DynamicsError: an estimate has left all bounds.
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    stamps, law = np.unique(np.concatenate([block.stamps for block in truth()])), observer.law.name
    verdicts: list[Verdict] = []
    with TemporaryFile() as aside:
        made = 0
        for item in replay(observer, events, stamps):
            if isinstance(item, Verdict):
                verdicts.append(item)
            else:
                _put_aside(item, aside)
                made += 1
                progress(made, stamps.size)
        heard = outcomes_of(events, verdicts)
        if not made:
            none = verdicts and not heard.instants.size
            raise BagError(
                _unheard(observer, verdicts)
                if none
                else f"{law}: no impact was heard, so there is no estimate to compare"
            )
        comparing = Comparing(system or observer.system, heard, threshold)
        aside.seek(0)
        estimates = _taken_back(aside, 2 * observer.system.n)
        for block in truth():
            comparing.pairing.truth.add(block)
            newest = comparing.pairing.estimates
            while newest.newest < comparing.pairing.truth.newest and (
                series := next(estimates, None)
            ):
                if not np.isfinite(series.x).all():
                    raise DynamicsError(f"{law}: the estimate has left all bounds")
                newest.add(series)
            comparing.proceed()
        return comparing.result(law), verdicts


def _unheard(observer: Observer, verdicts: Sequence[Verdict]) -> str:
    """That no event could be applied, and why the first could not."""
    return f"{observer.law.name}: no event could be applied: {verdicts[0].reason}"


def _put_aside(estimate: Estimate, file: IO[bytes]) -> None:
    """Write an estimate behind the others."""
    stamps = np.array([estimate.stamp, estimate.last_event], dtype=np.int64)
    file.write(stamps.tobytes() + estimate.q.tobytes() + estimate.u.tobytes())


def _taken_back(file: IO[bytes], width: int) -> Iterator[Series]:
    """Estimates of ``width`` states from such a file."""
    row = np.dtype([("stamp", "i8"), ("last_event", "i8"), ("x", "f8", (width,))])
    while data := file.read(_BLOCK * row.itemsize):
        block = np.frombuffer(data, dtype=row)
        yield Series(block["stamp"].copy(), block["x"].copy(), block["last_event"].copy())


def impacts_in(events: Iterable[ImpactEvent]) -> dict[str, Stamps]:
    """Stamps of the impacts (ns), by contact; a closing is one too, what it supersedes is none."""
    by_contact: dict[str, list[int]] = {}
    for stamp, contact, _ in impacts_of(events):
        by_contact.setdefault(contact, []).append(stamp)
    return {name: np.array(stamps, dtype=np.int64) for name, stamps in sorted(by_contact.items())}
