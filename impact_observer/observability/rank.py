# SPDX-License-Identifier: Apache-2.0
"""Which part of the state impact times determine: the observability matrix of a recording.

Two motions under the same ``chi`` differ by a ``d`` that obeys linear equations with known
coefficients: the transition matrices of the phases, and a matrix for the jump of ``du`` at an
impact. There ``W_i^T dq = 0`` for the contact ``i`` that hits, since both motions are on the stop.
While the contact stays closed ``W_i^T du = 0`` too. Where the contact opens by itself its load has
come down to zero, which is one more row. So every event adds rows, times ``T``, to a matrix on
``d`` at the start, where ``T`` is the transition matrix from the start. Its singular
values say how much of a wrong initial state the recorded gaps show, and its null space what they
never show, to any law.

What sensors measure beside the impacts is a linear function of ``d``, too: each sample adds a row.

An instant with several impacts counts as if all of them were equally fast. Inequalities (``g >=
0`` at all other times, ``gamma- <= 0``, loads that only press) are not used.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.errors import ImpactLawError, UsageError
from impact_observer.events import ImpactEvent
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.readings import DeclaredSensor
from impact_observer.filter.square_root import sparse_basis
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.model import System
from impact_observer.observability.rank_rows import RankRows
from impact_observer.observer.episode import Episode, last_episode
from impact_observer.observer.samples import SensorSample
from impact_observer.stamps import seconds_between, text
from impact_observer.states import Matrix, Stamps, Vector, frozen

TOLERANCE = 1e-9
"""Singular value that counts as zero, relative to the largest: the limit of stamps of 1 ns."""
_CLEAN = 1e-6
"""Largest entry of an undetermined direction that is a rounded zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """The part of the initial state that the impacts of a recording determine.

    An *impact* is an instant at which any contact impacts or closes, a *release* one at which a
    single contact opens by itself. Other instants add no information, and are left out.

    Attributes:
        system: the system.
        episode: the events; the initial state holds at its start.
        deviation: standard deviations of that state, shape (2n,); 0 for certain states.
        tolerance: singular value that counts as zero, relative to the largest.
        stamps: of impacts and releases, ns, shape (events,).
        released: which of them are releases, shape (events,).
        contacts: names of those that hit or open, for each.
        singular: singular values after each, m, shape (events, states), the largest first: how
            far a wrong start, by one standard deviation, moves the recorded gaps in all.
        rank: number of singular values above the tolerance, shape (events,); it never falls.
        undetermined: errors of the initial state that moved no gap, one standard deviation long,
            SI units, shape (states - rank, 2n): a basis that is zero wherever it can be.
        remaining: these errors just after the last event, same shape.
        weakest: the error of the initial state that moved the gaps least, one standard deviation
            long.
        samples: how many samples of each sensor have added rows, by name.
    """

    system: System
    episode: Episode
    deviation: Vector
    tolerance: float
    stamps: Stamps
    released: NDArray[np.bool_]
    contacts: tuple[tuple[str, ...], ...]
    singular: NDArray[np.float64]
    rank: NDArray[np.int64]
    undetermined: Matrix
    remaining: Matrix
    weakest: Vector
    samples: Mapping[str, int] = field(default_factory=dict)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the 2n coordinates and velocities."""
        return self.system.state_names

    @property
    def size(self) -> int:
        """Number of uncertain coordinates and velocities."""
        return int(np.count_nonzero(self.deviation))

    @property
    def seconds(self) -> Vector:
        """Instants of impacts and releases since the start, s, shape (events,)."""
        start = self.episode.start
        return np.array([seconds_between(start, stamp) for stamp in self.stamps.tolist()])

    @property
    def condition(self) -> Vector:
        """Largest over smallest singular value after each event; infinite before full rank."""
        condition = np.full(self.rank.size, np.inf)
        full = self.rank == self.size
        condition[full] = self.singular[full, 0] / self.singular[full, -1]
        return condition

    @property
    def complete(self) -> int | None:
        """Index of the impact or release that made the rank full; None if none did."""
        full = np.flatnonzero(self.rank == self.size)
        return int(full[0]) if full.size else None

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of the uncertain states that no undetermined direction changes."""
        others = np.any(self.undetermined != 0, axis=0) | (self.deviation == 0)
        return tuple(np.array(self.states)[~others].tolist())


