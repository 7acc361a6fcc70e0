"""Which impacts of a recording are believed: what sensors invent and miss spoils any fit.

The first word has the observer of minimum variance, told that its model is wrong: it weighs every
impact against being spurious, and knows where one is missing. Then the fitted motion is
judge: an impact whose stamp is too far from the instant at which the motion hits is doubted, and
where the motion would go through a stop an impact is inserted, or a doubted one believed again.
"""

import numpy as np
from scipy import linalg, optimize

from impact_observer.dynamics import Phases
from impact_observer.estimation.uncertainty import Uncertainty
from impact_observer.events import ImpactEvent, Ruling, Verdict, final_rulings
from impact_observer.identify.least_squares import Problem, Solution, usual_size
from impact_observer.identify.recorded_impacts import Hit, Recording
from impact_observer.model import System
from impact_observer.observer import Observer, initial_state, law_named, replay
from impact_observer.stamps import from_seconds
from impact_observer.states import Vector

_LARGEST = 0.1
"""Most that may be declared of a clock, s."""
_ASTRAY = 0.01
"""Noise of accelerations, relative to those of the fastest mode, that stands for a wrong model."""
_DOUBTED = 5.0
"""Deviations of a stamp from which on it is doubted: of a million true ones it doubts one."""
_ROUNDED = 1e-9
"""Least deviation of a stamp, s."""
_NEAR = 0.1
"""How far from a stamp an impact that nobody heard may have been, relative to the time between."""
_NEARER = 0.5
"""Distance of a doubted impact, relative to that of the one believed, that changes places."""
_LOOKED = 0.01
"""How far from its predicted instant a doubted impact may be to be believed again, s."""
_PRECISION = 1e-7
"""Depth of a penetration that is rounding, relative to the motion."""
_SAMPLES = 24
"""Looks at a motion within a period of the fastest mode."""
_MOST = 2000
"""Most looks between two moments."""


def first_word(
    system: System, recording: Recording, events: list[ImpactEvent], wrong: float | None
) -> Recording:
    """What an observer of minimum variance believes, its model taken to be wrong.

    Args:
        system: as the model says.
        recording: what is heard.
        events: the same, as an observer hears them.
        wrong: by which the model is wrong, as if it were the stamps, s; None for wrong
            accelerations instead.
    """
    n = system.n
    reach = 2 * float(np.max(np.abs(system.q_r), initial=0.0)) or 1.0
    rate = float(np.sqrt(linalg.norm(linalg.solve(system.M, system.K), 2))) or 1.0
    declared = Uncertainty(
        deviation=np.repeat([reach, reach * rate], n),
        clock_error=None if wrong is None else min(wrong, _LARGEST),
        model_error=_ASTRAY * reach * rate**1.5 if wrong is None else 0.0,
    )
    law = law_named("minimum-variance")(system, declared)
    span = 1.0 + (recording.told.keys[-1].stamp - recording.told.start) * 1e-9
    observer = Observer(
        system,
        law,
        *initial_state("zero", system),
        epoch=recording.told.epoch,
        history=span,
        ensemble=1,
    )
    none = np.empty(0, dtype=np.int64)
    verdicts = [v for v in replay(observer, events, none) if isinstance(v, Verdict)]
    index = {name: i for i, name in enumerate(system.contact_names)}
    rulings = final_rulings(verdicts)
    heard = {(key.stamp, i) for key in recording.told.keys for i, _ in key.switches}
    found: dict[Ruling, set[Hit]] = {Ruling.REJECTED: set(), Ruling.INSERTED: set()}
    for (stamp, _, contact), ruling in rulings.items():
        if ruling in found and contact in index:
            found[ruling].add((stamp, index[contact]))
    return recording.marked(found[Ruling.REJECTED] & heard, found[Ruling.INSERTED] - heard)


def judged(
    recording: Recording, problem: Problem, solution: Solution, clock: float | None
) -> Recording:
    """The recording as a fitted motion sees it; the same one where nothing is wrong.

    Args:
        recording: as it was believed for the fit.
        problem: that was solved.
        solution: the fitted motion.
        clock: standard deviation of a stamp, s; None where the shifts tell.
    """
    deviation = max(clock or usual_size(solution.shifts, solution.freedom), _ROUNDED)
    doubted, inserted = set(recording.doubted), set(recording.inserted)
    worst = int(np.argmax(np.abs(solution.shifts)))
    nearer = _mistaken(recording, solution)
    if nearer is not None or abs(solution.shifts[worst]) > _DOUBTED * deviation:
        worst = worst if nearer is None else nearer
        return _moved(recording, problem, solution, worst, _DOUBTED * deviation)
    for stamp, contact in penetrations(recording, problem, solution, deviation):
        near = {
            hit
            for hit in recording.doubted
            if hit[1] == contact and abs(hit[0] - stamp) * 1e-9 <= _DOUBTED * deviation + _LOOKED
        }
        doubted -= near
        inserted |= set() if near else {(stamp, contact)}
    return recording.marked(doubted, inserted)


