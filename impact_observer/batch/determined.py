# SPDX-License-Identifier: Apache-2.0
"""Which part of the state at the start the impacts of a recording determine.

Two motions under the same ``chi`` differ by an error that obeys linear equations with known
instants, and that moves no gap at its impact. So the rows of the matrix of a fit, with jumps at
the stamps and mapped back to the start, are what any law can know of the start: their singular
values say how far a wrong start moves the recorded gaps, their null space what these never show.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from impact_observer.batch.motion_fit import BatchProblem, linearised_fit
from impact_observer.batch.passes import NoiseSizes
from impact_observer.batch.recorded_run import RecordedRun
from impact_observer.batch.sample_rows import flight_samples
from impact_observer.draw.reports import ReportLine, counted
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent
from impact_observer.model import System
from impact_observer.model.contact_sensors import NO_SENSORS, ContactErrors
from impact_observer.model.measurement import Measurement
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.system import unit_of
from impact_observer.observer.samples import SensorSample
from impact_observer.states import Matrix, Vector

_TOLERANCE = 1e-9
"""Singular value that counts as zero, relative to the largest: the limit of stamps of 1 ns."""
_CLEAN = 1e-6
"""Largest entry of an undetermined direction that is a rounded zero."""
_SHOWN = 6
"""Most terms of a combination, and most combinations."""
_SMALL = 0.005
"""Smallest printed term of a combination over the largest, both in standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class Determined:
    """What the impacts of a recording, and samples beside them, say of the state at its start.

    Attributes:
        system: the system.
        deviation: standard deviations of the initial state, shape (2n,); 0 for certain states.
        impacts: number of instants at which contacts impact or close.
        seconds: from the start to the last of them.
        full_after: impacts and seconds after which the rank is full; None if it is not.
        singular: singular values, m, the largest first, shape (states,): how far a start that is
            wrong by one standard deviation moves the recorded gaps in all.
        rank: number of singular values that are not zero.
        undetermined: errors of the initial state that move no gap, one standard deviation long,
            SI units, shape (states - rank, 2n): a basis that is zero wherever it can be.
        remaining: these errors after the last event, same shape.
        weakest: the error of the initial state that moves gaps least, one deviation long, (2n,).
    """

    system: System
    deviation: Vector
    impacts: int
    seconds: float
    full_after: tuple[int, float] | None
    singular: Vector
    rank: int
    undetermined: Matrix
    remaining: Matrix
    weakest: Vector

    @property
    def size(self) -> int:
        """Number of uncertain coordinates and velocities."""
        return int(np.count_nonzero(self.deviation))

    @property
    def condition(self) -> float | None:
        """Largest over smallest singular value; None without full rank."""
        full = self.rank == self.size
        return float(self.singular[0] / self.singular[-1]) if full else None


def determined(
    system: System,
    events: Sequence[ImpactEvent],
    deviation: Vector,
    *,
    measurements: Sequence[Measurement] = (),
    samples: Sequence[SensorSample] = (),
) -> Determined:
    """What the impacts among ``events`` say of the state at their start.

    Args:
        system: whose events they are.
        events: in any order; the last episode counts.
        deviation: standard deviations of the initial state, shape (2n,).
        measurements: of sensors beside the impacts.
        samples: of these sensors.

    Raises:
        UsageError: no state is uncertain.
        BagError: the events contain no impact of the system's contacts.
        ImpactLawError: the impact law has no solution at an event.
    """
    if not np.any(deviation):
        raise UsageError("deviation: 0 throughout; expected some state that is uncertain")
    system = replace(system, live=None)  # forces change no row
    run = RecordedRun.last(system, events)
    within = run.start, max(key.stamp for key in run.keys)
    problem = BatchProblem(
        family=ParametricFamily(system, ()),
        moments=run.reported(),
        mean=np.zeros(2 * system.n),
        start=np.diag(deviation),
        theta=np.zeros((0, 0)),
        errors=ContactErrors.of(NO_SENSORS, system.contact_names, 0.0),
        samples=flight_samples(system, measurements, samples, run.epoch, within),
    )
    rows, moment, after = _mapped_back(problem)
    singular, directions = np.linalg.svd(rows, full_matrices=True)[1:]
    states = rows.shape[1]
    singular = np.append(singular, np.zeros(max(states - singular.size, 0)))[:states]
    rank = int(np.sum(singular > _TOLERANCE * singular[0])) if singular[0] > 0 else 0
    undetermined = _sparse_basis(directions[rank:])
    if undetermined.size:
        undetermined = undetermined / np.linalg.norm(undetermined, axis=1, keepdims=True)
        undetermined = _with_sign(np.where(np.abs(undetermined) > _CLEAN, undetermined, 0.0))
    root = np.diag(deviation)[:, deviation > 0]
    t = [float(each.t - problem.moments.start) for each in problem.moments.each]
    hits = [k for k, each in enumerate(problem.moments.each) if each.switching.hit]
    full_after = None
    if rank == states:
        k = next(k for k in hits if _rank(rows[moment <= k], singular[0]) == states)
        full_after = hits.index(k) + 1, t[k]
    return Determined(
        system=system,
        deviation=deviation,
        impacts=len(hits),
        seconds=t[-1],
        full_after=full_after,
        singular=singular,
        rank=rank,
        undetermined=undetermined @ root.T,
        remaining=undetermined @ after.T,
        weakest=root @ _with_sign(directions[states - 1 :])[0],
    )