def observability(
    system: System,
    events: Sequence[ImpactEvent],
    *,
    deviation: Vector | float = 1.0,
    tolerance: float = TOLERANCE,
    sensors: Sequence[DeclaredSensor] = (),
    samples: Sequence[SensorSample] = (),
) -> Observability:
    """The part of the initial state that the impacts among ``events`` determine.

    Only a triangular factor is kept: time is proportional to the number of events.

    Args:
        system: whose events they are.
        events: in any order. Of several episodes or epochs the last one counts, as with an
            observer. The start is the epoch, or the first stamp where the events do not give an
            epoch or the first of them are missing.
        deviation: standard deviations of the initial state, shape (2n,) or one for all.
        tolerance: singular value that counts as zero, relative to the largest.
        sensors: of what is measured beside the impacts.
        samples: of them; those from the start to the last event add rows, scaled to m.

    Raises:
        UsageError: a standard deviation or tolerance that cannot be used.
        BagError: the events contain no impact of the system's contacts.
        ImpactLawError: the impact law has no solution at an event.
    """
    if not 0 < tolerance < 1:
        raise UsageError(f"tolerance: {tolerance:g} found; expected a number between 0 and 1")
    scale = np.diag(Uncertainty(deviation).root(system.n))
    if not np.any(scale):
        raise UsageError("deviation: 0 throughout; expected some state that is uncertain")
    episode = last_episode(system, events)
    changes = episode.changes
    errors = RankRows(system, scale, sensors)
    used = [s for s in samples if episode.start <= s.stamp <= changes[-1].stamp]
    measured = sorted((seconds_between(episode.start, s.stamp), s.sensor) for s in used)
    factor, singular = _factored(errors, changes, measured)
    counted = [(each, names) for each in changes if (names := errors.informative(each))]
    ranks = [np.count_nonzero(each > tolerance * each[0]) for each in singular]
    rank = np.maximum.accumulate(np.array(ranks, dtype=np.int64))
    directions = linalg.svd(factor)[2]
    undetermined = sparse_basis(directions[rank[-1] :])
    if undetermined.size:
        undetermined /= np.linalg.norm(undetermined, axis=1, keepdims=True)
        undetermined[np.abs(undetermined) <= _CLEAN] = 0.0
        undetermined = _with_sign(undetermined)
    return Observability(
        system=system,
        episode=episode,
        deviation=frozen(scale),
        tolerance=tolerance,
        stamps=np.array([each.stamp for each, _ in counted], dtype=np.int64),
        released=np.array([not each.hit for each, _ in counted]),
        contacts=tuple(tuple(system.contact_names[i] for i in names) for _, names in counted),
        singular=frozen(singular),
        rank=rank,
        undetermined=frozen(_in_all_states(undetermined, scale)),
        remaining=frozen(undetermined @ errors.X.T),
        weakest=frozen(_in_all_states(_with_sign(directions[-1:]), scale)[0]),
        samples=Counter(sensors[s.sensor].name for s in used),
    )


def _factored(
    errors: RankRows,
    changes: Sequence[ContactChange],
    samples: Sequence[tuple[float, int]],
) -> tuple[Matrix, Matrix]:
    """The triangular factor of all rows, and its singular values after each counted event.

    ``samples`` are instants, s since the start, ascending, and sensors; one at an event is later.

    Returns:
        Shapes (size, size) and (events, size).

    Raises:
        ImpactLawError: the impact law has no solution at an event.
    """
    size = errors.X.shape[1]
    factor, singular, first = np.zeros((size, size)), [], 0
    for change in changes:
        last = bisect_left(samples, (change.t,))
        sampled, first = errors.sampled(samples[first:last]), last
        try:
            rows = np.vstack([sampled, errors.cross(change)])
        except ImpactLawError as error:
            raise ImpactLawError(f"at {text(change.stamp)} s: {error}") from None
        is_informative = bool(errors.informative(change))
        if is_informative or len(sampled):
            kept = rows if is_informative else sampled
            factor = linalg.qr(np.vstack([factor, kept]), mode="r")[0][:size]
        if is_informative:
            singular.append(np.linalg.svd(factor, compute_uv=False))
    return factor, np.array(singular)


def _in_all_states(directions: Matrix, scale: Vector) -> Matrix:
    """Rows of uncertain states, in standard deviations, as rows of all states in SI units."""
    rows = np.zeros((len(directions), scale.size))
    rows[:, scale > 0] = directions
    return rows * scale


def _with_sign(directions: Matrix) -> Matrix:
    """The rows with the largest entry of each positive."""
    largest = np.argmax(np.abs(directions), axis=1, keepdims=True)
    return directions * np.sign(np.take_along_axis(directions, largest, axis=1))
