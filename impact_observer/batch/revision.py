# SPDX-License-Identifier: Apache-2.0
"""The account of a recording, revised by the motion that explains the account best.

A stamp that the motion does not explain is spurious; where the motion passes through a stop an
impact was missed; an inserted impact that the motion does not reach was none.
"""

from collections.abc import Iterator

import numpy as np

from impact_observer.batch.moments import Moment, Moments, MomentSwitching
from impact_observer.batch.motion_fit import MotionFit

SPURIOUS = 6.0
"""Deviations of a stamp from the motion beyond which the event is spurious."""
_STEPS = 12
"""Instants in a turn of the fastest rate at which gaps are looked at."""
_DEEP = 4.0
"""Deviations of a gap beyond which a negative gap is a missed impact."""
_MOST = 0.1
"""Part of all events that one revision changes."""


def revised(fit: MotionFit) -> Moments | None:
    """The moments as the motion of ``fit`` has them; None if they are the same."""
    moments = fit.problem.moments
    spurious = set(_spurious(fit))
    unreached = {
        k
        for k, each in enumerate(moments.each)
        if not each.is_measured and not fit.motion.is_regular[k]
    }
    missed = list(_missed(fit))
    if not spurious and not unreached and not missed:
        return None
    kept = [
        each for k, each in enumerate(moments.each) if k not in spurious and k not in unreached
    ]
    every = sorted([*kept, *missed], key=lambda each: float(each.t))
    return Moments(moments.start, every)


def _spurious(fit: MotionFit) -> Iterator[int]:
    """Moments whose stamps are farthest from the motion, a few at once."""
    moments = fit.problem.moments
    z = np.abs(fit.standardized)
    order = np.argsort(-z)[: max(int(_MOST * z.size), 1)]
    largest = float(z[order[0]]) if z.size else 0.0
    for r in order.tolist():
        k = int(moments.row_moment[r])
        if z[r] > max(SPURIOUS, largest / 4) and not moments.each[k].switching.held:
            yield k


def _missed(fit: MotionFit) -> Iterator[Moment]:
    """Yield impacts where the motion passes through a stop, at most one in a flight."""
    moments, tangent, n = fit.problem.moments, fit.tangent, fit.tangent.n
    gaps, W = tangent.gaps(tuple(range(tangent.system.m))), tangent.system.W
    clock, (before, after) = 4 * fit.sizes.clock, fit.states
    spread = np.linalg.norm(np.einsum("im,kij->kmj", W, fit.back.nodes.root[0::2, :n]), axis=2)
    spread = np.maximum(spread[:-1], spread[1:])
    for k, (t, s) in enumerate(zip(moments.starts, moments.flights.tolist(), strict=True)):
        if not k or s <= 2 * clock:  # before the first event a rig may have been held
            continue
        held = moments.each[k - 1].switching.held
        phase = tangent.phase(held)
        turns = s * phase.flow.exponential.rate / (2 * np.pi)
        at = np.linspace(0.0, s, int(np.clip(np.ceil(_STEPS * turns), 8, 4096)) + 1)
        states = phase.start(t, after[k]).states(at)
        # what process noise has moved the end of the flight by is spread over the flight
        states = states + (at / s)[:, None] * (before[k + 1] - states[-1])
        value, speed = gaps.of(states), np.abs(states[:, n:] @ W)
        inside = ((at > clock) & (at < s - clock))[:, None] & np.ones(value.shape, dtype=bool)
        inside[:, list(held)] = False
        limit = _DEEP * spread[k] + clock * speed.max(axis=0)
        deep = np.where(inside, value, 0.0).min(axis=0) < -limit
        through = inside & (value < 0) & deep
        if through.any():
            first = int(np.argmax(through.any(axis=1)))
            contact = int(np.argmax(through[first]))
            when = t + float(at[first])
            stamp = moments.each[k].stamp - round((s - float(at[first])) * 1e9)
            switching = MomentSwitching((contact,), (contact,), held, held)
            yield Moment(when, switching, is_measured=False, stamp=stamp)