def _mapped_back(problem: BatchProblem) -> tuple[Matrix, Vector, Matrix]:
    """Return the rows and their moments, and the state after the last moment, both by the start.

    Columns are the uncertain states, in deviations.
    """
    still = np.tile(problem.mean, (problem.moments.count + 1, 1))
    fit = linearised_fit(problem, np.zeros(0), still, sizes=NoiseSizes(1.0), is_first=True)
    motion, samples, d = fit.motion, fit.samples, problem.mean.size
    root = np.diag(problem.start)
    X = problem.start[:, root > 0]
    rows, moment = [np.zeros((0, X.shape[1]))], list[int]()
    for k in range(problem.moments.count + 1):
        X = motion.jump[k] @ X
        own = samples.node == k
        rows.append(samples.h[own, :d] @ X)
        moment += [k] * int(own.sum())
        if k < problem.moments.count:
            X = motion.Phi[k] @ X
            own = problem.moments.row_moment == k
            rows.append((motion.late_by_x[own] * motion.speed[own, None]) @ X)
            moment += [k] * int(own.sum())
    return np.vstack(rows), np.array(moment), X


def _rank(rows: Matrix, size: float) -> int:
    return int(np.sum(np.linalg.svd(rows, compute_uv=False) > _TOLERANCE * size))


def _with_sign(directions: Matrix) -> Matrix:
    """Return the rows with the largest entry of each positive."""
    largest = np.argmax(np.abs(directions), axis=1, keepdims=True)
    return directions * np.sign(np.take_along_axis(directions, largest, axis=1))


def determined_json(found: Determined) -> dict[str, object]:
    """The values of ``--json``: SI units, None for a number without a meaning."""
    impacts, seconds = found.full_after or (None, None)
    return {
        "states": list(found.system.state_names),
        "deviation": found.deviation.tolist(),
        "impacts": found.impacts,
        "rank": found.rank,
        "singular_values": found.singular.tolist(),
        "condition": found.condition,
        "impacts_to_full_rank": impacts,
        "seconds_to_full_rank": seconds,
        "unknown": found.undetermined.tolist(),
        "unknown_at_the_end": found.remaining.tolist(),
        "least_known": found.weakest.tolist(),
    }


def determined_lines(found: Determined) -> Iterator[ReportLine]:
    """What to know of the impacts."""
    yield ReportLine(
        "", f"{counted(found.impacts, 'impact')} in {found.seconds:.3f} s of {found.system.name}"
    )
    if found.full_after is not None:
        impacts, seconds = found.full_after
        unit = unit_of("m", found.system.unit)
        yield ReportLine(
            "ok",
            f"Full rank after {counted(impacts, 'impact')}, {seconds:.3f} s after the start: all"
            f" {found.size} numbers of the state are determined.",
        )
        yield ReportLine(
            "note",
            f"Least known: {_combination(found, found.weakest)}. A start that is wrong by that"
            f" moves the recorded gaps by {found.singular[-1]:.2g} {unit} in all,"
            f" {found.condition:.3g} times less than the best known one.",
        )
        return
    yield ReportLine(
        "warning",
        f"The rank is {found.rank} of {found.size}. A start that is wrong by one of these gives"
        " the same impacts:",
    )
    pairs = list(zip(found.undetermined, found.remaining, strict=True))
    for direction, left in pairs[:_SHOWN]:
        gone = np.max(np.abs(left)) <= _TOLERANCE * np.max(np.abs(direction))
        end = "gone at the end" if gone else f"at the end {_combination(found, left)}"
        yield ReportLine("", f"{_combination(found, direction)}, {end}")
    if len(pairs) > _SHOWN:
        yield ReportLine("", f"and {len(pairs) - _SHOWN} more, in --json")


def _combination(found: Determined, direction: Vector) -> str:
    """Return a direction of the state as a sum, such as ``0.71 x1 + 0.70 dx2/dt``."""
    size = np.abs(direction) / np.where(found.deviation > 0, found.deviation, 1.0)
    worth = np.flatnonzero(size >= _SMALL * np.max(size))
    terms = sorted(worth[np.argsort(-size[worth])][:_SHOWN].tolist())
    text = " + ".join(f"{direction[i]:#.2g} {found.system.state_names[i]}" for i in terms)
    more = len(worth) - len(terms)
    return text.replace("+ -", "- ") + (f" and {more} more" if more else "")


def _sparse_basis(rows: Matrix) -> Matrix:
    """Another basis of the span of ``rows``, each zero where another has its pivot."""
    if len(rows) == 0:
        return rows
    pivots = linalg.qr(rows, mode="r", pivoting=True)[1][: len(rows)]
    return np.asarray(linalg.solve(rows[:, sorted(pivots.tolist())], rows))
