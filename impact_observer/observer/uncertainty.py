# SPDX-License-Identifier: Apache-2.0
"""The uncertainty that the user of an observer declares."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.model.contact_sensors import ContactErrors
from impact_observer.model.fit_verdict import NO_SHIFT, TimeShift
from impact_observer.observer.unknown_parameters import UnknownParameters
from impact_observer.options import Options, highest
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector, frozen

LARGEST_DEVIATION = 1e9
"""Most that a standard deviation of the initial state may be, SI units."""
_FAR_FROM_ONE = 30.0
"""Ratio to the default from which on another deviation is suggested."""
_ROUNDING = float(np.finfo(np.float64).eps)
"""Rounding of a state, relative to the sizes of its motion."""
_RIGID = 1e-12
"""Eigenvalue that counts as zero, relative to the largest."""
_LIMITED = "clock_error clock_offset_error model_error missed spurious mislabelled dead_time"
_SEED = 2014
"""Of the replicas' initial states: always the same, and not a seed that users give."""
_SYMMETRY = 1e-9
"""Asymmetry or negative eigenvalue of a covariance that is rounding, relative to its largest."""


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Errors of the initial state, the sensor and the model.

    Deviations are standard deviations. ``missed``, ``spurious`` and ``mislabelled`` are
    probabilities; where all are 0, and the dead time too, every event is trusted.

    Attributes:
        deviation: of the initial state (q, u), shape (2n,), or one number for all, SI units.
        clock_error: of the events' stamps, s, besides their rounding to 1 ns; None to have it
            estimated.
        clock_offset_error: of the common offset of all stamps, s; 0 for none.
        model_error: of the accelerations, as white noise, m/s^1.5: velocities deviate by
            ``model_error sqrt(t)`` in ``t`` seconds; None to have it learned, as well as an
            error of the restitution.
        missed: of an impact, that it is not reported.
        spurious: of an event, that nothing has happened.
        mislabelled: of an impact, that it was one of another contact.
        unknowns: parameters of the model that are estimated or considered; None for none.
        dead_time: after an event, in which the sensor reports no other hit of the contact, s.
        undeclared: deviation of a published component, over its motion, for errors of a model
            that declares none; 0 for an exact model. Estimates do not depend on it.
        contacts: errors of the sensors of single contacts; None where all are the same.
        shift: by how much the motion may be early or late, for errors of a model that a fit has
            shown; deviations contain it, estimates do not depend on it.
    """

    deviation: Vector | float = float(Options.initial_deviation)
    clock_error: float | None = None
    clock_offset_error: float = Options.clock_offset_error
    model_error: float | None = None
    missed: float = Options.missed
    spurious: float = Options.spurious
    mislabelled: float = Options.mislabelled
    unknowns: UnknownParameters | None = None
    dead_time: float = Options.dead_time
    undeclared: float = 0.0
    contacts: ContactErrors | None = None
    shift: TimeShift = NO_SHIFT

    def __post_init__(self) -> None:
        """Raise UsageError unless every number is from 0 to the most that may be declared."""
        object.__setattr__(self, "deviation", frozen(self.deviation))
        most = {name: highest(name) for name in _LIMITED.split()}
        most["deviation"] = LARGEST_DEVIATION
        for name, high in most.items():
            if (given := getattr(self, name)) is None:
                continue
            values = np.ravel(given)
            if not np.all((values >= 0) & (values <= high)):
                found = ",".join(f"{value:g}" for value in values)
                raise UsageError(f"{name}: {found} found; expected 0 to {high:g}")

    @property
    def trusts_events(self) -> bool:
        """Whether every event is as reported, and each hit is reported."""
        return not (self.missed or self.spurious or self.mislabelled or self.dead_time)

    def published_covariance(self, root: Matrix, x: Vector, sizes: Vector) -> Matrix:
        """The covariance ``root root^T`` as published: with rounding and errors of the model.

        ``sizes`` are those of the motion of ``x``, (q, u), shape (2n,), see ``Mechanism.sizes``.
        """
        covariance = root @ root.T
        covariance.flat[:: len(root) + 1] += self.least_deviations(x, sizes) ** 2
        return frozen(covariance)

    def least_deviations(self, x: Vector, sizes: Vector) -> Vector:
        """Standard deviations of ``x``, (q, u), by rounding and errors of the model, (2n,)."""
        least = max(self.undeclared, _ROUNDING) * sizes
        return np.asarray(np.hypot(least, self.shift.errors(x)))

    @property
    def estimates_parameters(self) -> bool:
        """Whether parameters of the model are estimated with the state."""
        return self.unknowns is not None and bool(self.unknowns.estimated)

    def root(self, n: int) -> Matrix:
        """A square root of the initial covariance, shape (2n, 2n).

        Raises:
            UsageError: ``deviation`` is of another size.
        """
        deviation = np.asarray(self.deviation)
        if deviation.shape not in ((), (2 * n,)):
            raise UsageError(
                f"deviation: {deviation.size} numbers, expected 1 or {2 * n}: q1,..,qn,u1,..,un"
            )
        return np.diag(np.broadcast_to(deviation, 2 * n).astype(float))


def deviation_of(text: str, system: System | Robot) -> Vector:
    """Read one number, or ``q1,..,qn,u1,..,un``: standard deviations of an initial state.

    Raises:
        UsageError: the text is something else.
    """
    size, most = 2 * system.n, LARGEST_DEVIATION
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.empty(0)
    if values.size not in (1, size) or not np.all((values >= 0) & (values <= most)):
        raise UsageError(
            f"deviation {text!r}: expected one number from 0 to {most:g}, or {size} of them:"
            " q1,..,qn,u1,..,un"
        )
    return np.asarray(np.broadcast_to(values, size), dtype=float)


def covariance_root(covariance: ArrayLike, n: int) -> Matrix:
    """A square root of a covariance, shape (2n, 2n), row by row or as a matrix.

    Raises:
        UsageError: it is none: of the wrong size, not finite, not symmetric, not semidefinite.
    """
    values = np.asarray(covariance, dtype=float)
    most = LARGEST_DEVIATION**2
    if values.size != 4 * n * n or not np.all(np.abs(values) <= most):
        raise UsageError(
            f"covariance: {values.size} numbers; expected {4 * n * n} of at most {most:g},"
            f" {2 * n} x {2 * n}"
        )
    P = values.reshape(2 * n, 2 * n)
    size = float(np.max(np.abs(P)))
    if float(np.max(np.abs(P - P.T))) > _SYMMETRY * size:
        raise UsageError("covariance: not symmetric; expected a symmetric matrix")
    variances, axes = linalg.eigh((P + P.T) / 2)
    if variances[0] < -_SYMMETRY * size:
        raise UsageError(f"covariance: has the eigenvalue {variances[0]:g}; expected none below 0")
    return np.asarray(axes * np.sqrt(np.maximum(variances, 0.0)))


def spread(x: Vector, root: Matrix, count: int) -> Matrix:
    """``count`` initial states: ``x`` itself, and others about it in every direction alike.

    A normal draw of so few has directions in which all lie close together. So the draw is centred
    and whitened: the mean of the others is ``x`` and, from ``2n + 2`` replicas on, their
    covariance ``root root^T`` is the declared one. Shape (count, 2n).
    """
    found, others = np.tile(x, (count, 1)), count - 1
    drawn = np.random.default_rng(_SEED).normal(size=(others, x.size))
    if others > 1:
        left, _, right = np.linalg.svd(drawn - drawn.mean(axis=0), full_matrices=False)
        rank = min(others - 1, x.size)
        drawn = left[:, :rank] @ right[:rank] * np.sqrt(others * x.size / rank)
    found[1:] += drawn @ root.T
    return found


def suggested_deviation(system: System) -> str:
    """Deviations of the initial state for a rig of another size than the default's.

    Three times the farthest stop at rest for positions, and that times the fastest excitation, or
    without one the lowest eigenfrequency, for velocities: too small ones mislead. As
    ``deviation_of`` reads it; empty where the default does, or the model does not say the size.
    """
    directions = np.abs(system.W).max(axis=0, initial=0.0)
    gaps = np.abs(system.q_r[directions > 0]) / directions[directions > 0]
    frequency = float(system.forcing.frequency.max(initial=0.0))
    if not frequency:
        squares = linalg.eigvalsh(system.K, system.M)
        elastic = squares[squares > _RIGID * squares[-1]]
        frequency = math.sqrt(elastic[0]) if elastic.size else 0.0
    length = 3 * float(gaps.max(initial=0.0))
    speed = length * frequency
    if not speed or (1 / _FAR_FROM_ONE < length < _FAR_FROM_ONE and speed < _FAR_FROM_ONE):
        return ""
    return ",".join([f"{length:.1g}"] * system.n + [f"{speed:.1g}"] * system.n)
