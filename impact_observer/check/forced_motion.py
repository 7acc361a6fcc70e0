# SPDX-License-Identifier: Apache-2.0
"""Motion of the gaps of a model under constant loads and excitations, without impacts.

The steady motion without contacts: ``K q_0 = f_0``, and for each harmonic
``(K - omega^2 M + i omega C) q_k = f_k``. Grounds that move are part of the forcing; a drive turns
at its nominal frequency.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_observer.check.undamped_modes import UndampedModes
from impact_observer.model import System
from impact_observer.states import Vector, frozen

_MOVED = 1e-12
"""Change of a gap by a rigid-body mode that counts as none."""
_NEVER = 10.0
"""Ratio of a gap to its motion above which the contact is never reached."""
_FAST = 100.0
"""Contact speed that hardly any machine has, m/s."""
_BOUNDLESS = 1e9
"""Amplitude that counts as a resonance without damping, m."""
_ABOVE, _BELOW = 10.0, 0.2
"""Ratio of an excitation's frequency to the highest, and to the lowest mode's, that is unusual."""


@dataclass(frozen=True, slots=True, eq=False)
class ForcedMotion:
    """The motion of the gaps without impacts and friction; NaN where the model lacks the forces.

    Attributes:
        rest: gap under the constant loads, shape (m,), m.
        sag: change of the gap by the constant loads, shape (m,), m.
        swing: largest amplitude of the gap, shape (m,), m; infinite at a resonance.
        speed: largest amplitude of the gap's rate, shape (m,), m/s.
        pull: acceleration by which constant loads close the gap of a body without springs, m/s^2,
            shape (m,); zero elsewhere.
        shake: amplitude of the acceleration of such a gap by the excitations, shape (m,), m/s^2.
        slowest: lowest frequency of a mode, rad/s; NaN with a rigid-body mode.
        fastest: highest frequency of a mode, rad/s; NaN if all modes are rigid.
    """

    rest: Vector
    sag: Vector
    swing: Vector
    speed: Vector
    pull: Vector
    shake: Vector
    slowest: float
    fastest: float

    def never_reached(self) -> list[int]:
        """Contacts whose gap is far larger than its motion."""
        reach = np.abs(self.sag) + self.swing
        return _where((self.swing > 0) & (self.rest > _NEVER * reach))

    def not_reached_alone(self) -> list[int]:
        """Contacts whose gap at rest is larger than its swing, though not far larger."""
        far = set(self.never_reached())
        return [i for i in _where((self.swing > 0) & (self.rest > self.swing)) if i not in far]

    def never_left(self) -> list[int]:
        """Contacts on which a body without springs rests for good once it has come to rest."""
        pressed = (self.pull > 0) & (self.shake > 0) & (self.shake < self.pull)
        return _where(pressed)

    def never_returned_to(self) -> list[int]:
        """Contacts from which a body without springs is pulled away, where none is pulled to."""
        return [] if np.any(self.pull > 0) else _where(self.pull < 0)

    def too_fast(self) -> list[int]:
        """Contacts with a speed that no machine has."""
        return _where((self.speed > _FAST) & np.isfinite(self.speed))

    def odd_frequencies(self, system: System) -> list[tuple[float, str]]:
        """Frequencies of excitations far above or below all modes, rad/s, and their side."""
        odd = list[tuple[float, str]]()
        for each in np.unique(system.forcing.frequency).tolist():
            if each > _ABOVE * self.fastest:
                odd.append((each, "above the highest"))
            if each < _BELOW * self.slowest:
                odd.append((each, "below the lowest"))
        return odd


def _where(true: NDArray[np.bool_]) -> list[int]:
    """The indices of the true entries."""
    return [int(i) for i in np.flatnonzero(true)]


def forced_motion(system: System) -> ForcedMotion:
    """The steady motion of a system without contacts."""
    modes = UndampedModes.of_system(system)
    elastic, free = np.sqrt(modes.squares), modes.rigid
    slowest, fastest = (elastic[0], elastic[-1]) if elastic.size else (math.nan, math.nan)
    slowest = math.nan if free.size else slowest
    nothing = np.full(system.m, math.nan)
    forcing, W = system.forcing, system.W
    live = system.live
    if forcing.sampled is not None or (live and (live.inputs or live.grounds)):
        return ForcedMotion(
            rest=nothing,
            sag=nothing,
            swing=nothing,
            speed=nothing,
            pull=nothing,
            shake=nothing,
            slowest=float(slowest),
            fastest=float(fastest),
        )
    sag = W.T @ (modes.elastic / elastic**2) @ (modes.elastic.T @ forcing.constant)
    floats = np.any(np.abs(W.T @ free) > _MOVED, axis=1)
    pull = -modes.gap_acceleration(system)
    swing, speed, shake = np.zeros((3, system.m))
    for omega, force in zip(forcing.frequency, forcing.cosine - 1j * forcing.sine, strict=True):
        stiffness = system.K - omega**2 * system.M + 1j * omega * system.C
        try:
            amplitude = np.abs(W.T @ np.linalg.solve(stiffness, force))
        except np.linalg.LinAlgError:
            amplitude = np.full(system.m, math.inf)
        amplitude[amplitude > _BOUNDLESS] = math.inf
        swing, speed = swing + amplitude, speed + omega * amplitude
        shake = shake + np.abs(W.T @ free @ (free.T @ force))
    rest = np.where(floats, math.nan, sag + system.q_r)
    alone = floats & (not elastic.size)
    return ForcedMotion(
        rest=frozen(rest),
        sag=frozen(sag),
        swing=frozen(swing),
        speed=frozen(speed),
        pull=frozen(np.where(alone, pull, 0.0)),
        shake=frozen(np.where(alone, shake, 0.0)),
        slowest=float(slowest),
        fastest=float(fastest),
    )
