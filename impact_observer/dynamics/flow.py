# SPDX-License-Identifier: Apache-2.0
"""Flow of a linear phase by the exponential of one augmented matrix.

The state and all that drives the state obey one equation, ``dz/dt = A z``, with ::

    z = (p, u, y),    y = (samples, cos w_k t, sin w_k t, squares, 1)

The samples are the sampled forces and those of their time derivatives that are not zero; between
two samples the derivatives are constant. Squares are the signs of square waves, constant between
two switches. Loads of held contacts are eliminated::

    dp/dt = u,    du/dt = P M^-1 (f - C u - K p),    P = I - M^-1 W (W^T M^-1 W)^-1 W^T

A motion is computed in windows of steps from the start of the phase, so that states do not depend
on the requested instants, to the bit. At the start of each window ``y`` is computed anew from the
time, and ``W^T u = 0`` and the gaps of held contacts are restored, so that rounding does not grow.
"""

from abc import abstractmethod
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.equations import Equations
from impact_observer.dynamics.exponential import (
    STEPS,
    TERMS,
    Exponential,
    polynomials,
)
from impact_observer.dynamics.roots import Steps
from impact_observer.errors import DynamicsError
from impact_observer.model import Forcing
from impact_observer.model.angles import Angles
from impact_observer.model.force_samples import JETS
from impact_observer.model.live_signals import LiveSamples
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

_NOTHING = 1e-15
"""Acceleration that the loads leave and that is rounding, relative to the terms of its sum."""
_MOST_WINDOWS = 1_000_000
"""Windows of one motion that count as endless."""
_FAR = 10_000
"""Windows after which a state is not computed window by window."""
_RECENT = 4
"""Windows whose steps are kept; the others are computed anew when they are asked for."""


class Motion(Protocol):
    """One solution of a linear phase, from its initial state.

    Attributes:
        t: start of the phase, s since the epoch.
    """

    t: float

    @abstractmethod
    def states(self, s: NDArray[np.float64], /) -> NDArray[np.float64]:
        """States (q, u) at ``s`` seconds after the start: (samples,) gives (samples, 2n)."""

    def state(self, s: float, /) -> Vector:
        """The state (q, u), shape (2n,), at ``s`` seconds after the start."""
        return np.asarray(self.states(np.array([s]))[0])


class Drive:
    """The functions of time ``y(t)`` that drive a linear phase, and their generator.

    Attributes:
        Y: ``dy/dt = Y y`` between two samples or switches, shape (e, e), 1/s.
        F: ``f = F y``, shape (n, e), N or Nm.
        fastest: the largest angular frequency, rad/s.
    """

    def __init__(self, forcing: Forcing) -> None:
        """Order the parts of ``forcing``."""
        n, h = forcing.constant.size, forcing.frequency.size
        self._samples, self._angles = forcing.sampled, Angles(forcing.frequency)
        self._squares = forcing.squares
        pushes = np.zeros((0, n)) if forcing.squares is None else forcing.squares.force
        self._active = np.zeros(0, dtype=np.intp)
        orders = 0
        if forcing.sampled is not None:
            self._active = np.flatnonzero(forcing.sampled.drives)
            used = np.any(forcing.sampled.jets != 0, axis=(1, 2))
            is_live = isinstance(forcing.sampled, LiveSamples)
            orders = JETS if is_live else int(np.max(np.flatnonzero(used), initial=-1)) + 1
        d = self._active.size
        self._shape = (orders, d)
        first = orders * d
        e = first + 2 * h + len(pushes) + 1
        self.Y, self.F = np.zeros((e, e)), np.zeros((n, e))
        self.F[self._active, np.arange(d)] = 1.0
        self.Y[: first - d, d:first] += np.eye(first - d)
        rows = first + np.arange(h)
        self.Y[rows, rows + h], self.Y[rows + h, rows] = -forcing.frequency, forcing.frequency
        self.F[:, first : first + h] = forcing.cosine.T
        self.F[:, first + h : first + 2 * h] = forcing.sine.T
        self.F[:, first + 2 * h : -1] = pushes.T
        self.F[:, -1] = forcing.constant
        self.fastest = forcing.fastest

    def at_each(self, t: Sequence[Elapsed]) -> Matrix:
        """``y`` at K instants, after a sample or switch at one of them, shape (K, e).

        Raises:
            DynamicsError: one of ``t`` lies before the first sample.
        """
        ns = np.array([each.ns for each in t], dtype=np.int64)
        rest = np.array([each.remainder for each in t])
        angle = self._angles.at_stamps(ns) + np.outer(rest, self._angles.frequency)
        parts = [np.cos(angle), np.sin(angle), np.ones((len(t), 1))]
        if self._squares is not None:
            parts.insert(2, np.array([self._squares.signs(each) for each in t]))
        if self._samples is not None:
            instants = np.array([float(each) for each in t])
            jets = self._samples.derivatives(instants)[: self._shape[0], :, self._active]
            parts.insert(0, jets.swapaxes(0, 1).reshape(len(t), -1))
        return np.hstack(parts)

    def check(self, t: Elapsed) -> None:
        """Check that there is a sample at ``t``, if there are samples.

        Raises:
            DynamicsError: ``t`` lies before the first sample.
        """
        if self._samples is not None:
            self._samples.check(float(t))

    def knots(self, t: Elapsed, duration: float) -> Vector:
        """Samples and switches within ``duration`` after ``t``, s since ``t``.

        Of each square wave at most as many as a window has steps.
        """
        knots, now = np.zeros(0), float(t)
        if self._samples is not None:
            knots = np.asarray(self._samples.knots(now, now + duration) - now)
        if self._squares is None:
            return knots
        return np.union1d(knots, self._squares.switches(t, duration, STEPS))

    @property
    def is_smooth(self) -> bool:
        """Whether the forces have no samples and no switches."""
        return self._samples is None and self._squares is None

    def final_until(self, t: Elapsed) -> float:
        """Time after ``t`` until which the samples are known for good, s; mostly infinity."""
        if not isinstance(self._samples, LiveSamples):
            return np.inf
        return self._samples.newest - float(t)

    @property
    def changes(self) -> int:
        """Number of changes of the samples up to now."""
        return self._samples.changes if isinstance(self._samples, LiveSamples) else 0

    def changed_since(self, changes: int, t: Elapsed) -> float:
        """Time after ``t`` from which on samples differ since so many ``changes``, s."""
        assert isinstance(self._samples, LiveSamples), "no other samples change"
        return self._samples.changed_since(changes) - float(t)


