# SPDX-License-Identifier: Apache-2.0
"""Forces that are known by samples that arrive live, in any order.

A force is constant from each sample to the next, and zero before the first sample. All signals are
functions of the samples alone, not of the order or time of their arrival.
"""

from bisect import bisect_left, bisect_right
from collections import deque
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import UsageError
from impact_observer.model.document import LARGEST
from impact_observer.model.force_samples import JETS, Samples
from impact_observer.model.system import System
from impact_observer.states import Vector

NEVER = -(1 << 62)
"""A stamp before all samples, ns."""
_NS = 1e-9
_ROUNDING = 2.5e-10
"""Largest difference of two instants that counts as zero, s: a quarter of a stamp."""
_REMEMBERED = 1024
"""Changes that motions can follow; a motion that has seen fewer computes all windows anew."""
_OFTEN = 1000
"""Number of samples that are forgotten together."""
_Rows: TypeAlias = NDArray[np.float64]


class _Tail:
    """An array whose last rows change, with room for more: to append one copies no others.

    Attributes:
        rows: the array; arrays that were its ``rows`` before do not change.
    """

    def __init__(self, rows: _Rows) -> None:
        """Start with some ``rows``."""
        self.rows, self._room = rows, rows[:0]

    def change(self, first: int, rows: _Rows) -> None:
        """Replace the rows from the ``first`` on."""
        last, again = first + len(rows), self.rows[first:]
        is_new = len(again) <= len(rows) and np.array_equal(again, rows[: len(again)])
        if not is_new or last > len(self._room):
            self._room = np.empty((2 * last, *rows.shape[1:]))
            self._room[:first] = self.rows[:first]
        self._room[first:last] = rows
        self.rows = self._room[:last]

    def forget(self, first: int) -> None:
        """Forget the rows before the ``first``."""
        self.rows, self._room = self.rows[first:], self._room[first:]


class LiveSamples(Samples):
    """Samples that change.

    Attributes:
        changes: number of changes up to now.
        dropped: number of forgotten samples.
        newest: samples before this instant are final, s since the epoch.
    """

    changes: int
    dropped: int
    newest: float
    _drives: NDArray[np.bool_]
    _since: deque[float]
    _tails: tuple[_Tail, _Tail]

    def __init__(self, base: Samples | None, drives: NDArray[np.bool_], newest: float) -> None:
        """Begin with the samples of ``base``, or with zero forces.

        Args:
            base: known samples; None without any.
            drives: which coordinates live signals drive, shape (n,).
            newest: as the attribute.
        """
        n = drives.size
        time, jets = np.array([NEVER * _NS, 0.0]), np.zeros((JETS, 2, n))
        if base is not None:
            time, jets = base.time, base.jets
        super().__init__(time, jets[0], "cubic", jets)
        used = drives if base is None else drives | base.drives
        for name, value in {
            "_drives": used,
            "dropped": 0,
            "newest": newest,
            "changes": 0,
            "_since": deque(maxlen=_REMEMBERED),
            "_tails": (_Tail(time), _Tail(jets.swapaxes(0, 1))),
            "rounding": _ROUNDING,
        }.items():
            object.__setattr__(self, name, value)

    @property
    def drives(self) -> NDArray[np.bool_]:
        """Which coordinates may have a force, shape (n,)."""
        return self._drives

    @property
    def end(self) -> float:
        """Infinity: a live signal has no last sample."""
        return np.inf

    def changed_since(self, changes: int) -> float:
        """The first instant of samples that differ since ``changes``, s since the epoch."""
        count = self.changes - changes
        recent = list(self._since)
        return -np.inf if count > len(recent) else min(recent[-count:], default=np.inf)

    def change(self, first: int, time: Vector, jets: NDArray[np.float64], newest: float) -> None:
        """Replace the samples from number ``first`` on; forgotten samples count."""
        for tail, each in zip(self._tails, (time, jets.swapaxes(0, 1)), strict=True):
            tail.change(first - self.dropped, each)
        self._use_tails()
        self._since.append(float(self.time[max(first - self.dropped - 1, 0)]))
        object.__setattr__(self, "changes", self.changes + 1)
        object.__setattr__(self, "newest", newest)

    def forget(self, first: int) -> None:
        """Forget the samples before number ``first``."""
        for tail in self._tails:
            tail.forget(first - self.dropped)
        self._use_tails()
        object.__setattr__(self, "dropped", first)

    def _use_tails(self) -> None:
        """Set what is derived."""
        time, jets = (tail.rows for tail in self._tails)
        jets = jets.swapaxes(0, 1)
        for name, value in {"time": time, "jets": jets, "force": jets[0]}.items():
            object.__setattr__(self, name, value)


