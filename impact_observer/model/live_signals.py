# SPDX-License-Identifier: Apache-2.0
"""Forces and grounds that are known by samples that arrive live, in any order.

A force is constant from each sample to the next. A ground moves by cubic Hermite polynomials from
sample to sample. Before the first sample the ground rests at the position of the first sample, and
after the last sample the ground keeps the last speed.
All signals are functions of the samples alone, not of the order or time of their arrival.
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
from impact_observer.model.force_samples import JETS, shifted
from impact_observer.model.forcing import Forcing
from impact_observer.model.live_samples import NEVER, LiveSamples
from impact_observer.model.system import System
from impact_observer.states import Matrix, Vector

_NS = 1e-9
_FEW = 8
"""Stamps up to which values are looked up one by one."""
_OFTEN = 1000
"""Number of samples that are forgotten together."""


@dataclass(slots=True)
class _Signal:
    """The samples of one input or ground, by stamp."""

    name: str
    moves: bool
    stamps: list[int]
    values: list[float]
    rates: list[float]

    def jets(self, at: NDArray[np.int64]) -> NDArray[np.float64]:
        """Value and three derivatives just after stamps (ns, ascending), shape (4, samples)."""
        jets = np.zeros((JETS, at.size))
        if not self.stamps or not at.size:
            return jets
        first = max(bisect_right(self.stamps, int(at[0])) - 1, 0)
        last = bisect_right(self.stamps, int(at[-1])) + 1
        stamps = np.array(self.stamps[first:last])
        value, rate = (np.array(x[first:last]) for x in (self.values, self.rates))
        k = np.searchsorted(stamps, at, side="right") - 1
        before = k < 0
        if not self.moves:
            jets[0] = np.where(before, 0.0, value[k])
            return jets
        k = np.maximum(k, 0)
        starts = np.stack([value, rate, 0 * value, 0 * value])
        if value.size > 1:
            h = np.diff(stamps) * _NS
            chord = np.diff(value) / h
            starts[2, :-1] = (6 * chord - 4 * rate[:-1] - 2 * rate[1:]) / h
            starts[3, :-1] = (6 * rate[:-1] + 6 * rate[1:] - 12 * chord) / h**2
        jets = shifted(starts[:, k, None], (at - stamps[k]) * _NS)[..., 0]
        jets[:, before] = 0.0
        jets[0, before] = value[0]
        return np.asarray(jets)

    def held(self, at: NDArray[np.int64]) -> Sequence[float] | Vector:
        """The values of a force just after stamps ``at`` (ns, ascending), shape (samples,)."""
        if at.size > _FEW:
            return np.asarray(self.jets(at)[0])
        before = (bisect_right(self.stamps, stamp) for stamp in at.tolist())
        return [self.values[k - 1] if k else 0.0 for k in before]


class _Received(NamedTuple):
    """A received sample of the signal with the index ``signal``."""

    signal: int
    stamp: int
    value: float
    rate: float


class LiveSignals:
    """The live inputs and grounds of one user of a system.

    Attributes:
        inputs: names of the live forces.
        grounds: names of the live grounds.
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
        self.inputs, self.grounds = live.inputs, live.grounds
        self._signals = [
            *(_Signal(name, False, [], [], []) for name in live.inputs),
            *(_Signal(name, True, [], [], []) for name in live.grounds),
        ]
        self._index = {(each.name, each.moves): k for k, each in enumerate(self._signals)}
        responses = _responses(system)
        drives = np.any(responses != 0, axis=(0, 1))
        self._held = responses[: len(self.inputs), 0]
        self._responses = [
            [(order, each[order]) for order in np.flatnonzero(each.any(axis=1)).tolist()]
            for each in responses
        ]
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
        """Names of inputs, then of grounds, in the order of ``newest``."""
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
        return self._add((name, False), stamp, value, 0.0)

    def add_motion(self, name: str, stamp: int, position: float, velocity: float) -> str:
        """Take a sample of a ground, in m and m/s; stamp and return value as ``add_force``."""
        return self._add((name, True), stamp, position, velocity)

    def _add(self, key: tuple[str, bool], stamp: int, value: float, rate: float) -> str:
        k = self._index.get(key)
        if k is None:
            known = ", ".join(self.grounds if key[1] else self.inputs) or "none"
            return f"{key[0]!r} is not known; expected some of {known}"
        if not (isfinite(value) and isfinite(rate) and max(abs(value), abs(rate)) <= LARGEST):
            return f"{key[0]!r}: {value:g} and {rate:g} found; expected finite numbers"
        if self._causal and stamp <= self._newest[k]:
            self.late += 1
            return f"{key[0]!r}: its stamp is not after that of the sample before"
        self._newest[k] = max(self._newest[k], stamp)
        self._pending.append(_Received(k, stamp, value, rate))
        return ""

    def clear(self) -> None:
        """Forget all samples."""
        for each in self._signals:
            each.stamps, each.values, each.rates = [], [], []
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
        signal.rates.insert(index, sample.rate)
        if not signal.moves:
            return sample.stamp
        return signal.stamps[index - 1] if index else NEVER

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
        if forces := self._signals[: len(self.inputs)]:
            total[0] += np.array([each.held(at) for each in forces]).T @ self._held
        for k, signal in enumerate(self._signals[len(self.inputs) :], len(self.inputs)):
            jets = signal.jets(at)[..., None]
            for order, response in self._responses[k]:
                total[: JETS - order] += jets[order:] * response
        return total

    def displacements(self, ns: NDArray[np.int64]) -> tuple[Matrix, Matrix]:
        """Displacements and speeds of the live grounds, shape (samples, grounds) each.

        ``ns`` are nanoseconds since the epoch, shape (samples,).
        """
        assert self._epoch is not None, "followed"
        order = np.argsort(ns, kind="stable")
        motion = np.zeros((2, ns.size, len(self.grounds)))
        for k, signal in enumerate(self._signals[len(self.inputs) :]):
            motion[:, order, k] = signal.jets(ns[order] + self._epoch)[:2]
        return motion[0], motion[1]

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
            del each.stamps[:gone], each.values[:gone], each.rates[:gone]


