# SPDX-License-Identifier: Apache-2.0
"""The phase of a rotating drive, from one index pulse a revolution.

The phase is zero at each pulse and grows evenly between two pulses. After the last pulse the phase
grows at the rate of the last period, and before the second pulse at the nominal frequency. A pulse
that comes too soon after the pulse before is not used. A period that is too long is not used
either: the rate of the last good period holds until the next pulse, where the phase is zero again.
"""

from bisect import bisect_left, bisect_right

import numpy as np
from numpy.typing import NDArray

from impact_observer.states import Matrix

OFF = 0.3
"""Largest difference of a period from the nominal period, relative to the nominal period."""
_NS = 1e-9
_TURN = 2 * np.pi


class Drive:
    """The phase of a drive, a function of the pulses alone and not of their order of arrival.

    Attributes:
        nominal: angular frequency, rad/s.
        pulses: stamps of all received pulses, ns, ascending.
        odd: number of periods that were too short or too long.
    """

    def __init__(self, nominal: float) -> None:
        """Begin without any pulse; ``nominal`` is in rad/s."""
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
        """Stamp of the latest used pulse, ns; 0 before the first pulse.

        The phase before this stamp no longer changes if pulses arrive in order.
        """
        return self._used[-1] if self._used else 0

    def add_pulse(self, stamp: int) -> tuple[int | None, str]:
        """Take the pulse at ``stamp``, ns.

        Returns:
            The stamp from which on the phase has changed, ns: 0 if the whole phase has changed,
            None if the pulse was known. Then a sentence on a period that is not used because of
            this pulse; empty if all periods are used.
        """
        index = bisect_left(self.pulses, stamp)
        if index < len(self.pulses) and self.pulses[index] == stamp:
            return None, ""
        self.pulses.insert(index, stamp)
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

    def jets(self, stamps: NDArray[np.int64], epoch: int) -> Matrix:
        """Phase (rad) and rate (rad/s) at stamps, shape (2, samples).

        Args:
            stamps: ns, ascending, shape (samples,). At a jump the values after the jump count.
            epoch: ns; without any pulse the phase is zero at the epoch.
        """
        if not self._used:
            phase = self.nominal * ((stamps - epoch) * _NS)
            return np.stack([phase, np.full(stamps.size, self.nominal)])
        used, rates = np.array(self._used), np.array(self._rates)
        k = np.searchsorted(used, stamps, side="right") - 1
        rate = np.where(k < 0, self.nominal, rates[np.maximum(k, 0)])
        return np.stack([rate * ((stamps - used[np.maximum(k, 0)]) * _NS), rate])

    def forget_before(self, stamp: int) -> None:
        """Forget the pulses that are not needed from ``stamp`` (ns) on."""
        old = max(bisect_right(self._used, stamp) - 1, 0)
        if old:
            self._before = self._rates[old - 1]
            del self._used[:old], self._rates[:old]
            del self.pulses[: bisect_left(self.pulses, self._used[0])]


def _problem(period: float, whole: float) -> str:
    """The sentence on a ``period`` that differs too much from the nominal ``whole``, both in s."""
    return (
        f"a period of {period:.4g} s found; expected {whole:.4g} s within {OFF:.0%}: it is not"
        " used"
    )
