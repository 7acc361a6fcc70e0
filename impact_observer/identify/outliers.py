# SPDX-License-Identifier: Apache-2.0
"""Spurious and missed impacts in a recording, which would spoil any fit.

The fitted motion decides: an impact whose stamp is too far from the instant of the motion's impact
is rejected. Where the motion would go through a stop, an impact is inserted, or a rejected one
accepted again.
"""

import numpy as np
from scipy import linalg

from impact_observer.events import Kind
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.identify.least_squares import usual_size
from impact_observer.identify.problem import Problem, Solution
from impact_observer.identify.recorded_impacts import Hit, Recording
from impact_observer.model import System
from impact_observer.stamps import from_seconds
from impact_observer.states import Vector

_GATE = 5.0
"""Standard deviations of a stamp above which it is rejected: one true stamp in a million is."""
_ROUNDED = 1e-9
"""Least standard deviation of a stamp, s."""
_NEAR = 0.1
"""Largest distance of a missed impact from a rejected stamp, relative to the time between two."""
_NEARER = 0.5
"""Distance of a rejected impact, over that of the accepted one, below which they are swapped."""
_SEARCHED = 0.01
"""Largest distance of a rejected impact from the predicted instant to be accepted again, s."""
_PRECISION = 1e-7
"""Largest depth of a penetration that is rounding, relative to the motion."""
_SAMPLES = 24
"""Samples of a motion within a period of the fastest mode."""
_MOST = 2000
"""Most samples between two moments."""


def has_hit_twice(recording: Recording, interval: float) -> bool:
    """Whether some hit is rejected, and inserted beside.

    ``interval`` is the usual time between two moments, s.
    """
    reach = from_seconds(_NEAR * interval)
    return any(
        contact == other and abs(stamp - at) <= reach
        for stamp, contact in recording.rejected
        for at, other in recording.inserted
    )


def outliers_by_motion(
    recording: Recording, problem: Problem, solution: Solution, clock: float | None
) -> Recording:
    """The recording with one more outlier, or all missed impacts; unchanged if none is left.

    ``clock`` is the standard deviation of a stamp, s; None to estimate it from the shifts.
    """
    deviation = max(clock or usual_size(solution.shifts, solution.freedom), _ROUNDED)
    rejected, inserted = set(recording.rejected), set(recording.inserted)
    worst = int(np.argmax(np.abs(solution.shifts)))
    swapped = _mistaken(recording, solution)
    if swapped is not None or abs(solution.shifts[worst]) > _GATE * deviation:
        worst = worst if swapped is None else swapped
        return _moved(recording, problem, solution, worst, _GATE * deviation)
    if pairs := _mislabelled(recording, solution, _GATE * deviation):
        inserted -= {*pairs.values()}
        struck = {event: contact for event, (_, contact) in pairs.items()}
        return recording.with_outliers(rejected - {*pairs}, inserted).relabelled(struck)
    for stamp, contact in penetrations(recording, problem, solution, deviation):
        near = {
            hit
            for hit in recording.rejected
            if hit[1] == contact and abs(hit[0] - stamp) * 1e-9 <= _GATE * deviation + _SEARCHED
        }
        rejected -= near
        inserted |= set() if near else {(stamp, contact)}
    return recording.with_outliers(rejected, inserted)


def _mistaken(recording: Recording, solution: Solution) -> int | None:
    """Index of an accepted impact that is much farther from the motion's than a rejected one."""
    hits = recording.hits()
    for j, k in enumerate(solution.counted.tolist()):
        at = recording.episode.epoch + from_seconds(float(solution.t[k]))
        for stamp, contact in recording.rejected:
            own = abs(solution.shifts[j])
            if contact in hits[k][1] and abs(stamp - at) * 1e-9 + _ROUNDED < _NEARER * own:
                return j
    return None


