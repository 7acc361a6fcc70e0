# SPDX-License-Identifier: Apache-2.0
"""Contacts that stay closed in a replica: sprag clutches, ``0 <= gamma _|_ lambda >= 0``.

A contact with ``chi = 1`` slips with ``gamma > 0`` and no load, or is held with ``gamma = 0`` and
a load ``lambda >= 0``. A slipping one is held from the root of ``gamma`` on, a held one slips from
the root of ``lambda`` on; in between the motion is one linear phase (``phase.py``). With the
geometric law the gaps stay closed in both.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.contact.persistent_contact import ended, persistent_contacts
from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.dynamics.flow import Motion, PhaseMotion
from impact_observer.dynamics.mechanism import Grip
from impact_observer.dynamics.phase import Phase, Phases
from impact_observer.dynamics.roots import RootSearch
from impact_observer.dynamics.watched import End, Watch, watch
from impact_observer.model import System
from impact_observer.states import Vector

_INSTANT = 1e-12
"""Longest phase that counts as an instant, relative to the model's time scale."""
_PATIENCE = 30
"""Most doublings of the least length of a phase after that."""
_MOST = 8
"""Most phases without length in a row that count as contact changes; more are rounding."""
_SEARCHED = 20_000
"""Windows of one motion in which changes are searched for: an hour of a contact that is closed."""


class Clutches:
    """Motions of one system whose closed contacts are sprag clutches."""

    def __init__(self, system: System, phases: Phases | None = None) -> None:
        """Prepare the phases of ``system``, or use the given ``phases``."""
        self.system = system
        self.phases = Phases(system) if phases is None else phases
        self.window = self.phases.scales.window
        self.instant = _INSTANT * self.phases.scales.timescale
        self.watch = lru_cache(KEPT)(self._watch)

    def motion(self, t: float, x: Vector, closed: tuple[int, ...], *, fix: bool) -> Motion:
        """The motion through ``x`` at ``t`` (s since the epoch) while ``closed`` have ``chi = 1``.

        The state (q, u), shape (2n,), has ``gamma >= 0`` on them; with ``fix`` their gaps stay
        closed too, as in the geometric law.
        """
        if not closed:
            return self.phases.phase().start(t, x)
        return Piecewise(self, t, x, closed, fixed=closed if fix else ())

    def _watch(
        self,
        phase: Phase,
        slipping: tuple[int, ...],
        stopped: tuple[int, ...],
        opened: tuple[int, ...],
    ) -> Watch:
        """The guard functions that end ``phase``: loads of its contacts.

        Further guards are the speeds of ``slipping`` contacts, the reactions of ``stopped``
        contacts, and the gaps of ``opened`` contacts.
        """
        reactions = None
        if stopped:
            reactions = len(stopped), self.phases.projection.reactions(phase.fixed)
        return watch(self.system, phase, opened, slipping, reactions)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One phase of a motion, from ``start`` on.

    Attributes:
        start: s since the start of the motion.
        phase: the phase.
        motion: the motion of (p, u) in the phase.
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
        """The state of the contacts; parts of the same kind obey the same equations."""
        return self.phase.held, self.slipping, self.stopped


class Piecewise(Motion):
    """A motion phase after phase, computed as far as requested; requests do not change it.

    After ``_SEARCHED`` windows the phase stays, so that a stamp of another day costs seconds.
    """

    def __init__(
        self,
        clutches: Clutches,
        t: float,
        x: Vector,
        closed: tuple[int, ...],
        *,
        fixed: tuple[int, ...],
    ) -> None:
        """Begin with ``x`` at ``t``, the contacts ``closed`` having ``chi = 1`` from then on.

        The gaps of ``fixed`` contacts stay closed.
        """
        self.t = t
        self._clutches = clutches
        self._closed, self._fixed = closed, fixed
        self._search: RootSearch | None = None
        self._short_phases = 0
        system = clutches.system
        u = x[system.n :]
        slow = system.contact_speed(u) <= clutches.phases.speed_tolerance(u)
        self._parts = [self._part(0.0, x, tuple(i for i in closed if slow[i]), ())]

    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """States (q, u) at ``s`` seconds, shape (samples, 2n)."""
        self._extend(float(np.max(s, initial=0.0)))
        which = np.searchsorted([part.start for part in self._parts], s, side="right") - 1
        states = np.empty((s.size, 2 * self._clutches.system.n))
        for k in np.unique(which):
            part, mine = self._parts[k], which == k
            states[mine] = part.motion.states(s[mine] - part.start)
        return states

    def _extend(self, until: float) -> None:
        clutches = self._clutches
        while True:
            part, least = self._parts[-1], self._least()
            end = min(until, clutches.window * (_SEARCHED - len(self._parts)))
            if self._search is None:
                guards = self._watch(part).guards
                self._search = RootSearch(guards, part.motion, least)
            crossing = self._search.first(end - part.start)
            if crossing is None or part.start + crossing[0] > end:
                return
            s = max(crossing[0], least)
            is_short = s <= max(clutches.instant, least)
            self._short_phases = self._short_phases + 1 if is_short else 0
            self._parts.append(self._next(part, s, crossing[1]))
            self._search = None

    def _least(self) -> float:
        """Least length of the present phase, s.

        Loads and speeds that vanish together may alternate at one instant without end, as their
        signs are rounding. Then a phase lasts at least a time within rounding, and that time
        doubles as long as the alternation goes on.
        """
        if self._short_phases <= _MOST:
            return 0.0
        return self._clutches.instant * 2.0 ** min(self._short_phases - _MOST, _PATIENCE)

    def _watch(self, part: Part) -> Watch:
        """The guard functions that end ``part``."""
        return self._clutches.watch(part.phase, part.slipping, part.stopped, self._opened(part))

    def _opened(self, _: Part) -> tuple[int, ...]:
        """Contacts whose gaps can change and must stay nonnegative."""
        return ()

    def _next(self, part: Part, s: float, which: tuple[int, ...]) -> Part:
        """The phase after ``part``, in which ``which`` of its functions vanish after ``s``."""
        start, x, phase = part.start + s, part.motion.state(s), part.phase
        crossed = self._watch(part).crossed(which)
        slow = tuple(i for i in self._closed if i not in part.slipping or i in crossed[End.SPEED])
        stopped = {*part.stopped, *crossed[End.GAP]}
        following = self._part(start, x, slow, tuple(stopped))
        if following.kind != part.kind:
            return following
        # A load that falls too slowly to see its sign may not become negative either.
        phases = self._clutches.phases
        grip = ended(phases, phase, slow, crossed[End.LOAD])
        still = tuple(sorted(stopped - crossed[End.REACTION]))
        return self._begun(start, x, grip, phases.independent(still, self._closed))

    def _part(
        self, start: float, x: Vector, slow: tuple[int, ...], stopped: tuple[int, ...]
    ) -> Part:
        """The phase from ``start`` on, ``slow`` contacts having ``gamma = 0``.

        Contacts that are ``stopped``, before or now, have ``g = 0``.
        """
        grip = persistent_contacts(self._clutches.phases, self._fixed, self.t + start, x, slow)
        return self._begun(start, x, grip, stopped)

    def _begun(self, start: float, x: Vector, grip: Grip, stopped: tuple[int, ...]) -> Part:
        fixed = (*self._fixed, *stopped)
        phase = self._clutches.phases.phase(grip.held, fixed)
        slipping = tuple(i for i in self._closed if i not in grip.closed)
        return Part(start, phase, phase.start(self.t + start, x), slipping, stopped)
