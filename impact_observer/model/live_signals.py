# SPDX-License-Identifier: Apache-2.0
"""Forces that are known by samples that arrive live, in any order.

A force is constant from each sample to the next, and zero before the first sample. All signals are
functions of the samples alone, not of the order or time of their arrival.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import UsageError
from impact_observer.model.document import LARGEST
from impact_observer.model.force_samples import JETS
from impact_observer.model.forcing import Forcing
from impact_observer.model.live_samples import NEVER, LiveSamples
from impact_observer.model.system import System
from impact_observer.states import Vector

_NS = 1e-9
_FEW = 8
"""Stamps up to which values are looked up one by one."""
_OFTEN = 1000
"""Number of samples that are forgotten together."""


@dataclass(slots=True)
class _Signal:
    """The samples of one input, by stamp."""

    name: str
    stamps: list[int]
    values: list[float]

    def held(self, at: NDArray[np.int64]) -> Sequence[float] | Vector:
        """The values of a force just after stamps ``at`` (ns, ascending), shape (samples,)."""
        if at.size > _FEW and self.stamps:
            first = max(bisect_right(self.stamps, int(at[0])) - 1, 0)
            last = bisect_right(self.stamps, int(at[-1])) + 1
            values = np.array(self.values[first:last])
            k = np.searchsorted(np.array(self.stamps[first:last]), at, side="right") - 1
            return np.where(k < 0, 0.0, values[k])
        before = (bisect_right(self.stamps, stamp) for stamp in at.tolist())
        return [self.values[k - 1] if k else 0.0 for k in before]


class _Received(NamedTuple):
    """A received sample of the signal with the index ``signal``."""

    signal: int
    stamp: int
    value: float


class LiveSignals:
    """The live inputs of one user of a system.

    Attributes:
        inputs: names of the live forces.
        samples: the forces by all live signals, and the known samples of forces.
        late: number of samples that came too late to be used.
    """

    def __init__(self, system: System, *, causal: bool) -> None:
        """Begin without any sample.

        Args:
            system: the system with live signals.
            causal: whether a sample is refused that lies before the newest sample of the same
                signal. The past is final then.
        """
        live = system.live
        assert live is not None, "the system has live signals"
        self.inputs = live.inputs
        self._signals = [_Signal(name, [], []) for name in live.inputs]
        self._index = {each.name: k for k, each in enumerate(self._signals)}
        drives = np.any(live.directions != 0, axis=1)
        self._held = live.directions.T
        self._base = system.forcing.sampled
        self._causal = causal
        self.samples = LiveSamples(self._base, drives, -np.inf if causal else np.inf)
        self._newest = [0] * len(self._signals)
        self.late = 0
        self._pending: list[_Received] = []
        self._epoch: int | None = None
        self._knots: list[int] = []
        self._least = NEVER

    @property
    def names(self) -> tuple[str, ...]:
        """Names of inputs, in the order of ``newest``."""
        return tuple(each.name for each in self._signals)

    @property
    def newest(self) -> list[int]:
        """Stamp of the latest used sample of each signal in ``names``, ns; 0 before the first."""
        return [*self._newest]

    @property
    def known_until(self) -> int:
        """The stamp up to which all signals are known, ns; 0 until each signal has a sample."""
        return min(self.newest)

    def keep_waiting(self, most: int) -> None:
        """Forget the oldest samples if more than ``most`` samples wait for ``follow``."""
        if len(self._pending) > most:
            del self._pending[: -most // 2]

    def add_force(self, name: str, stamp: int, value: float) -> str:
        """Take a sample of the live force ``name`` at ``stamp``, ns; the ``value`` is in N.

        Returns:
            A sentence why the sample is not used; empty for a used sample.
        """
        k = self._index.get(name)
        if k is None:
            known = ", ".join(self.inputs) or "none"
            return f"{name!r} is not known; expected some of {known}"
        if not (isfinite(value) and abs(value) <= LARGEST):
            return f"{name!r}: {value:g} found; expected a finite number"
        if self._causal and stamp <= self._newest[k]:
            self.late += 1
            return f"{name!r}: its stamp is not after that of the sample before"
        self._newest[k] = max(self._newest[k], stamp)
        self._pending.append(_Received(k, stamp, value))
        return ""

    def clear(self) -> None:
        """Forget all samples."""
        for each in self._signals:
            each.stamps, each.values = [], []
        self._newest = [0] * len(self._signals)
        self._pending.clear()
        self._epoch, self._least = None, NEVER

    def follow(self, epoch: int) -> int | None:
        """Use the received samples.

        Args:
            epoch: stamp of ``t = 0``, ns.

        Returns:
            The stamp from which on the forces have changed, ns; None without a change.
        """
        changed = None if epoch == self._epoch else NEVER
        pending, self._pending = self._pending, []
        for each in pending:
            altered = self._inserted(each)
            if altered is not None:
                changed = altered if changed is None else min(changed, altered)
        if changed is not None:
            self._rebuild(epoch, changed, [each.stamp for each in pending])
        return changed

    def _inserted(self, sample: _Received) -> int | None:
        """Insert a sample; return the first stamp of a change, None if the sample is unused."""
        signal = self._signals[sample.signal]
        index = bisect_left(signal.stamps, sample.stamp)
        if sample.stamp <= self._least:
            self.late += 1
            return None
        if index < len(signal.stamps) and signal.stamps[index] == sample.stamp:
            return None  # the first sample of a stamp counts
        signal.stamps.insert(index, sample.stamp)
        signal.values.insert(index, sample.value)
        return sample.stamp

    def _rebuild(self, epoch: int, changed: int, stamps: Sequence[int]) -> None:
        """Compute the samples of forces from ``changed`` (ns) on."""
        if epoch != self._epoch:
            self._epoch, self._knots, start = epoch, self._all_knots(epoch), 0
        else:  # the last knot before the change
            start = max(bisect_right(self._knots, changed) - 1, 0)
            tail = sorted({*self._knots[start:], *(s for s in stamps if s > self._knots[0])})
            self._knots[start:] = tail
        at, first = np.array(self._knots[start:], dtype=np.int64), self.samples.dropped + start
        time: Vector = np.asarray((at - epoch) * _NS)
        self.samples.change(first, time, self._forces(at, epoch), self._final())

    def _all_knots(self, epoch: int) -> list[int]:
        """Stamps of all samples and the epoch, ns, ascending."""
        own, first = {stamp for each in self._signals for stamp in each.stamps}, NEVER
        if self._base is not None:
            first, *others = [epoch + round(t / _NS) for t in self._base.time.tolist()]
            own |= set(others)
        return [first, *sorted(stamp for stamp in own if stamp > first)]

    def _final(self) -> float:
        """The instant before which samples are final, s since the epoch."""
        assert self._epoch is not None, "followed"
        return (self.known_until - self._epoch) * _NS if self._causal else np.inf

    def _forces(self, at: NDArray[np.int64], epoch: int) -> NDArray[np.float64]:
        """Forces on the coordinates and their derivatives at stamps (ns), (4, samples, n)."""
        total = np.zeros((JETS, at.size, self.samples.drives.size))
        if self._base is not None:
            total += self._base.derivatives(np.asarray((at - epoch) * _NS), slack=_NS)
        total[0] += np.array([each.held(at) for each in self._signals]).T @ self._held
        return total

    def forget_before(self, stamp: int) -> None:
        """Forget samples that are not needed from ``stamp`` (ns) on, many at a time."""
        old = bisect_right(self._knots, stamp) - 1
        if old < _OFTEN:
            return
        self._least = self._knots[old]
        self.samples.forget(self.samples.dropped + old)
        del self._knots[:old]
        for each in self._signals:
            gone = max(bisect_right(each.stamps, self._least) - 1, 0)
            del each.stamps[:gone], each.values[:gone]


def connected(system: System, *, causal: bool = False) -> tuple[System, LiveSignals | None]:
    """The ``system`` connected to new live signals; None if the system has none."""
    if system.live is None:
        return system, None
    signals = LiveSignals(system, causal=causal)
    forcing: Forcing = replace(system.forcing, sampled=signals.samples)
    return replace(system, forcing=forcing), signals


def refused(system: System, what: str) -> None:
    """Raise UsageError where a ``system`` has live forces, which ``what`` cannot use."""
    if system.live is not None:
        raise UsageError(
            f"{system.name}: known only live: {', '.join(system.live.inputs)}, which {what} cannot"
            " use; expected forces that are harmonic or sampled"
        )
