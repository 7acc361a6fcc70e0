# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Contacts that stay closed in a replica: sprag clutches, ``0 <= gamma _|_ lambda >= 0``.

A contact with ``chi = 1`` slips with ``gamma > 0`` and no load, or is held with ``gamma = 0`` and
a load ``lambda >= 0``. A slipping one is held from the root of ``gamma`` on, a held one slips from
the root of ``lambda`` on; in between the motion is one linear phase (``phase.py``). With the
geometric law the gaps stay closed in both.
"""

from abc import abstractmethod
from bisect import bisect
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.contact.friction import Grip, ended
from impact_observer.dynamics.contact.persistent_contact import persistent_contacts
from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.dynamics.flow.flow import Motion
from impact_observer.dynamics.flow.phase import Phase, Phases
from impact_observer.dynamics.guards.location import Crossing, Hunt, Search
from impact_observer.dynamics.guards.watched import Watched
from impact_observer.kernel import PhaseMotion
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

_INSTANT = 1e-12
"""Length of a phase that counts as none, relative to the model's time scale."""
_PATIENCE = 30
"""Most doublings of the least length of a phase after that."""
_MOST = 8
"""Phases without length in a row that count as contact changes and not as rounding."""
_SEARCHED = 20_000
"""Windows of one motion in which changes are searched for: an hour of a contact that is closed."""


