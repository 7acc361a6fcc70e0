# SPDX-License-Identifier: Apache-2.0
"""The motion through the moments of an account, linearised about a path.

At each moment the chain's vector is ``z = (e, x, constants)``: the jump comes ``e`` seconds before
an instant ``T`` of the path, and the state at ``T`` would be ``x`` without the jump; constants are
what no flight changes. Between two instants the state moves by an affine map, whatever the path.
At a moment the guard and the jump are functions of ``(e, x)``. They are linearised about the
path's state at ``T`` (docs/theory/filter.md). A reported stamp is the instant ``T - e`` and a
normal error; the instant of an inserted moment is the root of the guard.
"""

from collections.abc import Sequence
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow import Motion
from impact_observer.errors import DynamicsError
from impact_observer.events import Contacts
from impact_observer.filter.error_accounts import ErrorAccounts
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.joint import Joint
from impact_observer.filter.linear import LinearPrediction
from impact_observer.filter.model_error import ErrorKind
from impact_observer.filter.process_noise import with_noise
from impact_observer.filter.resting import rest_measurement
from impact_observer.filter.robot_members import RobotMembers
from impact_observer.filter.robot_motion import RobotMotion
from impact_observer.filter.saltation import STATE_ROUNDING
from impact_observer.filter.square_root import triangular
from impact_observer.kernel._kernel import TINY
from impact_observer.model.system import LARGEST_STATE
from impact_observer.smooth.account import Moment
from impact_observer.smooth.chain import Normal, Step
from impact_observer.states import Matrix, Vector
from impact_observer.trajectory.linearised_robot import LinearisedRobot
from impact_observer.trajectory.linearised_system import FlightEnd, LinearisedSystem, TangentMap

IMPOSSIBLE = -1e4
"""Logarithm of a probability that counts as none."""
_ROUNDED = 1e-13
"""Rounding of a state of the path, relative to the state's size."""


def followed(x: Vector) -> Vector:
    """The state ``x`` = (q, u), shape (2n,).

    Raises:
        DynamicsError: a coordinate or velocity is larger than any that is accepted of a user.
    """
    if not np.max(np.abs(x)) <= LARGEST_STATE:
        raise DynamicsError(
            f"the motion through the events grows beyond {LARGEST_STATE:g} m or m/s"
        )
    return x


class Path(NamedTuple):
    """The path about which the motion is linearised.

    Attributes:
        start: first state (q, u), shape (2n,).
        early: by how much each instant is before the stamp of its moment, s, shape (k,).
        x: states (q, u) just before, as if without the jump, shape (k, 2n).
        doubt: standard deviations of the gap of a contact that hits then, m, shape (k,).
        constants: parameters and clock offset, shape (c,).
        roots: of the covariance of (e, x, constants) at each moment, lower triangular, shape
            (k, d, d): how far from the path the motion is, for what is not linear; None to leave
            that out.
    """

    start: Vector
    early: Vector
    x: Matrix
    doubt: Vector
    constants: Vector
    roots: NDArray[np.float64] | None = None


