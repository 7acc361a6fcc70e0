# SPDX-License-Identifier: Apache-2.0
"""The quantities that plots show: coordinates, velocities, and gaps, which depend on the state."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.model.system import UNKNOWN_UNIT, per_second
from impact_observer.states import Matrix, Vector

_GROUPS = ("positions", "velocities", "gaps")


@dataclass(frozen=True, slots=True, eq=False)
class Quantity:
    """A number that depends linearly on the state, ``row . (q, u) + offset``.

    Attributes:
        name: as in the columns of ``export``: ``q_x1``, ``u_x1``; of a gap ``g_stop``.
        label: for an axis, with the unit.
        row: coefficients, shape (2n,).
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
        motion: addition of moving grounds to the gaps, shape (N, m), m; None for no addition.

    Returns:
        Shape (N, k).
    """
    rows = np.array([each.row for each in quantities])
    values = np.asarray(x @ rows.T + [each.offset for each in quantities])
    for k, each in enumerate(quantities):
        if each.contact is not None and motion is not None:
            values[:, k] += motion[:, each.contact]
    return values


def deviations_of(quantities: Sequence[Quantity], covariance: Matrix) -> Matrix:
    """The standard deviation of each quantity, shape (N, k), of covariances, (N, 2n, 2n)."""
    variances = np.empty((len(covariance), len(quantities)))
    for column, each in enumerate(quantities):
        (used,) = np.nonzero(each.row)
        factors = each.row[used]
        parts = covariance[:, used[:, None], used]
        variances[:, column] = np.einsum("i,kij,j->k", factors, parts, factors)
    # Rounding may leave a variance slightly below zero.
    return np.asarray(np.sqrt(np.where(variances < 0, 0.0, variances)))


def quantities_of(names: Sequence[str], system: System | None) -> dict[str, Quantity]:
    """All quantities of a model by name: coordinates with their velocities, then gaps.

    Args:
        names: of the coordinates.
        system: of the model, whose coordinates are ``names``; None, without a model, for no gaps.
    """
    n, quantities = len(names), list[Quantity]()
    m = UNKNOWN_UNIT if system is None else system.unit
    unit = np.eye(2 * n)
    for i, name in enumerate(names):
        quantities.append(Quantity(f"q_{name}", f"{name} [{m}]", unit[i]))
        quantities.append(Quantity(f"u_{name}", f"d{name}/dt [{per_second(m)}]", unit[n + i]))
    if system is not None:
        for i, contact in enumerate(system.contacts):
            row = np.concatenate([contact.direction, np.zeros(n)])
            name, label = f"g_{contact.name}", f"gap of {contact.name} [{m}]"
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