class Clutches:
    """Motions of one system whose closed contacts are sprag clutches."""

    def __init__(self, system: System, phases: Phases | None = None) -> None:
        """Prepare the ``phases``, or take them."""
        self.system = system
        self.phases = Phases(system) if phases is None else phases
        self.window = self.phases.scales.window
        self.instant = _INSTANT * self.phases.scales.timescale
        self.search = lru_cache(KEPT)(self._search)

    def motion(self, t: float, x: Vector, closed: tuple[int, ...], *, fix: bool) -> Motion:
        """The motion through ``x`` at ``t`` (s since the epoch) while ``closed`` have ``chi = 1``.

        The state (q, u), shape (2n,), has ``gamma >= 0`` on them; with ``fix`` their gaps stay
        closed too, as in the geometric law.
        """
        if not (closed or self.system.guides):
            return self.phases.phase().start(t, x)
        return ClutchMotion(self, t, x, closed, fixed=closed if fix else ())

    def _search(self, phase: Phase, slipping: tuple[int, ...]) -> Search:
        """The search for the end of ``phase``: loads first, then speeds of ``slipping``."""
        speeds = Watched.speeds(self.system, list(slipping))
        watched = Watched.loads(phase).and_also(speeds)
        if phase.rubbing is not None:
            watched = watched.and_also(Watched.guides(self.system, phase))
        return Search(phase, watched, self.window)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One phase of a motion, from ``start`` on.

    Attributes:
        start: s since the start of the motion.
        phase: the phase.
        motion: in it, of (p, u).
        slipping: contacts with ``chi = 1`` that slip, as indices.
        stopped: open contacts whose gaps are held at zero, as indices; see ``sweeping.py``.
    """

    start: float
    phase: Phase
    motion: PhaseMotion
    slipping: tuple[int, ...]
    stopped: tuple[int, ...] = ()

    @property
    def kind(self) -> tuple[object, ...]:
        """What its contacts do; parts of the same kind obey the same equations."""
        return self.phase.held, self.phase.rubbing, self.slipping, self.stopped


class Piecewise(Motion):
    """A motion phase after phase, computed as far as requested; requests do not change it.

    After ``_SEARCHED`` windows its phase stays, so that a stamp of another day costs seconds.
    """

    def __init__(self, clutches: Clutches, t: float, x: Vector, closed: tuple[int, ...]) -> None:
        """Begin with ``x`` at ``t``, the contacts ``closed`` having ``chi = 1`` from then on."""
        self.t = t
        self._clutches = clutches
        self._closed = closed
        self._searched, self._windows = 0.0, 0
        self._hunt: Hunt | None = None
        self._short_phases = 0
        self._carried: list[Matrix] = [np.eye(x.size)]  # differences, to the start of each part
        system = clutches.system
        u = x[system.n :]
        slow = system.contact_speed(u) <= clutches.phases.speed_tolerance(u)
        self._parts = [self._first(x, tuple(i for i in closed if slow[i]))]

    @abstractmethod
    def _first(self, x: Vector, slow: tuple[int, ...]) -> Part:
        """The first phase, ``slow`` contacts having ``gamma = 0``."""

    @abstractmethod
    def _next(self, part: Part, crossing: Crossing) -> Part:
        """The phase after ``part`` ended by ``crossing``."""

    @abstractmethod
    def _search(self, part: Part) -> Search:
        """The search for the end of ``part``."""

    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """States (q, u) at ``s`` seconds, shape (samples, 2n)."""
        self._extend(float(np.max(s, initial=0.0)))
        which = np.searchsorted([part.start for part in self._parts], s, side="right") - 1
        found = np.empty((s.size, 2 * self._clutches.system.n))
        for k in np.unique(which):
            part, mine = self._parts[k], which == k
            found[mine] = part.motion.states(s[mine] - part.start)
        return found

    def transition(self, s: float) -> Matrix:
        """Propagation of a small difference of two states by ``s`` seconds, shape (2n, 2n).

        Where a guide stops to slip, or turns, the motions do so at different instants: a saltation
        matrix (``docs/method.md``). Where one begins to slip it is the identity.
        """
        self._extend(s)
        last = bisect([part.start for part in self._parts], s) - 1
        for k in range(len(self._carried) - 1, last):
            part, later = self._parts[k], self._parts[k + 1]
            moved = part.phase.transition(later.start - part.start) @ self._carried[k]
            self._carried.append(self._across(part, later) @ moved)
        part = self._parts[last]
        return np.asarray(part.phase.transition(s - part.start) @ self._carried[last])

    def _across(self, part: Part, later: Part) -> Matrix:
        """``I + (F+ - F-) grad h / (dh/dt)-`` for the slip ``h`` that vanishes between parts."""
        system, n = self._clutches.system, self._clutches.system.n
        found = np.eye(2 * n)
        if part.phase.rubbing is None or later.phase.rubbing is None:
            return found
        t, x = self.t + later.start, part.motion.state(later.start - part.start)
        before = part.phase.acceleration(t, x)
        jump = later.phase.acceleration(t, x) - before
        speeds = system.W_T.T @ x[n:]
        slips = [j for j, side in part.phase.rubbing.ends if not side]
        loads, now = part.phase.rubbing.loads, later.phase.rubbing.loads
        for j in sorted(slips, key=lambda j: abs(float(speeds[j]))):
            rate = float(system.W_T[:, j] @ before)
            if now[j] != loads[j] and rate:
                found[n:, n:] += np.outer(jump, system.W_T[:, j]) / rate
                break
        return found

    def _extend(self, until: float) -> None:
        window = self._clutches.window
        while self._parts[-1].start + self._searched <= until and self._windows < _SEARCHED:
            part, least = self._parts[-1], self._least()
            if self._hunt is None:
                self._hunt = self._search(part).along(part.motion, least)
            self._windows += 1
            self._searched += window
            crossing = self._hunt.first(self._searched)
            if crossing is not None and crossing.s <= self._searched:
                crossing = crossing._replace(s=max(crossing.s, least))
                is_short = crossing.s <= max(self._clutches.instant, least)
                self._short_phases = self._short_phases + 1 if is_short else 0
                self._parts.append(self._next(part, crossing))
                self._searched, self._hunt = 0.0, None

    def _least(self) -> float:
        """Least length of the present phase, s.

        Loads and speeds that vanish together may alternate at one instant without end, as their
        signs are rounding. Then a phase lasts at least a time within rounding and, where that does
        not end it, longer and longer.
        """
        if self._short_phases <= _MOST:
            return 0.0
        return self._clutches.instant * 2.0 ** min(self._short_phases - _MOST, _PATIENCE)


class ClutchMotion(Piecewise):
    """The motion of a replica with clutches and guides."""

    def __init__(
        self,
        clutches: Clutches,
        t: float,
        x: Vector,
        closed: tuple[int, ...],
        *,
        fixed: tuple[int, ...],
    ) -> None:
        self._fixed = fixed
        super().__init__(clutches, t, x, closed)

    def _first(self, x: Vector, slow: tuple[int, ...]) -> Part:
        return self._part(0.0, x, slow)

    def _search(self, part: Part) -> Search:
        return self._clutches.search(part.phase, part.slipping)

    def _next(self, part: Part, crossing: Crossing) -> Part:
        start = part.start + crossing.s
        x = part.motion.state(crossing.s)
        pressed, slips = part.phase.pressed, len(part.phase.pressed) + len(part.slipping)
        released = {pressed[i] for i in crossing.which if i < len(pressed)}
        caught = {
            part.slipping[i - len(pressed)] for i in crossing.which if len(pressed) <= i < slips
        }
        slow = [i for i in self._closed if i not in part.slipping or i in caught]
        found = self._part(start, x, tuple(slow))
        if found.kind != part.kind:
            return found
        # A load that falls too slowly to see its sign may not become negative either.
        closed, phases = tuple(i for i in slow if i not in released), self._clutches.phases
        if part.phase.rubbing is None:
            return self._begun(start, x, Grip(closed, phases.independent(closed)))
        grip = Grip(closed, part.phase.held, part.phase.rubbing.loads)
        ends = [i - slips for i in crossing.which if i >= slips]
        return self._begun(start, x, ended(phases, grip, part.phase, released, ends))

    def _part(self, start: float, x: Vector, slow: tuple[int, ...]) -> Part:
        """The phase from ``start`` on, ``slow`` contacts having ``gamma = 0``."""
        phases = self._clutches.phases
        return self._begun(
            start, x, persistent_contacts(phases, self._fixed, self.t + start, x, slow)
        )

    def _begun(self, start: float, x: Vector, persistent: Grip) -> Part:
        phase = self._clutches.phases.phase(persistent.held, self._fixed, persistent.loads)
        slipping = tuple(i for i in self._closed if i not in persistent.closed)
        return Part(start, phase, phase.start(self.t + start, x), slipping)
