# SPDX-License-Identifier: Apache-2.0
"""The quantities that plots show: coordinates, velocities, and gaps, which depend on the state."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.model.system import UNKNOWN_UNIT, per_second
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector

_GROUPS = ("positions", "velocities", "gaps")


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """A number that depends on the state, ``row . (q, u) + offset``, or the gap of a robot.

    Attributes:
        name: as in the columns of ``export``: ``q_x1``, ``u_x1``; of a gap ``g_stop``.
        label: for an axis, with the unit.
        row: coefficients, shape (2n,); zeros of a robot's gap, which is not linear.
        offset: m.
        contact: index of the contact, of a gap; None of other quantities.
    """

    name: str
    label: str
    row: Vector
    offset: float = 0.0
    contact: int | None = None


def values_of(quantities: Sequence[Quantity], x: Matrix, motion: Matrix | None = None) -> Matrix:
    """Values of the quantities in each state.

    Args:
        quantities: k of them.
        x: states (q, u), shape (N, 2n).
        motion: addition of moving grounds to the gaps, or the gaps of a robot, shape (N, m), m;
            None for no addition.

    Returns:
        Shape (N, k).
    """
    rows = np.array([each.row for each in quantities])
    values = np.asarray(x @ rows.T + [each.offset for each in quantities])
    for k, each in enumerate(quantities):
        if each.contact is not None and motion is not None:
            values[:, k] += motion[:, each.contact]
    return values


def deviations_of(
    quantities: Sequence[Quantity],
    covariance: Matrix,
    gradients: NDArray[np.float64] | None = None,
) -> Matrix:
    """The standard deviation of each quantity, shape (N, k), of covariances, (N, 2n, 2n).

    The ``gradients`` of a robot's gaps in each state have the shape (N, n, m).
    """
    variances = np.empty((len(covariance), len(quantities)))
    for column, each in enumerate(quantities):
        if each.contact is not None and gradients is not None:
            w, n = gradients[:, :, each.contact], gradients.shape[1]
            variances[:, column] = np.einsum("ki,kij,kj->k", w, covariance[:, :n, :n], w)
            continue
        (used,) = np.nonzero(each.row)
        factors = each.row[used]
        parts = covariance[:, used[:, None], used]
        variances[:, column] = np.einsum("i,kij,j->k", factors, parts, factors)
    # Rounding may leave a variance slightly below zero.
    return np.asarray(np.sqrt(np.where(variances < 0, 0.0, variances)))


def quantities_of(names: Sequence[str], system: System | Robot | None) -> dict[str, Quantity]:
    """All quantities of a model by name: coordinates with their velocities, then gaps.

    Args:
        names: of the coordinates.
        system: of the model, whose coordinates are ``names``; None, without a model, for no gaps.
    """
    n, quantities = len(names), list[Quantity]()
    unknown = (UNKNOWN_UNIT,) * n + (per_second(UNKNOWN_UNIT),) * n
    units = unknown if system is None else system.state_units
    unit = np.eye(2 * n)
    for i, name in enumerate(names):
        quantities.append(Quantity(f"q_{name}", f"{name} [{units[i]}]", unit[i]))
        quantities.append(Quantity(f"u_{name}", f"d{name}/dt [{units[n + i]}]", unit[n + i]))
    if isinstance(system, Robot):
        for i, name in enumerate(system.contact_names):
            quantities.append(Quantity(f"g_{name}", f"gap of {name} [m]", np.zeros(2 * n), 0.0, i))
    elif system is not None:
        for i, contact in enumerate(system.contacts):
            row = np.concatenate([contact.direction, np.zeros(n)])
            name, label = f"g_{contact.name}", f"gap of {contact.name} [{system.unit}]"
            quantities.append(Quantity(name, label, row, contact.gap, i))
    return {each.name: each for each in quantities}


def selected(every: dict[str, Quantity], words: Sequence[str]) -> tuple[Quantity, ...]:
    """The quantities that a user names, each once, in the order of the words.

    Args:
        every: the result of ``quantities_of``.
        words: names of quantities, such as ``q_x1``; of coordinates, for position and velocity; of
            contacts, for their gaps; or ``positions``, ``velocities``, ``gaps``.

    Raises:
        UsageError: a word names no quantity.
    """
    chosen: dict[str, Quantity] = {}
    for word in words:
        if word in every:
            names = [word]
        elif word in _GROUPS:
            names = [name for name in every if name.startswith("qug"[_GROUPS.index(word)] + "_")]
        else:
            names = [f"{kind}_{word}" for kind in "qug" if f"{kind}_{word}" in every]
        if not names:
            raise UsageError(
                f"--select {word}: nothing of that name; expected {', '.join(_GROUPS)}, a"
                f" coordinate, a contact of the model, or one of {', '.join(every)}"
            )
        chosen |= {name: every[name] for name in names}
    return tuple(chosen.values())