class Flow:
    """The flow of one linear phase; what a use needs is prepared at this use."""

    def __init__(
        self,
        equations: Equations,
        rate: float,
        held: Matrix | None = None,
        Q: Matrix | None = None,
        rest: Vector | None = None,
    ) -> None:
        """Describe the phase.

        Args:
            equations: the equations of motion of ``p`` without loads.
            rate: bound of the rates of the motion, rad/s; see ``rate_of``.
            held: directions ``W`` of the held contacts, independent, shape (n, k).
            Q: ``q = Q p + rest``, shape (n, n); None where ``p`` is ``q``.
            rest: shape (n,), m.
        """
        self.n = equations.n
        self._equations, self._rate = equations, rate
        self._held = held if held is not None and held.size else None
        self._Q, self._rest = Q, rest

    @cached_property
    def drive(self) -> Drive:
        """The forcing as functions of time."""
        return Drive(self._equations.forcing)

    @cached_property
    def _lift(self) -> Matrix:
        """``M^-1 W (W^T M^-1 W)^-1`` of the held contacts, shape (n, k)."""
        assert self._held is not None, "contacts are held"
        Minv_W = linalg.solve(self._equations.M, self._held, assume_a="pos")
        return np.asarray(Minv_W @ linalg.pinvh(self._held.T @ Minv_W))

    @cached_property
    def exponential(self) -> Exponential:
        """The exponential of the augmented matrix."""
        equations, n, Y = self._equations, self.n, self.drive.Y
        pulls = np.hstack([-equations.K, -equations.C, self.drive.F])
        accelerations = linalg.solve(equations.M, pulls, assume_a="pos")
        if self._held is not None:
            accelerations = self._eliminated(accelerations)
        A = np.zeros((2 * n + len(Y), 2 * n + len(Y)))
        A[:n, n : 2 * n] = np.eye(n)
        A[n : 2 * n], A[2 * n :, 2 * n :] = accelerations, Y
        return Exponential(A, max(self._rate, self.drive.fastest))

    def _eliminated(self, accelerations: Matrix) -> Matrix:
        """``P accelerations``, shape (n, N), without what is rounding only."""
        assert self._held is not None, "contacts are held"
        left, size = accelerations, np.abs(accelerations)
        for _ in range(2):  # twice against rounding
            left = left - self._lift @ (self._held.T @ left)
        size = size + np.abs(self._lift) @ np.abs(self._held.T) @ size
        return np.where(np.abs(left) <= _NOTHING * size, 0.0, left)

    @cached_property
    def lengths(self) -> Vector:
        """Lengths of the steps of a window without samples, shape (steps,), s."""
        lengths: Vector = np.full(self.exponential.steps, self.exponential.step)
        return lengths

    @cached_property
    def times(self) -> Vector:
        """Starts of the steps of such a window, since its start, shape (steps,), s."""
        return np.arange(self.exponential.steps, dtype=np.float64) * self.exponential.step

    @cached_property
    def _states(self) -> Matrix:
        """Taylor coefficients of (q, u), shape (TERMS 2n, N)."""
        n = self.n
        rows = self.exponential.terms[:, : 2 * n]
        if self._Q is not None and self._rest is not None:
            outputs = np.eye(2 * n, len(self.exponential.A))
            outputs[:n, :n], outputs[:n, -1] = self._Q, self._rest
            rows = self.exponential.rows(outputs)
        return np.ascontiguousarray(rows.reshape(TERMS * 2 * n, -1))

    @cached_property
    def _powers(self) -> Matrix:
        powers = self.exponential.powers
        return np.ascontiguousarray(powers.reshape(-1, powers.shape[-1]))

    def start(self, t: float, x: Vector) -> "PhaseMotion":
        """The motion through the state ``x`` = (q, u), shape (2n,), at ``t`` s since the epoch.

        Raises:
            DynamicsError: the forcing has no sample at ``t``.
        """
        return PhaseMotion(self, t, x)

    def transition(self, s: float) -> Matrix:
        """Propagate the difference of two motions by ``s`` seconds, which may be negative.

        Returns:
            ``e^{As}`` of (q, u), shape (2n, 2n).
        """
        return np.asarray(self.transitions(np.array([s]))[0])

    def transitions(self, s: Vector) -> NDArray[np.float64]:
        """``transition`` by many times of any sign, shape (K,), s: shape (K, 2n, 2n)."""
        n = self.n
        moved = self.exponential.matrices(s)[:, : 2 * n, : 2 * n]
        if self._held is not None:
            moved[..., n:] -= (moved[..., n:] @ self._lift) @ self._held.T
        if self._Q is not None:
            moved[:, :n] = self._Q @ moved[:, :n]
        return moved

    def restore(self, z: Vector, gaps: Vector | None) -> None:
        """Bring the held contacts in ``z``, shape (N,), to rest at ``W^T p = gaps``."""
        if self._held is None or gaps is None:
            return
        n = self.n
        z[n : 2 * n] -= self._lift @ (self._held.T @ z[n : 2 * n])
        z[:n] += self._lift @ (gaps - self._held.T @ z[:n])

    def gaps(self, p: Vector) -> Vector | None:
        """``W^T p`` of the held contacts; None without any."""
        return None if self._held is None else np.asarray(self._held.T @ p)

    def stepped(self, z: Vector) -> Matrix:
        """States after 0, 1, 2, .. steps from ``z``, shape (steps + 1, N)."""
        return np.asarray(self._powers.dot(z).reshape(-1, z.size))

    def moved(self, z: Vector, length: float) -> Vector:
        """The state ``length`` seconds after ``z``, shape (N,)."""
        return np.asarray(self.exponential.between(length).dot(z))

    def polynomials_of(self, z: Matrix) -> NDArray[np.float64]:
        """Taylor coefficients of (q, u) from states ``z``, (steps, N): (TERMS, 2n, steps)."""
        c = np.matmul(self._states, z[:, :, None]).reshape(len(z), TERMS, 2 * self.n)
        return np.asarray(c.transpose(1, 2, 0))