class _Signal:
    """The samples of one live force, constant from each to the next.

    Attributes:
        newest: stamp of the latest sample that was received, ns; 0 before the first.
        stamps: of the samples that are used, ns, ascending.
    """

    def __init__(self) -> None:
        """Begin without any sample."""
        self.newest, self.stamps, self._values = 0, list[int](), list[float]()

    def insert(self, stamp: int, value: float) -> bool:
        """Use a sample; return whether it is the first of its ``stamp``."""
        index = bisect_left(self.stamps, stamp)
        if self.stamps[index : index + 1] == [stamp]:
            return False
        self.stamps.insert(index, stamp)
        self._values.insert(index, value)
        return True

    def held(self, at: NDArray[np.int64]) -> Vector:
        """The values just after stamps ``at`` (ns, ascending), shape (samples,)."""
        first = max(bisect_right(self.stamps, int(at[0])) - 1, 0)
        last = bisect_right(self.stamps, int(at[-1]))
        number = np.searchsorted(np.array(self.stamps[first:last], np.int64), at, side="right")
        return np.asarray(np.array([0.0, *self._values[first:last]])[number])

    def forget_before(self, stamp: int) -> None:
        """Forget the samples before the one that holds at ``stamp``, ns."""
        gone = max(bisect_right(self.stamps, stamp) - 1, 0)
        del self.stamps[:gone], self._values[:gone]


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
        self.inputs, self._directions, self._causal = live.inputs, live.directions, causal
        self._base, drives = system.forcing.sampled, np.any(live.directions != 0, axis=1)
        self.samples = LiveSamples(self._base, drives, -np.inf if causal else np.inf)
        self.late = 0
        self.clear()

    def clear(self) -> None:
        """Forget all samples."""
        self._signals = {name: _Signal() for name in self.inputs}
        self._pending: list[tuple[_Signal, int, float]] = []
        self._epoch: int | None = None
        self._knots: list[int] = []
        self._least = NEVER

    @property
    def newest(self) -> list[int]:
        """Stamp of the latest sample of each of the ``inputs``, ns; 0 before the first."""
        return [each.newest for each in self._signals.values()]

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
        if (signal := self._signals.get(name)) is None:
            known = ", ".join(self.inputs) or "none"
            return f"{name!r} is not known; expected some of {known}"
        if not abs(value) <= LARGEST:  # false for NaN, too
            return f"{name!r}: {value:g} found; expected a finite number"
        if self._causal and stamp <= signal.newest:
            self.late += 1
            return f"{name!r}: its stamp is not after that of the sample before"
        signal.newest = max(signal.newest, stamp)
        self._pending.append((signal, stamp, value))
        return ""

    def follow(self, epoch: int) -> int | None:
        """Use the received samples.

        Args:
            epoch: stamp of ``t = 0``, ns.

        Returns:
            The stamp from which on the forces have changed, ns; None without a change.
        """
        pending, self._pending, used = self._pending, [], list[int]()
        for signal, stamp, value in pending:
            if stamp <= self._least:
                self.late += 1
            elif signal.insert(stamp, value):
                used.append(stamp)
        if epoch != self._epoch:
            self._epoch, self._knots, start = epoch, self._all_knots(epoch), 0
            changed = NEVER
        elif used:  # from the last knot before the change on
            changed = min(used)
            start = max(bisect_right(self._knots, changed) - 1, 0)
            later = {stamp for stamp in used if stamp > self._knots[0]}
            self._knots[start:] = sorted(later.union(self._knots[start:]))
        else:
            return None
        at, first = np.array(self._knots[start:], dtype=np.int64), self.samples.dropped + start
        time: Vector = np.asarray((at - epoch) * _NS)
        final = (self.known_until - epoch) * _NS if self._causal else np.inf
        self.samples.change(first, time, self._forces(at, time), final)
        return changed

    def _all_knots(self, epoch: int) -> list[int]:
        """Stamps of all samples and the epoch, ns, ascending."""
        own, first = {s for each in self._signals.values() for s in each.stamps}, NEVER
        if self._base is not None:
            first, *others = [epoch + round(t / _NS) for t in self._base.time.tolist()]
            own |= set(others)
        return [first, *sorted(stamp for stamp in own if stamp > first)]

    def _forces(self, at: NDArray[np.int64], time: Vector) -> NDArray[np.float64]:
        """Forces and their derivatives at stamps (ns), s since the epoch, (4, samples, n)."""
        total = np.zeros((JETS, at.size, len(self._directions)))
        if self._base is not None:
            total += self._base.derivatives(time, slack=_NS)
        held = np.array([each.held(at) for each in self._signals.values()])
        total[0] += held.T @ self._directions.T
        return total

    def forget_before(self, stamp: int) -> None:
        """Forget samples that are not needed from ``stamp`` (ns) on, many at a time."""
        old = bisect_right(self._knots, stamp) - 1
        if old < _OFTEN:
            return
        self._least = self._knots[old]
        self.samples.forget(self.samples.dropped + old)
        del self._knots[:old]
        for each in self._signals.values():
            each.forget_before(self._least)


def connected(system: System, *, causal: bool = False) -> tuple[System, LiveSignals | None]:
    """The ``system`` connected to new live signals; None if the system has none."""
    if system.live is None:
        return system, None
    signals = LiveSignals(system, causal=causal)
    return replace(system, forcing=replace(system.forcing, sampled=signals.samples)), signals


def refused(system: System, what: str) -> None:
    """Raise UsageError where a ``system`` has live forces, which ``what`` cannot use."""
    if system.live is not None:
        raise UsageError(
            f"{system.name}: known only live: {', '.join(system.live.inputs)}, which {what} cannot"
            " use; expected forces that are harmonic or sampled"
        )
