"""Roots of watched functions, to the last digit."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from impact_observer.dynamics.guards.bounds import FACTORIALS
from impact_observer.dynamics.guards.traces import Trace
from impact_observer.states import Matrix, Vector

ROOT = 4 * np.finfo(np.float64).eps
"""Relative accuracy of a root: brentq's finest."""
_ROUNDED = 1e-14
"""Value that one more step of Newton's method ends at, relative to a function's scale."""
_NEWTON = 8
"""Steps of Newton's method before brentq's."""
_LEAST = 1e-30
"""Absolute accuracy of a root, s: none, but brentq wants one."""
_STEPS = 1000
"""Steps of brentq's method; what is all but zero at the start takes more than its usual 100."""


class Suspect(NamedTuple):
    """An interval that may hold a crossing.

    Attributes:
        start: its left end, s.
        stop: its right end, s.
        which: indices of the functions that may cross.
        values: of all functions at both ends, shape (2, w).
        falling: whether each falls all the way, shape (w,).
        derivatives: of each at the left end, shape (8, w).
        scale: what each is rounded against, shape (w,).
    """

    start: float
    stop: float
    which: NDArray[np.intp]
    values: Matrix
    falling: NDArray[np.bool_]
    derivatives: Matrix
    scale: Vector


def root(trace: Trace, suspect: Suspect, which: int) -> float:
    """The single root of one function that falls all the way along an interval."""
    start, stop, value = suspect.start, suspect.stop, _of(trace, which)
    # Newton's method from the root of the Taylor polynomial: two or three values, not twenty.
    taylor = (suspect.derivatives[:, which] / FACTORIALS[:-1]).tolist()
    slope = [k * coefficient for k, coefficient in enumerate(taylor)][1:]
    s, last = start, stop - start
    if taylor[0] > 0 > _polynomial(last, taylor):
        s += _between(lambda s: _polynomial(s, taylor), 0.0, last)
    for _ in range(_NEWTON):
        left = value(s)
        step = -left / _polynomial(s - start, slope)
        rounded = abs(left) <= _ROUNDED * suspect.scale[which]
        if not (start <= s + step <= stop and (rounded or abs(step) <= last / 4)):
            break
        s += step
        if abs(step) <= ROOT * s or rounded:
            return s
        last = abs(step)
    # The ends are evaluated alone here: rounding may differ from before.
    above = value(start) > 0
    if above and value(stop) < 0:
        return _between(value, start, stop)
    return traced(trace, stop if above else start, which)


def traced(trace: Trace, s: float, which: int) -> float:
    """The last root of one function before ``s``; ``s`` itself where it is not below zero.

    Samples that are below zero by less than ``DEPTH`` raise no suspicion: the root of what falls
    on afterwards lies before them.
    """
    value, step, below = _of(trace, which), ROOT * s, s
    while value(s) < 0:
        if s == 0.0:
            return s
        below, s, step = s, max(s - step, 0.0), 4 * step
    if s == below:
        return s
    return _between(value, s, below)


def _of(trace: Trace, which: int) -> Callable[[float], float]:
    """One function by itself."""
    return lambda s: float(trace.values(np.array([s]))[0, which])


def _between(value: Callable[[float], float], low: float, high: float) -> float:
    """The root between two points at which ``value`` has different signs."""
    found = optimize.brentq(value, low, high, xtol=_LEAST, rtol=ROOT, maxiter=_STEPS)
    return float(found)


def _polynomial(s: float, coefficients: list[float]) -> float:
    """Its value at ``s``, coefficients of low powers first."""
    value = 0.0
    for coefficient in reversed(coefficients):
        value = value * s + coefficient
    return value
