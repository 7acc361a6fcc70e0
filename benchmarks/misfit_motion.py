# SPDX-License-Identifier: Apache-2.0
"""Motion of plants that differ from the observer's model, by independent code.

Scipy's DOP853 integrates each flight. An impact is found as a root of its gap in the dense output.
Of the package only the matrices of ``System`` are used, and its events.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import integrate, linalg, optimize

from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import System
from impact_observer.stamps import NS_PER_S

EPOCH = 5 * NS_PER_S
RATE = 50
"""Samples of the true states in a second."""
RTOL, ATOL = 3e-14, 1e-15
"""As tight as DOP853 allows: the covariance on an exact plant with stamps of 1 ns is 1e-13 m."""

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Force = Callable[[float, Array, Array], Array]
"""Forces at ``(t, q, u)``, shape (n,), N."""
Piece = Callable[[float | Array], Array]
"""States in a step, shape (2n,) at an instant or (2n, instants)."""
Restitution = Callable[[float, float, float, np.random.Generator], float]
"""Restitution of an impact: of the value in the model, approach speed, instant, generator."""

_SLOW = 1e-4
"""Speed of an impact that ends an accumulation, m/s."""
_SHORT = 1e-2
"""Flight before such an impact, s."""


class AccumulationError(Exception):
    """Impacts of a contact accumulate, or a contact stays closed."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What a sensor reports, and the truth.

    Attributes:
        stamps: onsets of the impacts, ns, ascending, shape (impacts,).
        contacts: indices of their contacts, shape (impacts,).
        ends: ends of the contacts, ns, shape (impacts,); of rigid ones their stamps.
        sample_stamps: ns, shape (samples,).
        states: (q, u) in the coordinates of the model, shape (samples, 2n).
    """

    stamps: Stamps
    contacts: NDArray[np.intp]
    ends: Stamps
    sample_stamps: Stamps
    states: Array

    def events(self, system: System) -> Iterator[ImpactEvent]:
        """What an ideal sensor of the ``system`` reports."""
        hits = zip(self.stamps.tolist(), self.contacts.tolist(), strict=True)
        for k, (stamp, contact) in enumerate(hits, start=1):
            switches = (Switch(system.contact_names[contact], Kind.IMPACT),)
            yield ImpactEvent(stamp, switches, k, 1, EPOCH)

    def away(self, margin: float = 0.005) -> NDArray[np.bool_]:
        """Which samples are farther than ``margin``, s, from any contact, shape (samples,)."""
        wide = round(margin * NS_PER_S)
        begun = np.searchsorted(self.stamps - wide, self.sample_stamps, side="right")
        ended = np.searchsorted(np.sort(self.ends) + wide, self.sample_stamps, side="left")
        return np.asarray(begun == ended)


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """A plant: a system, and what no linear system with rigid stops has.

    Attributes:
        system: hidden bodies are its last coordinates.
        force: in addition to the system's.
        restitution: instead of a constant one.
        contact_time: duration of an impact, s; 0 for rigid stops.
    """

    system: System
    force: Force | None = None
    restitution: Restitution | None = None
    contact_time: float = 0.0


def kelvin_voigt(mass: float, restitution: float, duration: float) -> tuple[float, float]:
    """Stiffness, N/m, and damping, Ns/m, of a stop that only pushes.

    A free mass leaves it when its force vanishes, after ``duration``. Its speed decays with the
    rate ``beta``: ``restitution = exp(-beta duration)``.
    """
    beta = -math.log(restitution) / duration

    def excess(omega: float) -> float:
        phase = math.atan2(2 * beta * omega, omega**2 - beta**2)
        return omega * duration - math.pi + phase

    omega = optimize.brentq(excess, 1e-6 / duration, math.pi / duration, xtol=1e-9)
    return mass * (omega**2 + beta**2), 2 * mass * beta


class Motion:
    """A run of a plant from the state ``x`` at ``t = 0``."""

    def __init__(self, truth: Truth, x: Array, seconds: float, rng: np.random.Generator) -> None:
        self.truth, self.rng = truth, rng
        system = self.system = truth.system
        n = self.n = system.n
        self.t, self.x, self.seconds = 0.0, x, seconds
        self.begin = 0.0  # of the present flight
        self.inverse = linalg.inv(system.M)
        self.A = np.zeros((2 * n, 2 * n))
        self.A[:n, n:] = np.eye(n)
        self.A[n:] = -self.inverse @ np.hstack([system.K, system.C])
        self.mass = 1 / np.diag(system.W.T @ self.inverse @ system.W)
        stops = [
            kelvin_voigt(mass, eps, truth.contact_time) if truth.contact_time else (0.0, 0.0)
            for mass, eps in zip(self.mass, system.eps, strict=True)
        ]
        self.stops = np.array(stops)
        self.pressed: set[int] = set()
        self.times = np.arange(math.floor(RATE * seconds) + 1) / RATE
        self.states = np.empty((self.times.size, 2 * n))
        self.impacts: list[tuple[float, int]] = []
        self.ends: list[float] = []

    def run(self) -> Recording:
        """The impacts and states up to the end.

        Raises:
            AccumulationError: a contact comes to rest.
        """
        while self.t < self.seconds:
            changed = self.advance()
            if changed is None:
                break
            if changed in self.pressed:
                self.release(changed)
            else:
                self.hit(changed)
        for i in tuple(self.pressed):
            self.release(i)
        starts, contacts = zip(*self.impacts, strict=True) if self.impacts else ((), ())
        return Recording(
            stamps(starts),
            np.array(contacts, np.intp),
            stamps(self.ends),
            stamps(self.times),
            self.states,
        )

    def rates(self, t: float, x: Array) -> Array:
        """``dx/dt``."""
        n, forcing = self.n, self.system.forcing
        q, u = x[:n], x[n:]
        wave = forcing.frequency * t
        force = forcing.constant + np.cos(wave) @ forcing.cosine + np.sin(wave) @ forcing.sine
        if self.truth.force is not None:
            force = force + self.truth.force(t, q, u)
        for i in self.pressed:
            force = force + self.load(i, x) * self.system.W[:, i]
        found = self.A @ x
        found[n:] += self.inverse @ force
        return np.asarray(found)

    def gap(self, i: int, x: Array) -> Array:
        """Of one contact, at one state or several, shape (2n, ...)."""
        return np.asarray(self.system.W[:, i] @ x[: self.n] + self.system.q_r[i])

    def speed(self, i: int, x: Array) -> Array:
        """Contact speed, in the same way."""
        return np.asarray(self.system.W[:, i] @ x[self.n :])

    def load(self, i: int, x: Array) -> Array:
        """Force of a stop that is not rigid, in the same way."""
        stiffness, damping = self.stops[i]
        return np.asarray(-stiffness * self.gap(i, x) - damping * self.speed(i, x))

    def advance(self) -> int | None:
        """Go to the instant at which a contact closes or opens, and tell which."""
        self.begin = self.t
        solver = integrate.DOP853(self.rates, self.t, self.x, self.seconds, rtol=RTOL, atol=ATOL)
        while solver.status == "running":
            solver.step()
            if solver.status == "failed":
                raise ArithmeticError("DOP853 failed")
            piece = solver.dense_output()
            grid = np.linspace(piece.t_old, piece.t, 9)
            states = piece(grid)
            found = [
                (at, i)
                for i in range(self.system.m)
                if (at := self.crossing(i, piece, grid, states)) is not None
            ]
            until, changed = min(found, default=(solver.t, None))
            first, last = np.searchsorted(self.times, [self.t, until])
            if until == self.seconds:
                last = np.intp(self.times.size)
            if last > first:
                self.states[first:last] = piece(self.times[first:last]).T
            self.t, self.x = until, piece(until)
            if changed is not None:
                return changed
        return None

    def crossing(self, i: int, piece: Piece, grid: Array, states: Array) -> float | None:
        """The first instant in a step at which a gap, or the load of a closed stop, vanishes."""
        if i in self.pressed:
            return first_root(lambda t: self.load(i, piece(t)), grid, self.load(i, states))
        gaps, speeds = self.gap(i, states), self.speed(i, states)
        left = grid[0] == self.begin and abs(gaps[0]) < 1e-10  # it has just hit this stop

        def gap(t: float) -> float:
            if not left:
                return float(self.gap(i, piece(t)))
            return float(self.gap(i, piece(t)) / (t - self.begin) if t > self.begin else speeds[0])

        if left:
            gaps[0] = speeds[0]
        turns = np.flatnonzero((speeds[:-1] < 0) & (speeds[1:] > 0))
        lowest = [root(lambda t: self.speed(i, piece(t)), *grid[k : k + 2]) for k in turns]
        if lowest:
            grid = np.insert(grid, turns + 1, lowest)
            gaps = np.insert(gaps, turns + 1, [gap(t) for t in lowest])
        if gaps[-1] < 0 and speeds[-1] < 0 and not np.any(gaps > 0):
            raise AccumulationError(self.system.contact_names[i])
        return first_root(gap, grid, gaps)

    def hit(self, i: int) -> None:
        """A contact closes."""
        n, eps = self.n, float(self.system.eps[i])
        speed = float(-self.speed(i, self.x))
        last = max((t for t, k in self.impacts if k == i), default=-math.inf)
        if speed < _SLOW and self.t - last < _SHORT:
            raise AccumulationError(self.system.contact_names[i])
        self.impacts.append((self.t, i))
        self.ends.append(self.t)
        if self.truth.contact_time:
            self.pressed.add(i)
            return
        if self.truth.restitution is not None:
            eps = self.truth.restitution(eps, speed, self.t, self.rng)
        impulse = (1 + eps) * speed * self.mass[i] * self.system.W[:, i]
        self.x[n:] += self.inverse @ impulse

    def release(self, i: int) -> None:
        """A stop that is not rigid pushes no more."""
        self.pressed.discard(i)
        latest = max(k for k, (_, contact) in enumerate(self.impacts) if contact == i)
        self.ends[latest] = self.t
        if self.t - self.impacts[latest][0] > 3 * self.truth.contact_time:
            raise AccumulationError(self.system.contact_names[i])


def first_root(
    function: Callable[[float], float | Array], grid: Array, values: Array
) -> float | None:
    """Where a function first becomes negative, of its values at a grid of instants."""
    found = np.flatnonzero((values[:-1] > 0) & (values[1:] <= 0))
    return root(function, *grid[found[0] : found[0] + 2]) if found.size else None


def root(function: Callable[[float], float | Array], low: float, high: float) -> float:
    """A root between two instants."""
    return float(optimize.brentq(function, low, high, xtol=1e-14, rtol=1e-15))


def stamps(seconds: object) -> Stamps:
    """Of instants in s since the epoch."""
    since = np.rint(np.asarray(seconds, float) * NS_PER_S)
    return np.asarray(EPOCH + since.astype(np.int64), np.int64)
