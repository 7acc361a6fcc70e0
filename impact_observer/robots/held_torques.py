# SPDX-License-Identifier: Apache-2.0
"""The error of torques that are held from sample to sample, as white torques."""

import numpy as np
from numpy.typing import NDArray

from impact_observer.model.live_signals import NEVER, LiveSamples
from impact_observer.states import Matrix, Vector, frozen

_WINDOW = 512
"""Samples from which a deviation is computed: half a second at 1 kHz."""
_OFTEN = 32
"""Samples after which a deviation is computed anew."""
_KEPT = 4096
"""Deviations that are kept."""
_SAME_INSTANT = 1e-9
"""Time between two instants that count as one, s: that of a stamp."""


class HeldTorques:
    """White torques for the error of efforts that count as constant from sample to sample.

    Between samples ``f_k`` and ``f_{k+1}`` a torque may go along a line, and the mean error of the
    step is then half of the change. So held torques are late by half a period ``h``, and their
    impulse errs by ``h/2 (f_{k+m} - f_k)`` in m periods. White torques of deviation ``b`` make
    impulses of ``b sqrt(m h)``. The two are alike for ``b^2 = h/(4 m) mean((f_{k+m} - f_k)^2)``,
    and the largest of m = 1, 2, 4, .. is taken. Torques at random from sample to sample have it at
    m = 1, and torques that swing as ``A sin(w t)`` at m h = 2.3/w, where b = 0.43 A h sqrt(w).

    Deviations depend on samples up to the instant alone, so that a live run and its recording
    have the same.
    """

    def __init__(self, samples: LiveSamples) -> None:
        """Of efforts that arrive as these ``samples``."""
        self._samples = samples
        self._known: dict[int, Vector] = {}
        self._changes = samples.changes

    def deviation(self, t: float) -> Vector:
        """Of the white torques at ``t``, s since the epoch, shape (n,), N m sqrt(s)."""
        samples = self._samples
        if self._changes != samples.changes:
            self._forget()
        row = int(samples.time.searchsorted(t + _SAME_INSTANT, side="right")) - 1
        number = row + samples.dropped
        back = number % _OFTEN if number >= _OFTEN else 0
        found = self._known.get(number - back)
        if found is None:
            if len(self._known) == _KEPT:
                self._known.clear()
            last = max(row - back, 0) + 1
            first = max(last - _WINDOW, int(samples.time[0] <= NEVER / 1e9))
            found = _deviation(samples.time[first:last], samples.force[first:last])
            self._known[number - back] = frozen(found)
        return found

    def _forget(self) -> None:
        """Forget the deviations of samples that have changed."""
        since = self._samples.changed_since(self._changes)
        first = int(self._samples.time.searchsorted(since)) + self._samples.dropped
        self._known = {k: each for k, each in self._known.items() if k < first}
        self._changes = self._samples.changes


def _deviation(time: Vector, force: Matrix) -> NDArray[np.float64]:
    """The deviation of white torques by samples, shape (n,)."""
    largest = np.zeros(force.shape[1])
    if len(time) > 1:
        period, apart = (time[-1] - time[0]) / (len(time) - 1), 1
        while apart < len(time):
            changes = force[apart:] - force[:-apart]
            square = np.einsum("ki,ki->i", changes, changes) / len(changes)
            largest = np.maximum(largest, period / (4 * apart) * square)
            apart *= 2
    return np.sqrt(largest)
