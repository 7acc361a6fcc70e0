# SPDX-License-Identifier: Apache-2.0
"""A drill whose restitution may scatter from hit to hit, by the formulas of oscillators."""

import numpy as np
from scipy import optimize
from systems import EPOCH

from impact_observer.events import ImpactEvent, Switch
from impact_observer.states import Vector

MASSES, STIFFNESSES, DAMPINGS = (
    np.array([1.207, 0.795]),
    np.array([9250, 58100]),
    np.array([5, 24]),
)
FORCE, RATE, GAP, RESTITUTION = 60.0, 139.0469, 0.00162, 0.55
DRILL = """
name: drill
bodies:
  - {name: hammer, mass: {value: 1.2, deviation: 0.012}}
  - {name: bit, mass: {value: 0.8, deviation: 0.008}}
springs:
  - between: [ground, hammer]
    stiffness: {value: 9000, deviation: 450}
    damping: {value: 5, deviation: 3}
  - between: [ground, bit]
    stiffness: {value: 60000, deviation: 3000}
    damping: {value: 20, deviation: 15}
forces: [{body: hammer, amplitude: 60, frequency: 139.0469, phase: -1.570796}]
stops:
  - name: hit
    between: [hammer, bit]
    gap: {value: 0.0015, deviation: 0.0002}
    restitution: {value: 0.6, deviation: 0.1}
"""


class Drill:
    """Two oscillators that hit each other, by the formulas of a damped oscillator.

    Attributes:
        scatter: standard deviation of the restitution of a hit.
    """

    def __init__(self, scatter: float) -> None:
        self.scatter = scatter
        self.decay = DAMPINGS / (2 * MASSES)
        self.turn = np.sqrt(STIFFNESSES / MASSES - self.decay**2)
        stiffness = STIFFNESSES[0] - MASSES[0] * RATE**2 + 1j * RATE * DAMPINGS[0]
        self.gain = FORCE / stiffness

    def forced(self, t: float) -> Vector:
        """The forced motion (q, u), shape (2, 2)."""
        q = self.gain * np.exp(1j * RATE * t)
        return np.array([[q.imag, 0.0], [(1j * RATE * q).imag, 0.0]])

    def flown(self, x: Vector, t: float, s: float) -> Vector:
        """The state (q, u) ``s`` seconds after the state ``x`` at ``t``."""
        q, u = x - self.forced(t)
        swing = (u + self.decay * q) / self.turn
        c, n, fades = np.cos(self.turn * s), np.sin(self.turn * s), np.exp(-self.decay * s)
        free = [q * c + swing * n, (self.turn * swing - self.decay * q) * c]
        free[1] -= (self.turn * q + self.decay * swing) * n
        return np.asarray(fades * np.array(free) + self.forced(t + s))

    def gap(self, x: Vector) -> float:
        """The gap between the bodies."""
        return float(GAP + x[0, 1] - x[0, 0])

    def speed_after(self, x: Vector) -> float:
        """The speed with which the gap opens in a state."""
        return float(x[1, 1] - x[1, 0])

    def recorded(self, seconds: float, seed: int) -> list[tuple[float, Vector]]:
        """The instants of hits and the states after them; the drive begins before time 0."""
        random, step = np.random.default_rng(seed), 1e-4
        t, x = -1.51317, np.array([[-4e-3, 0.0], [0.2, 0.0]])
        states = list[tuple[float, Vector]]()
        while t < seconds:
            s = step
            while self.gap(self.flown(x, t, s)) > 0:
                s += step
            s = optimize.brentq(lambda s, x=x, t=t: self.gap(self.flown(x, t, s)), s - step, s)
            t, x = t + s, self.flown(x, t, s)
            speed = x[1, 0] - x[1, 1]
            factor = 1 + RESTITUTION + self.scatter * random.standard_normal()
            x[1] += factor * speed * MASSES.prod() / MASSES.sum() * np.array([-1, 1]) / MASSES
            x[0, 1] = x[0, 0] - GAP + 1e-15
            states.append((t, x.copy()))
        return states


def events(hits: list[tuple[float, Vector]], clock: float) -> list[ImpactEvent]:
    """The hits after time 0 with errors of the ``clock``."""
    errors = clock * np.random.default_rng(101).standard_normal(len(hits))
    times = [t + error for (t, _), error in zip(hits, errors.tolist(), strict=True) if t > 0]
    return [
        ImpactEvent(EPOCH + round(1e9 * t), (Switch("hit"),), k + 1) for k, t in enumerate(times)
    ]
