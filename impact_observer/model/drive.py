# SPDX-License-Identifier: Apache-2.0
"""A drive that turns, known by its index pulses: one a revolution, where its phase is zero.

The phase grows evenly between two pulses, after the last one with the last period, and with the
nominal frequency before there are two. A pulse that comes too soon after the one before is left
out. A period that is too long is not used: the last good one goes on until its end, where the
phase starts again at zero.
"""

from bisect import bisect_left, bisect_right

import numpy as np
from numpy.typing import NDArray

from impact_observer.states import Matrix

OFF = 0.3
"""By how much a period may differ from the nominal one, relative to that."""
_NS = 1e-9
_TURN = 2 * np.pi


class Drive:
    """The phase of a drive, a function of its pulses whatever the order of their arrival.

    Attributes:
        nominal: angular frequency, rad/s.
        pulses: stamps of all that have come, ns, ascending.
        odd: how many periods were found that are not used.
    """

    def __init__(self, nominal: float) -> None:
        """Begin without any pulse."""
        self.nominal = nominal
        self.odd = 0
        self.clear()

    def clear(self) -> None:
        """Forget all pulses."""
        self.pulses: list[int] = []
        self._used: list[int] = []
        self._rates: list[float] = []  # from each used pulse on
        self._before = self.nominal

    @property
    def newest(self) -> int:
        """The latest pulse that is used, ns: what was before it is final; 0 before the first."""
        return self._used[-1] if self._used else 0

    def add(self, stamp: int) -> tuple[int | None, str]:
        """Take a pulse at ``stamp`` (ns).

        Returns:
            From which stamp on the phase has changed, ns, 0 for all of it and None for nothing;
            and in words what was wrong with the periods from the pulse before on.
        """
        at = bisect_left(self.pulses, stamp)
        if at < len(self.pulses) and self.pulses[at] == stamp:
            return None, ""
        self.pulses.insert(at, stamp)
        k = bisect_left(self._used, stamp) - 1
        begin, changed = (self._used[k], self._used[k]) if k >= 0 else (stamp, 0)
        rate = self._rates[k - 1] if k > 0 else self._before
        del self._used[k + 1 :], self._rates[max(k, 0) :]
        if k < 0:
            self._used.append(begin)
        problem, whole = "", _TURN / self.nominal
        for pulse in self.pulses[bisect_right(self.pulses, begin) :]:
            period = (pulse - self._used[-1]) * _NS
            if abs(period - whole) <= OFF * whole:
                rate = _TURN / period
            else:
                if stamp in (pulse, self._used[-1]):
                    problem = problem or _problem(period, whole)
                if period < whole:
                    continue
            self._rates.append(rate)
            self._used.append(pulse)
        self._rates.append(rate)
        self.odd += bool(problem)
        return changed, problem

    def jets(self, at: NDArray[np.int64], epoch: int) -> Matrix:
        """Phase (rad) and rate (rad/s) at stamps (ns, ascending), from there on: (2, samples).

        Without any pulse the phase is zero at the ``epoch``, ns.
        """
        if not self._used:
            return np.stack([self.nominal * ((at - epoch) * _NS), np.full(at.size, self.nominal)])
        used, rates = np.array(self._used), np.array(self._rates)
        k = np.searchsorted(used, at, side="right") - 1
        rate = np.where(k < 0, self.nominal, rates[np.maximum(k, 0)])
        return np.stack([rate * ((at - used[np.maximum(k, 0)]) * _NS), rate])

    def forget_before(self, stamp: int) -> None:
        """Forget the pulses that are not needed from ``stamp`` (ns) on."""
        old = max(bisect_right(self._used, stamp) - 1, 0)
        if old:
            self._before = self._rates[old - 1]
            del self._used[:old], self._rates[:old]
            del self.pulses[: bisect_left(self.pulses, self._used[0])]


def _problem(period: float, whole: float) -> str:
    """What is wrong with a ``period`` where one of ``whole`` is nominal, s."""
    return (
        f"a period of {period:.4g} s found; expected {whole:.4g} s within {OFF:.0%}: it is not"
        " used"
    )
