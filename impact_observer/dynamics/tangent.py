# SPDX-License-Identifier: Apache-2.0
"""Flights and jumps of a system as maps of states, with derivatives by states and parameters.

A flight without a switch of a contact is an affine map of the state. Its derivative by a parameter
is a block of the exponential of an extended matrix (Van Loan, Computing integrals involving the
matrix exponential, 1978)::

    z' = A z,    w' = A_xx w + A_xy v + D z,    v' = Y v + D_y y

with ``z = (q, u, y)`` as in ``flow``, ``w`` the derivative of (q, u) by the parameter, ``v`` that
of the harmonics by a frequency, and ``D`` the derivative of the rates.

All maps take arrays of states, shape (..., 2n).
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics.contact.impact_law import ImpactLaw
from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.dynamics.exponential import TERMS, Exponential
from impact_observer.dynamics.mechanism import Array, Flown
from impact_observer.dynamics.phase import Phase, Phases
from impact_observer.events import Contacts
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.stamps import Elapsed, elapsed
from impact_observer.states import Matrix, Vector

_AT_ONCE = 1 << 22
"""Numbers of the exponentials that are made at once."""


class Maps(NamedTuple):
    """States as functions of earlier states ``x`` and of the parameters, near parameters.

    Leading axes number the maps; they may be broadcast against those of states.

    Attributes:
        Phi: derivative by ``x``, shape (..., 2n, 2n).
        drift: the image of ``x = 0``, shape (..., 2n).
        phi_slopes: derivatives of ``Phi`` by the parameters, shape (..., p, 2n, 2n).
        drift_slopes: derivatives of ``drift`` by the parameters, shape (..., p, 2n).
    """

    Phi: Array
    drift: Array
    phi_slopes: Array
    drift_slopes: Array

    def of(self, x: Array) -> Array:
        """The images of states, shape (..., 2n)."""
        return np.asarray((self.Phi @ x[..., None])[..., 0] + self.drift)

    def Gamma(self, x: Array) -> Array:  # noqa: N802 - the symbol of the theory
        """Derivatives of the images of ``x`` by the parameters, shape (..., 2n, p)."""
        moved = (self.phi_slopes @ x[..., None, :, None])[..., 0] + self.drift_slopes
        return np.asarray(np.swapaxes(moved, -1, -2))


class GuardRows(NamedTuple):
    """Linear functions ``by_x x + rest`` of states at one instant.

    Attributes:
        by_x: shape (k, 2n).
        rest: shape (k,).
        row_slopes: derivatives of ``by_x`` by the parameters, shape (k, p, 2n).
        rest_slopes: derivatives of ``rest`` by the parameters, shape (k, p).
    """

    by_x: Matrix
    rest: Vector
    row_slopes: Array
    rest_slopes: Matrix

    def of(self, x: Array) -> Array:
        """The functions at states (..., 2n), shape (..., k)."""
        return np.asarray(x @ self.by_x.T + self.rest)

    def Theta(self, x: Array) -> Array:  # noqa: N802 - capital as Gamma
        """Derivatives by the parameters at states (..., 2n), shape (..., k, p)."""
        return np.asarray(np.einsum("kpi,...i->...kp", self.row_slopes, x) + self.rest_slopes)


class Tangent:
    """One system of a family, linearised.

    Attributes:
        family: the systems.
        theta: the parameters of the system, shape (p,), within their bounds.
        system: the system.
        phases: its linear phases.
        newton: its impact law.
    """

    def __init__(self, family: ParametricFamily, theta: Vector | None = None) -> None:
        """Take the system of ``family`` with the parameters ``theta``, else the nominal one."""
        self.family = family
        self.theta = np.array(family.nominal if theta is None else theta)
        self.system = family.near(self.theta) if family.size else family.system
        self.phases, self.newton = Phases(self.system), ImpactLaw(self.system)
        self._numbers = family.coefficients_at(self.theta)
        self._laws = self._numbers.laws(family.system)
        self._effects = [each.effect for each in family.parameters]
        self._moving = [j for j, each in enumerate(family.parameters) if each.moves]
        self._extended = lru_cache(KEPT)(self._extended_of)
        self._noisy = lru_cache(KEPT)(self._noise_of)
        self._stops = lru_cache(KEPT)(self._stops_of)

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.system.n

    @property
    def p(self) -> int:
        """Number of parameters."""
        return self.family.size

    def phase(self, held: Contacts) -> Phase:
        """The phase in which the contacts ``held`` stay closed."""
        return self.phases.phase(self.phases.independent(held))

    def rates(self, t: Sequence[float], x: Array, held: Contacts) -> tuple[Array, Array]:
        """``dx/dt`` and its derivative by time, shape (K, 2n) each.

        Args:
            t: K instants, s since the epoch, or a single one.
            x: states, shape (K, 2n).
            held: contacts that stay closed.
        """
        A, d = self.phase(held).flow.exponential.A, 2 * self.n
        y = self._driven(t, held)
        first = x @ A[:d, :d].T + y @ A[:d, d:].T
        second = first @ A[:d, :d].T + y @ (A[:d, d:] @ A[d:, d:]).T
        return np.asarray(first), np.asarray(second)

    def rate_slope(self, held: Contacts) -> Matrix:
        """Derivative of ``dx/dt`` by ``x``, shape (2n, 2n)."""
        d = 2 * self.n
        return self.phase(held).flow.exponential.A[:d, :d]

    def by_rates(self, t: Sequence[float], x: Array, held: Contacts) -> Array:
        """Derivatives of ``dx/dt`` by the parameters, shape (K, 2n, p); see ``rates``."""
        n, d, waves = self.n, 2 * self.n, self._waves(held)
        A, y = self.phase(held).flow.exponential.A, self._driven(t, held)
        y = np.broadcast_to(y, (len(x), y.shape[-1]))
        found, z = np.zeros((*x.shape, self.p)), np.concatenate([x, y], axis=-1)
        times = np.array([[float(each)] for each in t])
        for j, push in self._pushes(held).items():
            late = times * (y[:, waves] @ self._turned(j).T)
            found[:, n:, j] = z @ push.T + late @ A[n:d, d:][:, waves].T
        return found

    def flights(self, t: Sequence[float], s: Vector, held: Contacts) -> Maps:
        """Flights of ``s`` seconds, of any sign, that begin at ``t`` s since the epoch.

        Args:
            t: K instants, or one for all.
            s: shape (K,), or one for all, shape (1,).
            held: contacts that stay closed; states have no speed there.

        Raises:
            DynamicsError: the forcing has no sample at one of ``t``.
        """
        drive, starts = self.phase(held).flow.drive, [elapsed(each) for each in t]
        if drive.is_smooth:
            return self._made(starts, s, held)
        size = max(len(starts), s.size)
        every = starts * (size // len(starts)), np.broadcast_to(s, size).tolist()
        begins, lengths, number = list[Elapsed](), list[float](), list[int]()
        for k, (at, each) in enumerate(zip(*every, strict=True)):
            knots = [0.0, *drive.knots(at, each).tolist(), each] if each > 0 else [0.0, each]
            begins += [at + a for a in knots[:-1]]
            lengths += np.diff(knots).tolist()
            number += [k] * (len(knots) - 1)
        made = self._made(begins, np.array(lengths), held)
        first = np.searchsorted(number, np.arange(size))
        last = np.searchsorted(number, np.arange(size), side="right")
        found = Maps(*(np.array(each[first]) for each in made))
        for k in np.flatnonzero(last - first > 1).tolist():
            for j in range(first[k] + 1, last[k]):
                _follow(found, k, Maps(*(each[j] for each in made)))
        return found

    def noise(self, s: Vector, held: Contacts, intensity: tuple[float, ...]) -> Array:
        """Roots of the covariance that white accelerations add in flights of ``s`` seconds.

        Args:
            s: shape (K,), not negative.
            held: contacts that stay closed.
            intensity: of the accelerations of the coordinates, m/s^1.5, length n.

        Returns:
            Shape (K, 2n, 2n).
        """
        terms, doubled = self._noisy(held, intensity)
        exponential, d = self.phase(held).flow.exponential, 2 * self.n
        turns = np.trunc(s / exponential.step)
        within = np.vander(s / exponential.step - turns, TERMS, increasing=True)
        Q = np.asarray(np.einsum("kt,tij->kij", within, terms))
        left, k = turns.astype(np.int64), 0
        while left.any():
            if (odd := left % 2 == 1).any():
                Phi = exponential.doubled(1, k)[:d, :d]
                Q[odd] = Phi @ Q[odd] @ Phi.T + doubled(k)
            left, k = left // 2, k + 1
        values, vectors = np.linalg.eigh(Q)
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])

    def gaps(self, contacts: Contacts) -> GuardRows:
        """The gaps of ``contacts``, m."""
        W, own = self.system.W[:, list(contacts)].T, list(contacts)
        slopes = np.zeros((len(own), self.p, 2 * self.n)), self.family.gap_changes[:, own].T
        return GuardRows(np.hstack([W, np.zeros_like(W)]), self._numbers.gap[own], *slopes)

    def impact(self, x: Array, pressed: Contacts) -> Flown:
        """Newton's law on exactly the contacts ``pressed``, from states (..., 2n)."""
        n = self.n
        W = self.system.W[:, list(pressed)].T
        X, by_mass = self._stops(pressed)
        gamma = x[..., n:] @ W.T
        laws = [self._laws[i] for i in pressed]
        rebound, slope = np.empty_like(gamma), np.empty_like(gamma)
        Phi = np.zeros((*x.shape, 2 * n))
        Phi[..., :, :] = np.eye(2 * n)
        Gamma = np.zeros((*x.shape, self.p))
        for k, law in enumerate(laws):
            rebound[..., k] = law.rebound(gamma[..., k])
            slope[..., k] = law.slope(gamma[..., k])
        lost = gamma + rebound
        after = np.array(x)
        after[..., n:] -= lost @ X.T
        Phi[..., n:, n:] -= (X * (1 + slope)[..., None, :]) @ W
        for j, effect in enumerate(self._effects):
            if j in by_mass:
                Gamma[..., n:, j] = lost @ by_mass[j].T
            for k, (law, i) in enumerate(zip(laws, pressed, strict=True)):
                own = effect.rebound[i, : len(law.units)]
                if np.any(own):
                    by = law.sensitivity(gamma[..., k])
                    Gamma[..., n:, j] -= (by @ own)[..., None] * X[:, k]
        return Flown(after, Phi, Gamma)

    def rest(self, x: Array, held: Contacts) -> Flown:
        """States (..., 2n) with the speeds of ``held`` contacts zero, as masses would have it."""
        n, inverse = self.n, self.phase(held).inverse
        keep = inverse @ self.system.M
        Phi = np.zeros((*x.shape, 2 * n))
        Phi[..., :, :] = np.eye(2 * n)
        Phi[..., n:, n:] = keep
        after = np.array(x)
        after[..., n:] = x[..., n:] @ keep.T
        Gamma = np.zeros((*x.shape, self.p))
        for j, effect in enumerate(self._effects):
            if np.any(effect.M):
                Gamma[..., n:, j] = (x - after)[..., n:] @ (inverse @ effect.M).T
        return Flown(after, Phi, Gamma)

    def stops(self, pressed: Contacts) -> Matrix:
        """``X`` of ``u+ = u- - X gamma-``, which stops the contacts ``pressed``, shape (n, k)."""
        return self._stops(pressed)[0]

    def _made(self, starts: Sequence[Elapsed], s: Vector, held: Contacts) -> Maps:
        """Return flights without a knot within; see ``flights``."""
        flow, p, d, K = self.phase(held).flow, self.p, 2 * self.n, max(len(starts), s.size)
        size, waves = len(flow.exponential.A), self._waves(held)
        exponential, places = self._extended(held)
        Phi, drift = np.empty((K, d, d)), np.empty((K, d))
        phi_slopes, drift_slopes = np.zeros((K, p, d, d)), np.zeros((K, p, d))
        t, y = np.array(starts)[:, None, None], flow.drive.at_each(starts)[..., None]
        often, whole = max(_AT_ONCE // exponential.A.size, 1), slice(None)
        for some in (slice(k, k + often) for k in range(0, K, often)):
            of_t, of_s = (some if len(each) > 1 else whole for each in (starts, s))
            E, driven = exponential.matrices(s[of_s]), y[of_t]
            Phi[some], drift[some] = E[:, :d, :d], (E[:, :d, d:size] @ driven)[..., 0]
            for j, (own, late) in places.items():
                phi_slopes[some, j] = E[:, own, :d]
                drift_slopes[some, j] = (E[:, own, d:size] @ driven)[..., 0]
                if late.stop > late.start:
                    turned = self._turned(j) @ driven[:, waves] * t[of_t]
                    drift_slopes[some, j] += (E[:, own, late] @ turned)[..., 0]
        return Maps(Phi, drift, phi_slopes, drift_slopes)

    def _driven(self, t: Sequence[float], held: Contacts) -> Matrix:
        """Return ``y`` at instants, shape (K, e)."""
        return self.phase(held).flow.drive.at_each([elapsed(each) for each in t])

    def _waves(self, held: Contacts) -> slice:
        """The cosines and sines of the harmonics within ``y``."""
        h, s = self._numbers.frequency.size, self.system.forcing.squares
        last = len(self.phase(held).flow.drive.Y) - 1 - (0 if s is None else len(s.force))
        return slice(last - 2 * h, last)

    def _turned(self, j: int) -> Matrix:
        """Derivative of cosines and sines by a parameter, per second, as a matrix (2h, 2h)."""
        tuned = np.diag(self._effects[j].frequency)
        return np.block([[np.zeros_like(tuned), -tuned], [tuned, np.zeros_like(tuned)]])

    def _pushes(self, held: Contacts) -> dict[int, Matrix]:
        """Derivatives of the accelerations by each parameter that moves, shape (n, N)."""
        phase, n, d = self.phase(held), self.n, 2 * self.n
        A, waves, found = phase.flow.exponential.A, self._waves(held), {}
        _, by = self.family.harmonics(self._numbers)
        for j in self._moving:
            effect = self._effects[j]
            pull = -effect.M @ A[n:d]
            pull[:, :d] -= np.hstack([effect.K, effect.C])
            pull[:, d:][:, waves] += np.hstack([by[j].real.T, -by[j].imag.T])
            pull[:, -1] += effect.constant
            found[j] = phase.inverse @ pull
        return found

    def _extended_of(self, held: Contacts) -> tuple[Exponential, dict[int, tuple[slice, slice]]]:
        """Return the exponential of ``z`` and all derivatives; rows of ``w`` and ``v`` of each."""
        flow, n, d = self.phase(held).flow, self.n, 2 * self.n
        A, waves = flow.exponential.A, self._waves(held)
        own, places, size = slice(d + waves.start, d + waves.stop), {}, len(flow.exponential.A)
        for j in self._moving:
            turns = waves.stop - waves.start if np.any(self._effects[j].frequency) else 0
            places[j] = slice(size, size + d), slice(size + d, size + d + turns)
            size += d + turns
        E = np.zeros((size, size))
        E[: len(A), : len(A)] = A
        for j, push in self._pushes(held).items():
            w, v = places[j]
            E[w, w], E[w.start + n : w.stop, : len(A)] = A[:d, :d], push
            if v.stop > v.start:
                E[w, v], E[v, v], E[v, own] = A[:d, own], A[own, own], self._turned(j)
        return Exponential(E, flow.exponential.rate), places

    def _noise_of(
        self, held: Contacts, intensity: tuple[float, ...]
    ) -> tuple[Array, Callable[[int], Matrix]]:
        """Return the covariance Q of white accelerations, ``Q' = A Q + Q A' + B B'``.

        Its Taylor terms in a step have shape (TERMS, 2n, 2n); then that of ``2^k`` steps, shape
        (2n, 2n), as a function of ``k``.
        """
        phase, n, d = self.phase(held), self.n, 2 * self.n
        exponential = phase.flow.exponential
        rates = exponential.A[:d, :d] * exponential.step
        root = (phase.inverse @ self.system.M) * np.array(intensity)
        terms = np.zeros((TERMS, d, d))
        terms[1, n:, n:] = root @ root.T * exponential.step
        for k in range(2, TERMS):
            grown = rates @ terms[k - 1] / k
            terms[k] = grown + grown.T

        @lru_cache(KEPT)
        def doubled(k: int) -> Matrix:
            if not k:
                return np.asarray(terms.sum(axis=0))
            Phi, half = exponential.doubled(1, k - 1)[:d, :d], doubled(k - 1)
            return np.asarray(Phi @ half @ Phi.T + half)

        return terms, doubled

    def _stops_of(self, pressed: Contacts) -> tuple[Matrix, dict[int, Matrix]]:
        """Return ``X`` of ``u+ = u- - X gamma-`` (n, k), and ``-dX`` by parameters of masses."""
        X = self.newton.stops(pressed)
        effects = {j: each.M for j, each in enumerate(self._effects) if np.any(each.M)}
        inverse = self.phase(pressed).inverse if effects else np.zeros((0, 0))
        return X, {j: inverse @ M @ X for j, M in effects.items()}


def _follow(maps: Maps, k: int, after: Maps) -> None:
    """Replace the ``k``-th of ``maps`` by itself and then the map ``after``, in place."""
    maps.drift_slopes[k] = (
        after.phi_slopes @ maps.drift[k] + maps.drift_slopes[k] @ after.Phi.T + after.drift_slopes
    )
    maps.phi_slopes[k] = after.phi_slopes @ maps.Phi[k] + after.Phi @ maps.phi_slopes[k]
    maps.drift[k] = after.Phi @ maps.drift[k] + after.drift
    maps.Phi[k] = after.Phi @ maps.Phi[k]