class Linearised:
    """The flights and jumps of a recording as linear functions near a path.

    Attributes:
        moments: of the account.
        first: prior of the state at the start.
        filter: the filter of the system.
    """

    def __init__(
        self, filter_: ImpactFilter, t: float, first: GaussianState, moments: Sequence[Moment]
    ) -> None:
        """The state ``first`` holds at ``t``, s since the epoch; no contact is closed then."""
        self.moments = moments
        self.first = Normal(np.append(first.x, first.constants), first.root)
        self.filter, self._members, self._t = filter_, filter_.members, t
        self._state, self._p = first, first.parameters
        self._size, self._count = first.x.size, first.constants.size
        self._sizes = filter_.scales.sizes
        self._diffusion = filter_.members.given.moving.diffusion
        self._systems = lru_cache(2)(self._system_at)
        self._flown: tuple[Path | None, dict[int, Motion]] = (None, {})
        self._latest: tuple[Path | None, int, tuple[TangentMap, Vector] | None] = (None, -1, None)

    @cached_property
    def _errors(self) -> ErrorAccounts:
        """Errors of the model, which robots do not learn."""
        return ErrorAccounts(self.filter, (0.0,))

    def instant(self, path: Path, k: int) -> float:
        """The ``k``-th instant of a path, s since the epoch; -1 for the start."""
        return self._t if k < 0 else self.moments[k].change.t - float(path.early[k])

    def closed_after(self, k: int) -> Contacts:
        """Contacts that are closed after the ``k``-th moment; -1 for the start."""
        return () if k < 0 else self.moments[k].change.closed

    def rests(self, k: int) -> bool:
        """Whether contacts are at rest after the ``k``-th moment, which measures their gaps."""
        return bool(self.closed_after(k))

    def system_of(self, path: Path) -> LinearisedSystem | LinearisedRobot:
        """The system with the parameters of a path."""
        return self._systems(tuple(path.constants[: self._p].tolist()))

    def _system_at(self, theta: tuple[float, ...]) -> LinearisedSystem | LinearisedRobot:
        members = self._members
        if isinstance(members, RobotMembers):
            return LinearisedRobot(
                members.family, np.array(theta), members.motion(np.array(theta))
            )
        return LinearisedSystem(
            members.family, np.array(theta), None if theta else members.given.moving
        )

    def noise_after(self, k: int) -> float:
        """White noise of the accelerations in the flight after the ``k``-th moment, m/s^1.5."""
        is_last = k + 1 == len(self.moments)
        level = 0.0 if is_last else level_of(self.moments[k + 1], ErrorKind.ACCELERATION)
        return self.filter.noise_of(level)

    def log_slope(self, path: Path, k: int) -> float:
        """Logarithm of the factor from densities of guards to densities of instants, at a moment.

        Returns 0 if the moment has no measurement. A contact that separates cannot hit.
        """
        return self._log_slope(k, self._guard(path, k))

    def _log_slope(self, k: int, guard: Step) -> float:
        if self.moments[k].is_inserted or not guard.y.size:
            return 0.0
        slopes = guard.H[:, 0]
        if self.moments[k].change.hit and np.any(slopes <= 0):
            return IMPOSSIBLE
        return float(np.sum(np.log(np.abs(slopes) + TINY)))

    def moved_before(self, path: Path, k: int, x: Vector, s: float) -> Vector:
        """The state ``x`` before the ``k``-th moment, ``s`` seconds after the path's instant."""
        closed = self.moments[k].change.before
        return self.system_of(path).moving.moved(self.instant(path, k), x, s, closed)[0]

    def gap_deviation(self, k: int, x: Vector, root: Matrix) -> float:
        """Standard deviation of the gap of the contact that hits at the ``k``-th moment, m.

        ``root`` is of (q, u, constants) at the state ``x``. Returns 0 if no contact hits.
        """
        hit = self.moments[k].change.hit
        return self.filter.gap_deviation(hit[0], x, root) if hit else 0.0

    def rounding(self, x: Vector) -> Vector:
        """How far state and constants may differ by rounding, shape (2n + c,)."""
        return np.append(_ROUNDED * self._sizes(x), np.full(self._count, TINY))

    def left(self, path: Path, k: int) -> Step:
        """From the chain's vector at the ``k``-th moment to (x, constants) just after it."""
        if k < 0:
            return Step.unmeasured(
                np.eye(self._size + self._count), np.zeros(len(self.first.mean))
            )
        return self._projection(path, k) if self.rests(k) else self._jump(path, k)

    def flight(
        self, path: Path, k: int, end: float, since: float | None = None, *, noisy: bool = True
    ) -> Step:
        """From just after the ``k``-th moment, or ``since`` later, to the ``end``.

        Both are s since the epoch; no contact switches.
        """
        closed, x = self.closed_after(k), self._state_at(path, k, since)
        t = self.instant(path, k) if since is None else since
        s = end - t
        A, b = self._affine(self.system_of(path).flow(t, x, s, closed), x, path)
        noise = self.noise_after(k) if noisy else 0.0
        root = np.zeros((len(A), 0))
        if self._members.moving and (about := self._spread(path, k)):
            jump = self._jump(path, k).A
            left = self.left(path, k).A @ jump if self.rests(k) else jump
            root = left @ about.root
            state = GaussianState(x, path.constants, root, about.differences[1:], closed, self._p)
            bent = LinearPrediction(t, state, self._members, 0.0).remainder(s)
            root = np.pad(bent, ((0, self._count), (0, 0)))
        root = with_noise(root, self._size, noise, partial(self._diffusion, t, x, closed), s)
        return Step.unmeasured(A, b, root)

    def resting(self, path: Path, k: int) -> Step:
        """The jump at the ``k``-th moment, and the measurement that closed contacts rest.

        A contact that still chatters is not measured: the account closes the contact too early.
        """
        change, x, system = self.moments[k].change, self._jumped(path, k), self.system_of(path)
        new = tuple(i for i in change.closed if i not in change.before)
        new = () if self.moments[k].until else new
        pressing = system.moving.rate_of(self.instant(path, k), x, change.before)
        short = self.filter.conditioning.short * self.filter.near(x).contact_speed(
            pressing[x.size // 2 :]
        )
        d = self._size + self._count
        nothing = np.zeros((d, 0))
        near = GaussianState(x, path.constants, nothing, nothing, change.closed, self._p)
        rest = rest_measurement(self._members, near, new, short[list(new)])
        jump, y = self._jump(path, k), rest.H @ np.append(x, path.constants) - rest.value
        return jump._replace(H=rest.H, y=y, V=np.diag(rest.floor))

    def _stamped(self, path: Path, k: int) -> Step:
        """From (x, constants) at the ``k``-th instant to (e, x, constants), with the stamp."""
        moment, d = self.moments[k], self._size + self._count
        A, b = np.vstack([np.zeros(d), np.eye(d)]), np.zeros(1 + d)
        guard = self._guard(path, k)
        if moment.is_inserted:
            H, value = guard.H[0], float(guard.y[0])
            A[0], b[0] = -H[1:] / H[0], value / H[0]
            noise = np.zeros((1 + d, guard.V.shape[1]))
            noise[0] = guard.V[0] / H[0]
            return Step.unmeasured(A, b, noise)
        b[0] = -float(path.early[k])
        if self._count > self._p:
            A[0, -1] = 1.0
        noise = np.zeros((1 + d, 1))
        noise[0] = moment.clock
        return guard._replace(A=A, b=b, N=noise, density=self._log_slope(k, guard))

    def _guard(self, path: Path, k: int) -> Step:
        """The measurement that the guards of the ``k``-th moment are zero."""
        change, x, system = self.moments[k].change, path.x[k], self.system_of(path)
        contacts = self.filter.conditioning.measured_contacts(change)
        d = 1 + self._size + self._count
        if self.moments[k].is_inserted:
            contacts = change.contacts[:1]
        if not contacts:
            return Step.unmeasured(np.eye(d), np.zeros(d))
        at = system.begin(self.instant(path, k), x)._replace(closed=change.before)
        guard = system.guard(at, contacts, hit=bool(change.hit))
        value, bend = guard.value, guard.bend
        H = np.zeros((len(contacts), d))
        H[:, 0], H[:, 1 : 1 + at.X.shape[1]] = -guard.rate, guard.rows
        floor = guard.measured.rounding(
            self._sizes(x) if change.hit else x, system.moving.forces(at.t)[0]
        )
        if self.moments[k].is_inserted:
            # Near grazing the acceleration decides the instant: s = sqrt(2 g / a), not g / gamma.
            # A gap that stands still tells no instant: its error stays one that can be followed.
            deviation = np.abs(value) + path.doubt[k]
            falling = np.sqrt(np.abs(bend) * deviation)
            least = (deviation + floor) / self.filter.conditioning.farthest(change)
            H[:, 0] = np.max([H[:, 0], falling, least], axis=0)
        y, noise = H[:, 1:] @ np.append(x, path.constants) - value, np.diag(floor)
        if about := self._spread(path, k):
            bent = self.filter.conditioning.guard_remainder(change, contacts, about)
            noise = np.hstack([bent, noise])
        return Step(np.eye(d), np.zeros(d), np.zeros((d, 0)), H, y, noise)

    def _spread(self, path: Path, k: int) -> Joint | None:
        """The ``k``-th moment of a path and how far from that the motion is; None if left out."""
        if path.roots is None or k < 0 or not self.moments[k].change.contacts:
            return None
        root, nothing = path.roots[k], np.zeros((len(path.roots[k]), 0))
        z = np.concatenate([[0.0], path.x[k], path.constants])
        return Joint(self.instant(path, k), z, root, nothing, self._size, self._p)

    def _jump(self, path: Path, k: int) -> Step:
        """From (e, x, constants) at the ``k``-th moment to (x, constants) just after it."""
        moment, x, (map_, xi) = self.moments[k], path.x[k], self._jump_of(path, k)
        change, size, d = moment.change, self._size, self._size + self._count
        A = np.zeros((d, 1 + d))
        A[:, 1:], b = self._affine(map_, x, path)
        A[:size, 0] = xi
        columns = [np.diag(STATE_ROUNDING * self._sizes(x, change.flown))]
        if about := self._spread(path, k):
            bent = self.filter.conditioning.jump_remainder(change, about)
            columns[0] = triangular(np.hstack([bent, columns[0]]))
        level = level_of(moment, ErrorKind.RESTITUTION)
        if level and change.hit and not change.closed:
            columns.append(level * self._errors.kicks(x, change.hit))
        noise = np.zeros((d, sum(each.shape[1] for each in columns)))
        noise[:size] = np.hstack(columns)
        return Step.unmeasured(A, b, noise)

    def _jump_of(self, path: Path, k: int) -> tuple[TangentMap, Vector]:
        """The jump at the ``k``-th moment, and the gain a second that it comes earlier."""
        about, which, known = self._latest
        if about is path and which == k and known is not None:
            return known
        change, x, system = self.moments[k].change, path.x[k], self.system_of(path)
        at = system.begin(self.instant(path, k), x)._replace(closed=change.before)
        end = FlightEnd(at.t, change.hit, system.pressed(change, x), change.closed)
        jump = system.jump(at, end, is_measured=True)
        self._latest = path, k, jump
        return jump

    def _jumped(self, path: Path, k: int) -> Vector:
        """The path's state just after the jump at the ``k``-th moment, (2n,)."""
        return self._jump_of(path, k)[0].x

    def _affine(self, map_: TangentMap, x: Vector, path: Path) -> tuple[Matrix, Vector]:
        """``map_`` of the path's state ``x`` as ``A z + b`` of (x, constants)."""
        size, d = self._size, self._size + self._count
        A, b = np.eye(d), np.zeros(d)
        A[:size, :size], A[:size, size : size + self._p] = map_.Phi, map_.Gamma
        b[:size] = map_.x - A[:size] @ np.append(x, path.constants)
        return A, b

    def _state_after(self, path: Path, k: int) -> Vector:
        """The path's state just after the ``k``-th moment, contacts at rest; -1 for the start."""
        if k < 0:
            return path.start
        x = self._jumped(path, k)
        return self._rested(path, k, x).x if self.rests(k) else x

    def _state_at(self, path: Path, k: int, since: float | None) -> Vector:
        """The path's state after the ``k``-th moment: just then, or at ``since``."""
        x = self._state_after(path, k)
        if since is None:
            return x
        t, moving = self.instant(path, k), self.system_of(path).moving
        if not isinstance(moving, RobotMotion):
            return moving.moved(t, x, since - t, self.closed_after(k))[0]
        if self._flown[0] is not path:
            self._flown = path, {}
        if k not in self._flown[1]:
            self._flown[1][k] = moving.motion(t, x, self.closed_after(k))
        return self._flown[1][k].state(since - t)

    def _projection(self, path: Path, k: int) -> Step:
        """From (x, constants) after the rest measurement to closed contacts exactly at rest."""
        x = self._jumped(path, k)
        return Step.unmeasured(*self._affine(self._rested(path, k, x), x, path))

    def _rested(self, path: Path, k: int, x: Vector) -> TangentMap:
        system, closed = self.system_of(path), self.closed_after(k)
        placed = system.on_stops(x, closed)
        return system.at_rest(placed.x, closed).preceded_by(placed)


def level_of(moment: Moment, kind: ErrorKind) -> float:
    """The level of one kind of model error at a moment."""
    return moment.error.level if moment.error.kind is kind else 0.0
