# SPDX-License-Identifier: Apache-2.0
"""A multibody system with contacts: what any room may ask of it, whatever its equations are.

Linear systems (``System``) answer by themselves. What else a model file can describe is made by
the room that ``_MADE_BY`` names for it.
"""

import math
from collections.abc import Sequence
from importlib import import_module
from types import ModuleType
from typing import Any, Protocol, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_observer.model.forcing import Forcing
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.grounds import LiveNames
from impact_observer.model.model_file import Model
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.model.rebounds import ReboundLaw
from impact_observer.model.system import System
from impact_observer.states import Matrix, Vector

_MADE_BY = {"RobotDescription": "impact_observer.robots"}
"""Modules that know a kind of model, by the type of its subject. Their function ``multibody``
makes its system, ``family`` those with other parameters, and ``report`` what ``check-model``
says of it."""


class Multibody(Protocol):
    """Names, sizes and contacts of a system with n coordinates and m contacts.

    States are (q, u), shape (2n,) or (samples, 2n).
    """

    @property
    def name(self) -> str:
        """The model's name."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates, as in ``JointState``."""

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Names of the contacts."""

    @property
    def n(self) -> int:
        """Number of coordinates."""

    @property
    def m(self) -> int:
        """Number of contacts."""

    @property
    def unit(self) -> str:
        """Unit of the coordinates, or of the first where they differ."""

    @property
    def gap_unit(self) -> str:
        """Unit of the gaps."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of (q, u)."""

    @property
    def state_units(self) -> tuple[str, ...]:
        """Units of (q, u)."""

    @property
    def turns(self) -> NDArray[np.bool_]:
        """Which coordinates are known modulo a turn, shape (n,)."""

    @property
    def forcing(self) -> Forcing:
        """What drives it."""

    @property
    def has_encoders(self) -> bool:
        """Whether an observer of it needs its measured positions."""

    @property
    def remark_on_distance(self) -> str:
        """What a user should know of its V, without the name; empty for nothing."""

    @property
    def plant_inputs(self) -> LiveNames | None:
        """Signals known only live, for which a plant waits; None without any."""

    @property
    def rebounds(self) -> tuple[ReboundLaw, ...]:
        """How each contact rebounds."""

    @property
    def depends_on_time(self) -> bool:
        """Whether its motion depends on the time since the epoch."""

    def held_force(self, t: float, /) -> str:
        """A warning if ``t``, s since the epoch, is after the last sample; otherwise empty."""

    def remarks(self, states: Matrix, /) -> list[str]:
        """What a user should know of a run through these states."""

    def contact_speeds(self, x: Vector, /) -> Vector:
        """Contact speeds in a state, shape (m,), m/s."""

    def closed_at(self, q: Vector, /) -> tuple[int, ...]:
        """Indices of the contacts with ``g <= 0`` but for rounding at ``q``, shape (n,)."""

    def gaps_at(self, ns: NDArray[np.int64], states: Matrix, /) -> Matrix:
        """Gaps in states at ``ns`` since the epoch, shape (samples, m)."""

    def from_frame(self, ns: NDArray[np.int64], x: Matrix, /) -> Matrix:
        """States from those in the frame in which no stop moves, at ``ns`` since the epoch."""

    def to_frame(self, ns: NDArray[np.int64], x: Matrix, /) -> Matrix:
        """The inverse of ``from_frame``."""

    def checked_state(self, position: ArrayLike, velocity: ArrayLike) -> tuple[Vector, Vector]:
        """``position`` and ``velocity`` as read-only arrays of shape (n,).

        Raises:
            UsageError: a wrong number of values, or one that is not finite.
        """

    def checked_start(self, position: ArrayLike, velocity: ArrayLike) -> tuple[Vector, Vector]:
        """The initial state of a plant in the frame at the epoch, outside all stops.

        Raises:
            UsageError: as ``checked_state``, or a stop is penetrated.
        """


def is_multibody(source: object) -> TypeGuard[Multibody]:
    """Whether a ``source`` of a model is a system itself, and no model or path."""
    return hasattr(source, "checked_start")


def errors_of(system: Multibody, truth: Matrix, estimate: Matrix) -> Matrix:
    """Estimate minus truth (dq, du), of states (q, u), shape (samples, 2n) or (.., samples, 2n).

    Whole turns are no errors of a coordinate that is known modulo a turn.
    """
    error = np.asarray(estimate - truth)
    turning = np.flatnonzero(system.turns)
    error[..., turning] -= math.tau * np.round(error[..., turning] / math.tau)
    return error


def multibody_of(model: Model) -> Multibody:
    """The system of a ``model``, as a plant moves it.

    Raises:
        UsageError: a library that makes it is not installed, or a part of it has not come yet.
        ModelError: the model makes no system that can move.
    """
    if isinstance(model.subject, System):
        return model.subject
    found: Multibody = _room_of(model).multibody(model)
    return found


def family_of_model(model: Model, names: Sequence[str]) -> ParametricFamily:
    """The systems that differ from that of a ``model`` in the parameters of these ``names``.

    Raises:
        UsageError, ModelError: as ``multibody_of``, or a name is unknown.
    """
    if isinstance(model.subject, System):
        return parametric_family(model.subject, names, model.elements)
    found: ParametricFamily = _room_of(model).family(model, names)
    return found


def report_on(model: Model) -> dict[str, Any]:
    """What ``check-model --json`` prints of a ``model`` that is no linear system.

    Raises:
        UsageError, ModelError: as ``multibody_of``.
    """
    values: dict[str, Any] = _room_of(model).report(model)
    return values


def _room_of(model: Model) -> ModuleType:
    return import_module(_MADE_BY[type(model.subject).__name__])
