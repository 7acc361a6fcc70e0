"""From a recording of impact times to the parameters of its model."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.errors import IdentificationError, UsageError
from impact_observer.events import ImpactEvent
from impact_observer.identify.least_squares import (
    Problem,
    Solution,
    by_gaps,
    directions,
    solved,
    start_of,
)
from impact_observer.identify.plausibility import first_word, judged
from impact_observer.identify.recorded_impacts import Recording
from impact_observer.model import System
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer.episode import last_episode
from impact_observer.stamps import seconds_between
from impact_observer.states import Matrix, Vector, frozen

ROUNDED = 1e-9 / np.sqrt(12)
"""Standard deviation of a stamp that is wrong by its rounding only, s."""
_ROUNDS = 12
"""Most times that the impacts are judged anew."""
_SUSPICIOUS = 0.01
"""Error of stamps, relative to the time between two, from which on impacts are doubted."""
_EXCESS = 1.5
"""Error of stamps over a declared one from which on impacts are doubted."""
_LOST = 0.02
"""Error of stamps, relative to the time between two, that explains nothing."""
_STILL = 1e-9
"""Contact speed of no motion, m/s."""
_WRONG = 0.03
"""By which a wrong model is taken to move impacts, relative to the time between two."""
_BELIEVED = 2 / 3
"""Share of the impacts that has to be believed, and heard, of a recording that is explained."""
_PART = 1e-3
"""Term of a combination that is none, relative to the largest."""
_MINOR = 0.2
"""The same of one that is told too weakly, in sizes of the parameters."""


class Term(NamedTuple):
    """One parameter's part in a combination, in units of the parameter."""

    name: str
    change: float


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """What impact times say of a model.

    Attributes:
        family: the given system and its free parameters.
        recording: what was believed of the impacts.
        values: of the parameters, shape (p,), SI units.
        covariance: of initial state and parameters, shape (2n + p, 2n + p).
        start: initial state (q, u), shape (2n,), at ``recording.start``.
        clock: standard deviation of a stamp that the errors rest on, s.
        declared: whether it was declared; else the shifts told it.
        rms: of the shifts, over the degrees of freedom that are left, s.
        freedom: those.
        stamps: of the impacts that were compared, s since the epoch, shape (counted,).
        shifts: by which each was earlier than the motion's, s, shape (counted,).
        contacts: the contacts of each.
        singular: singular values of the gaps with the unknowns, each in its unit, over the
            largest, shape (2n + p,).
        unknown: combinations of parameters that the impacts do not tell.
        converged: whether the steps came to an end at something that explains the stamps.
    """

    family: ParametricFamily
    recording: Recording
    values: Vector
    covariance: Matrix
    start: Vector
    clock: float
    declared: bool
    rms: float
    freedom: int
    stamps: Vector
    shifts: Vector
    contacts: tuple[tuple[str, ...], ...]
    singular: Vector
    unknown: tuple[tuple[Term, ...], ...]
    converged: bool

    @property
    def errors(self) -> Vector:
        """Standard errors of the parameters, shape (p,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance))[self.start.size :])

    @property
    def start_errors(self) -> Vector:
        """Standard errors of the initial state, shape (2n,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance))[: self.start.size])

    @property
    def correlation(self) -> Matrix:
        """Of the parameters, shape (p, p)."""
        own = self.covariance[self.start.size :, self.start.size :]
        scale = np.where(self.errors > 0, self.errors, 1.0)
        return np.asarray(own / np.outer(scale, scale))

    @property
    def system(self) -> System:
        """The system as it was learnt.

        Raises:
            ModelError: it is none.
        """
        return self.family.system_at(self.values)

    @property
    def bounded(self) -> tuple[str, ...]:
        """Names of parameters that would go beyond what they can be."""
        low, high = self.family.bounds
        at = (self.values <= low) | (self.values >= high)
        return tuple(np.array(self.family.names)[at].tolist())


def identify(
    family: ParametricFamily,
    events: list[ImpactEvent],
    *,
    clock: float | None = None,
    horizon: float | None = None,
    believe: bool = False,
    progress: Callable[[str], None] = lambda _: None,
) -> Identified:
    """Learn the parameters of a family, and the initial state, from impact times.

    Args:
        family: a system and what is free of it.
        events: of the last episode among them.
        clock: standard deviation of a stamp, s; None where the impacts tell.
        horizon: seconds of the recording that count; None for all.
        believe: whether every impact is believed.
        progress: told what is being done.

    Raises:
        UsageError: the forcing is sampled.
        BagError: no event tells an impact of the system's contacts.
        IdentificationError: fewer impacts than unknowns, or parameters that no impact tells.
        ImpactLawError: the impact law has no solution at an event.
    """
    if family.system.forcing.sampled is not None:
        raise UsageError(
            f"{family.system.name}: its forcing is sampled, which identify cannot take; expected"
            " a constant and harmonics"
        )
    told = last_episode(family.system, events)
    if horizon is not None:
        keys = [key for key in told.keys if seconds_between(told.start, key.stamp) <= horizon]
        told = told._replace(keys=keys)
    recording = Recording(told)
    progress("all impacts believed")
    problem, solution = _fit(recording.problem(family))
    found = _identified(recording, problem, solution, clock)
    if believe or not _is_suspicious(problem, solution, clock):
        return found
    for wrong in (_WRONG * problem.interval, None):
        progress("which impacts are true")
        word = first_word(family.system, recording, events, wrong)
        found = _identified(*_judged(word, family, clock, progress), clock)
        if found.converged:
            break
    return found