class PhaseMotion(Motion):
    """One motion of a linear phase, computed window after window.

    Attributes:
        t: start of the phase, s since the epoch.
    """

    def __init__(self, flow: Flow, t: float, x: Vector) -> None:
        """Start from ``x`` = (p, u), shape (2n,), at ``t``."""
        self.t = t
        self._flow = flow
        self._start = t if isinstance(t, Elapsed) else Elapsed(0, 0.0) + float(t)
        self._gaps = flow.gaps(x[: flow.n])
        flow.drive.check(self._start)
        self._starts = [np.concatenate([x, np.zeros(len(flow.drive.Y))])]
        self._ends: list[float] = []
        self._recent: dict[int, Steps] = {}
        self._changes = flow.drive.changes

    def window(self, number: int) -> Steps:
        """The steps of a window; windows are numbered from 0."""
        if self._changes != self._flow.drive.changes:
            self._forget()
        while len(self._ends) <= number:
            if len(self._ends) >= _MOST_WINDOWS:
                raise DynamicsError(
                    f"a motion from t = {self.t:.9g} s: no end after {_MOST_WINDOWS} windows"
                )
            steps, after = self._steps(len(self._ends))
            self._keep(len(self._ends), steps)
            self._starts.append(after)
            self._ends.append(steps.end)
        if number not in self._recent:
            self._keep(number, self._steps(number)[0])
        return self._recent[number]

    def _keep(self, number: int, steps: Steps) -> None:
        """Keep the steps of a window, and drop the oldest ones."""
        if len(self._recent) >= _RECENT:
            del self._recent[next(iter(self._recent))]
        self._recent[number] = steps

    def _forget(self) -> None:
        """Forget the windows in which samples have changed."""
        drive = self._flow.drive
        since = drive.changed_since(self._changes, self._start)
        first = bisect_left(self._ends, since)
        del self._starts[first + 1 :], self._ends[first:]
        self._recent, self._changes = {}, drive.changes

    @property
    def final_until(self) -> float:
        """Time since the start until which all forces are known for good, s."""
        return self._flow.drive.final_until(self._start)

    def _steps(self, number: int) -> tuple[Steps, Vector]:
        """The steps of a window, and the state at the end, shape (N,)."""
        flow, drive = self._flow, self._flow.drive
        step, count = flow.exponential.step, flow.exponential.steps
        start = self._ends[number - 1] if number else 0.0
        now = self._start + start
        z = self._starts[number].copy()
        z[2 * flow.n :] = drive.at_each([now])[0]
        flow.restore(z, self._gaps)
        knots = drive.knots(now, count * step)
        if not knots.size:
            moved = flow.stepped(z)
            end = start + count * step
            times = start + flow.times
            return Steps(times, flow.lengths, moved[:-1], end, True), moved[-1]
        times_, states, at = [0.0], [z], 0.0
        for knot in [*knots.tolist(), np.inf]:
            while len(states) <= count and at < knot:
                length = min(step, knot - at)
                z = flow.moved(z, length)
                at = knot if length < step else at + step
                if at >= knot:
                    z[2 * flow.n :] = drive.at_each([now + at])[0]
                times_.append(at)
                states.append(z)
        starts, end = start + np.array(times_[:-1]), start + times_[-1]
        lengths: Vector = np.diff(times_)
        return Steps(starts, lengths, np.array(states[:-1]), end, False), states[-1]

    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """States (q, u) at ``s`` seconds after the start, shape (samples,): (samples, 2n)."""
        last = float(np.max(s, initial=0.0))
        if last > self._far:
            return np.array(
                [self._far_state(at) if at > self._far else self.state(at) for at in s]
            )
        self.window(0)
        while self._ends[-1] <= last:
            self.window(len(self._ends))
        if s.size == 1:
            return self._states_in(bisect_right(self._ends, last), s)
        found = np.empty((s.size, 2 * self._flow.n))
        which = np.searchsorted(self._ends, s, side="right")
        for k in range(int(which.min(initial=0)), int(which.max(initial=-1)) + 1):
            mine = which == k
            found[mine] = self._states_in(k, s[mine])
        return found

    @cached_property
    def _far(self) -> float:
        """Time after which states are computed by one exponential, if there are no samples, s."""
        exponential = self._flow.exponential
        return (
            _FAR * exponential.steps * exponential.step if self._flow.drive.is_smooth else np.inf
        )

    def _far_state(self, s: float) -> Vector:
        """The state (q, u), shape (2n,), after a long time."""
        z = self._flow.exponential.matrix(s) @ self.window(0).z[0]
        return self._flow.polynomials_of(z[None])[0, :, 0]

    def _states_in(self, number: int, s: Vector) -> Matrix:
        """States (q, u) at ``s`` seconds after the start, all in one window."""
        steps, flow = self.window(number), self._flow
        j = np.maximum(np.searchsorted(steps.start, s, side="right") - 1, 0)
        x = (s - steps.start[j]) / flow.exponential.step
        if s.size < len(steps.z):
            return np.asarray(polynomials(flow.polynomials_of(steps.z[j]), x).T)
        return np.asarray(polynomials(flow.polynomials_of(steps.z), x, j).T)


def rate_of(fastest: float, damping: float) -> float:
    """Bound of the rates of ``M du/dt = -C u - K q``, rad/s.

    An eigenvalue obeys ``l^2 + c l + k = 0`` with ``|c|`` at most ``damping``, the norm of
    ``L^-1 C L^-T``, and ``k`` at most ``fastest^2``.
    """
    return (damping + float(np.hypot(damping, 2 * fastest))) / 2