def _mistaken(recording: Recording, solution: Solution) -> int | None:
    """Which believed impact has a doubted one beside it that is much nearer to the motion's."""
    hits = recording.hits()
    for j, k in enumerate(solution.counted.tolist()):
        at = recording.told.epoch + from_seconds(float(solution.t[k]))
        for stamp, contact in recording.doubted:
            own = abs(solution.shifts[j])
            if contact in hits[k][1] and abs(stamp - at) * 1e-9 + _ROUNDED < _NEARER * own:
                return j
    return None


def _moved(
    recording: Recording, problem: Problem, solution: Solution, worst: int, width: float
) -> Recording:
    """The impact whose stamp fits worst is doubted; another takes its place if there was one.

    Args:
        recording: as it was believed for the fit.
        problem: that was solved.
        solution: the fitted motion, which hits at another instant than the stamp.
        worst: index among the moments that count.
        width: by which a stamp may be wrong, s.
    """
    k = solution.counted[worst]
    stamp, contacts = recording.hits()[k]
    at = recording.told.epoch + from_seconds(float(solution.t[k]))
    doubted = {*recording.doubted, *((stamp, i) for i in contacts)} - recording.inserted
    inserted = set(recording.inserted)
    reach = max(width, _NEARER * abs(float(solution.shifts[worst]))) + _ROUNDED
    near = {hit for hit in recording.doubted if abs(hit[0] - at) * 1e-9 <= reach}
    near = {hit for hit in near if hit[1] in contacts}
    hits = bool(np.all(solution.shot.speeds[solution.shot.moment == k] < 0))
    if near:
        doubted -= near
    elif hits and abs(solution.shifts[worst]) <= _NEAR * problem.interval:
        inserted |= {(at, i) for i in contacts}
    return recording.marked(doubted, inserted)


def penetrations(
    recording: Recording, problem: Problem, solution: Solution, deviation: float
) -> set[Hit]:
    """Where a fitted motion goes through a stop for longer than stamps err: the first times."""
    system = problem.family.system_at(solution.y[2 * problem.family.system.n :])
    phases = Phases(system)
    ends = np.append(solution.t, np.nan)
    found = set()
    for k, moment in enumerate(problem.moments[:-1]):
        length = float(ends[k + 1] - ends[k])
        if length <= 0:
            continue
        phase = phases.phase(moment.held)
        motion = phase.start(float(ends[k]), solution.shot.states[k])
        count = int(min(_SAMPLES * (length * _rate(system) / 6 + 1), _MOST))
        s = np.linspace(0.0, length, count + 1)
        gaps = motion.states(s)[:, : system.n] @ system.W + system.q_r
        speeds = np.maximum(
            np.max(np.abs(motion.states(s)[:, system.n :] @ system.W), axis=0), 1e-30
        )
        reach = np.max(np.abs(gaps), axis=0)
        deep = -np.min(gaps, axis=0)
        for i in np.flatnonzero(deep > _DOUBTED * deviation * speeds + _PRECISION * reach):
            if i in moment.held:
                continue
            at = _closing(s, gaps[:, i], float(deep[i]))
            found.add((recording.told.epoch + from_seconds(float(ends[k]) + at), int(i)))
            break
    return found


def _closing(s: Vector, gap: Vector, depth: float) -> float:
    """When a sampled gap comes to zero before it is ``depth`` below it first, s."""
    deep = int(np.argmax(gap <= -depth / 2))
    above = np.flatnonzero(gap[:deep] > 0)
    left = int(above[-1]) if above.size else 0
    if gap[left] <= 0:
        return float(s[max(deep - 1, 0)])
    right = left + 1
    return float(
        optimize.brentq(
            lambda at: np.interp(at, s[[left, right]], gap[[left, right]]), s[left], s[right]
        )
    )


def _rate(system: System) -> float:
    """The fastest undamped frequency or that of the forcing, rad/s."""
    own = float(np.sqrt(linalg.norm(linalg.solve(system.M, system.K), 2)))
    return max(own, float(np.max(system.forcing.frequency, initial=0.0)), 1e-3)