def _mislabelled(recording: Recording, solution: Solution, width: float) -> dict[Hit, Hit]:
    """Missed impacts by the rejected events that were they, with the name of another contact.

    ``width`` is the largest error of a stamp, s.
    """
    pairs = dict[Hit, Hit]()
    impacts = {
        (key.stamp, i)
        for key in (recording.episode.keys if recording.mislabelled else ())
        for i, kind in key.switches
        if kind is Kind.IMPACT
    }
    free = impacts & recording.rejected
    for (stamp, contacts), t in zip(recording.hits(), solution.t.tolist(), strict=True):
        at = recording.episode.epoch + from_seconds(t)
        for i in contacts:
            near = {hit for hit in free if hit[1] != i and abs(hit[0] - at) * 1e-9 <= width}
            if (stamp, i) in recording.inserted and near:
                event = min(near, key=lambda hit: abs(hit[0] - at))
                pairs[event] = stamp, i
                free.discard(event)
    return pairs


def _moved(
    recording: Recording, problem: Problem, solution: Solution, worst: int, width: float
) -> Recording:
    """The recording without the impact that fits worst, and with the one in its place if any.

    ``worst`` is its index among the moments that count, ``width`` the largest error of a stamp, s.
    """
    k = solution.counted[worst]
    stamp, contacts = recording.hits()[k]
    at = recording.episode.epoch + from_seconds(float(solution.t[k]))
    rejected = {*recording.rejected, *((stamp, i) for i in contacts)} - recording.inserted
    inserted = set(recording.inserted)
    reach = max(width, _NEARER * abs(float(solution.shifts[worst]))) + _ROUNDED
    near = {hit for hit in recording.rejected if abs(hit[0] - at) * 1e-9 <= reach}
    near = {hit for hit in near if hit[1] in contacts}
    hits = bool(np.all(solution.shot.speeds[solution.shot.moment == k] < 0))
    if near:
        rejected -= near
    elif hits and abs(solution.shifts[worst]) <= _NEAR * problem.interval:
        inserted |= {(at, i) for i in contacts}
    return recording.with_outliers(rejected, inserted)


def penetrations(
    recording: Recording, problem: Problem, solution: Solution, deviation: float
) -> set[Hit]:
    """The hits at which a fitted motion goes deeper through a stop than the stamps explain."""
    system = problem.family.system_at(solution.y[2 * problem.family.system.n :])
    moving = MovingSystem(system)
    ends = np.append(solution.t, np.nan)
    hits = set()
    for k, moment in enumerate(problem.moments[:-1]):
        length = float(ends[k + 1] - ends[k])
        if length <= 0:
            continue
        motion = moving.motion(float(ends[k]), solution.shot.states[k], moment.held)
        count = int(min(_SAMPLES * (length * _rate(system) / 6 + 1), _MOST))
        s = np.linspace(0.0, length, count + 1)
        gaps = motion.states(s)[:, : system.n] @ system.W + system.q_r
        speeds = np.maximum(
            np.max(np.abs(motion.states(s)[:, system.n :] @ system.W), axis=0), 1e-30
        )
        reach = np.max(np.abs(gaps), axis=0)
        deep = -np.min(gaps, axis=0)
        for i in np.flatnonzero(deep > _GATE * deviation * speeds + _PRECISION * reach):
            if i in moment.held:
                continue
            at = _closing(s, gaps[:, i], float(deep[i]))
            hits.add((recording.episode.epoch + from_seconds(float(ends[k]) + at), int(i)))
            break
    return hits


def _closing(s: Vector, gap: Vector, depth: float) -> float:
    """When a sampled gap is zero before its first penetration of half the ``depth``, s."""
    deep = int(np.argmax(gap <= -depth / 2))
    above = np.flatnonzero(gap[:deep] > 0)
    left = int(above[-1]) if above.size else 0
    if gap[left] <= 0:
        return float(s[max(deep - 1, 0)])
    return float(np.interp(0.0, gap[[left + 1, left]], s[[left + 1, left]]))


def _rate(system: System) -> float:
    """The fastest undamped frequency or that of the forcing, rad/s."""
    own = float(np.sqrt(linalg.norm(linalg.solve(system.M, system.K), 2)))
    return max(own, float(np.max(system.forcing.frequency, initial=0.0)), 1e-3)