def _responses(system: System) -> NDArray[np.float64]:
    """Forces by the value, first and second derivative of each signal, (signals, 3, n)."""
    live, frame = system.live, system.frame
    assert live is not None, "the system has live signals"
    responses = np.zeros((len(live.inputs) + len(live.grounds), 3, system.n))
    responses[: len(live.inputs), 0] = live.directions.T
    for k, name in enumerate(live.grounds, len(live.inputs)):
        assert frame is not None, "a live ground is one of the frame's"
        i, E = frame.grounds.names.index(name), frame.shift
        responses[k, 0] = (frame.grounds.stiffness - system.K @ E)[:, i]
        responses[k, 1] = (frame.grounds.damping - system.C @ E)[:, i]
        responses[k, 2] = -(system.M @ E)[:, i]
    return responses


def connected(system: System, *, causal: bool = False) -> tuple[System, LiveSignals | None]:
    """The ``system`` connected to new live signals; None if the system has none."""
    if system.live is None:
        return system, None
    signals = LiveSignals(system, causal=causal)
    frame = None if system.frame is None else replace(system.frame, live=signals)
    forcing: Forcing = replace(system.forcing, sampled=signals.samples)
    return replace(system, forcing=forcing, frame=frame), signals


def refused(system: System, what: str) -> None:
    """Raise UsageError where a ``system`` has live forces or grounds; ``what`` cannot use them."""
    if system.live is not None and (names := (*system.live.inputs, *system.live.grounds)):
        raise UsageError(
            f"{system.name}: known only live: {', '.join(names)}, which {what} cannot use;"
            " expected forces and grounds that are harmonic or sampled"
        )