def _judged(
    recording: Recording,
    family: ParametricFamily,
    clock: float | None,
    progress: Callable[[str], None],
) -> tuple[Recording, Problem, Solution]:
    """What is believed when fit and judgement agree, and the fit."""
    problem, solution = _fit(recording.problem(family), robust=True)
    for round_ in range(_ROUNDS):
        after = judged(recording, problem, solution, clock)
        if (after.doubted, after.inserted) == (recording.doubted, recording.inserted):
            break
        recording = after
        progress(f"impacts judged anew, round {round_ + 1}")
        problem, solution = _fit(recording.problem(family), solution.y, robust=True)
    return recording, *_fit(recording.problem(family), solution.y)


def _fit(
    problem: Problem, near: Vector | None = None, *, robust: bool = False
) -> tuple[Problem, Solution]:
    """The motion that explains a recording best.

    Args:
        problem: what is to be explained.
        near: where to begin; None for the gaps to tell.
        robust: whether some impacts may be wrong.

    Raises:
        IdentificationError: fewer impacts than unknowns, or parameters that no impact tells.
    """
    unknowns = 2 * problem.family.system.n + problem.family.size
    hits = sum(len(each.hit) for each in problem.moments if each.heard)
    if hits <= unknowns:
        raise IdentificationError(
            f"{hits} impacts for {unknowns} unknowns, {problem.family.size} of them parameters;"
            " expected more: record longer, or free less"
        )
    if near is not None:
        found = solved(problem, near, robust=robust)
        if found.converged:
            return problem, found
    y = start_of(problem)
    shot = problem.shot(y)
    if np.max(np.abs(shot.speeds)) <= _STILL:
        raise IdentificationError(
            "no force and no gap tells the size of the motion, which has the same impacts at any"
            " size; expected a gap that is not 0, or a force"
        )
    if lost := combinations_of(problem, directions(problem, shot).unknown):
        words = "; ".join(combination(each) for each in lost)
        one = all(len(each) == 1 for each in lost)
        raise IdentificationError(
            f"{words}: no impact moves by that, so it is not to be told from impact times;"
            f" hold {'it' if one else 'one of them'} fixed"
        )
    return problem, solved(problem, by_gaps(problem, y, robust=robust), robust=robust)


def combinations_of(problem: Problem, unknown: Matrix) -> tuple[tuple[Term, ...], ...]:
    """The parts that parameters have in directions, shape (2n + p, k), that nothing tells."""
    family = problem.family
    part = unknown[2 * family.system.n :] / family.sizes[:, None]
    if not part.size or np.max(np.abs(part)) <= _PART:
        return ()
    # The directions of parameters alone, whatever the initial state does beside them.
    left, singular, _ = linalg.svd(part, full_matrices=False)
    found = []
    for direction in _readable(left[:, singular > _PART].T):
        largest = np.max(np.abs(direction))
        found.append(
            tuple(
                Term(name, float(value * size / largest))
                for name, value, size in zip(family.names, direction, family.sizes, strict=True)
                if abs(value) > _PART * largest
            )
        )
    return tuple(found)


def _readable(rows: Matrix) -> Matrix:
    """Another basis of the rows' span, each zero where another has its pivot."""
    if len(rows) == 0:
        return rows
    pivots = linalg.qr(rows, mode="r", pivoting=True)[1][: len(rows)]
    return np.asarray(linalg.solve(rows[:, sorted(pivots.tolist())], rows))


def combination(terms: tuple[Term, ...]) -> str:
    """A combination in words, such as ``+1 mass-scale +1 stiffness-scale``."""
    return " ".join(f"{each.change:+.3g} {each.name}" for each in terms)


def _is_suspicious(problem: Problem, solution: Solution, clock: float | None) -> bool:
    """Whether some impacts may be none, or some may be missing."""
    least = _SUSPICIOUS * problem.interval if clock is None else _EXCESS * max(clock, 1e-9)
    return not solution.converged or solution.rms > least


def _identified(
    recording: Recording, problem: Problem, solution: Solution, clock: float | None
) -> Identified:
    family, n = problem.family, problem.family.system.n
    used = max(solution.rms if clock is None else clock, ROUNDED)
    root = solution.root * used
    covariance = root @ root.T
    found = directions(problem, solution.shot)
    own = covariance[2 * n :, 2 * n :] / np.outer(family.sizes, family.sizes)
    values, axes = linalg.eigh(own) if own.size else (np.zeros(0), np.zeros((0, 0)))
    axes = axes[:, values > 1.0]
    # Few stamps turn an axis a little: what has hardly a part in it may be told by itself.
    axes = np.where(np.abs(axes) < _MINOR * np.max(np.abs(axes), axis=0, initial=0.0), 0.0, axes)
    weak = np.vstack([np.zeros((2 * n, axes.shape[1])), axes * family.sizes[:, None]])
    changed = len(recording.doubted) + len(recording.inserted)
    hits, names = recording.hits(), family.system.contact_names
    return Identified(
        family=family,
        recording=recording,
        values=frozen(solution.y[2 * n :]),
        covariance=frozen(covariance),
        start=frozen(solution.y[: 2 * n]),
        clock=used,
        declared=clock is not None,
        rms=solution.rms,
        freedom=int(solution.freedom),
        stamps=frozen(problem.stamps[solution.counted]),
        shifts=frozen(solution.shifts),
        contacts=tuple(tuple(names[i] for i in hits[k][1]) for k in solution.counted),
        singular=frozen(found.singular / found.singular[0]),
        unknown=combinations_of(problem, np.hstack([found.unknown, weak])),
        converged=solution.converged
        and solution.rms <= _LOST * problem.interval
        and solution.counted.size >= _BELIEVED * (solution.counted.size + changed),
    )
