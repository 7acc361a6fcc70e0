# SPDX-License-Identifier: Apache-2.0
"""The models that the observer is given in ``misfit_plants``."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from impact_observer.model import Contact, Forcing, System, read_model

Array = NDArray[np.float64]

LARGEST = {
    "two_mass": 1.9,
    "three_mass": 0.5,
    "one_stop": 0.6,
    "two_stops": 0.35,
    "drill": 0.6,
    "four_mass": 0.8,
}
"""Displacement of the first body, m, that most runs of a model reach."""


def chain(
    name: str,
    masses: Sequence[float],
    springs: Sequence[tuple[float, float]],
    harmonics: Sequence[tuple[float, Sequence[float], Sequence[float]]],
    stops: Sequence[tuple[str, ArrayLike, float, float]],
) -> System:
    """Bodies on a line.

    Args:
        name: of the model.
        masses: of the n bodies, kg.
        springs: stiffness and damping, from the ground to the first body, between neighbours, and
            from the last body to the ground, shape (n + 1, 2), N/m and Ns/m.
        harmonics: angular frequency, rad/s, and amplitudes of cosine and sine, N.
        stops: name, direction, gap at rest, m, and restitution.
    """
    n = len(masses)
    rows = np.eye(n + 1, n) - np.eye(n + 1, n, k=-1)
    stiffness, damping = np.transpose(springs)
    frequency, cosine, sine = zip(*harmonics, strict=True)
    return System(
        name,
        tuple(f"x{i + 1}" for i in range(n)),
        np.diag(masses),
        rows.T @ np.diag(damping) @ rows,
        rows.T @ np.diag(stiffness) @ rows,
        Forcing(np.zeros(n), np.array(frequency), np.array(cosine), np.array(sine)),
        tuple(Contact(stop, np.asarray(w, float), gap, eps) for stop, w, gap, eps in stops),
    )


@cache
def bases() -> dict[str, System]:
    """Models whose impacts do not accumulate, or seldom."""
    return {
        each.name: each
        for each in (
            read_model("two_mass").system,
            read_model("three_mass").system,
            chain(
                "one_stop",
                [1.0],
                [(15.0, 0.2), (0.0, 0.0)],
                [(3.0, [4.0], [0.0])],
                [("stop", [-1.0], 0.25, 0.8)],
            ),
            chain(
                "two_stops",
                [1.0],
                [(12.0, 0.3), (0.0, 0.0)],
                [(3.1, [5.0], [0.0]), (1.7, [0.0], [2.0])],
                [("right", [-1.0], 0.3, 0.85), ("left", [1.0], 0.35, 0.75)],
            ),
            chain(
                "drill",
                [1.5, 0.8],
                [(20.0, 0.2), (12.0, 0.2), (5.0, 0.1)],
                [(3.4, [7.0, 0.0], [0.0, 0.0])],
                [("anvil", [-1.0, 1.0], 0.25, 0.8), ("rock", [0.0, -1.0], 0.3, 0.7)],
            ),
            chain(
                "four_mass",
                [1.0, 0.8, 1.2, 1.0],
                [(30.0, 0.1), (20.0, 0.1), (25.0, 0.1), (20.0, 0.1), (30.0, 0.1)],
                [(3.2, [5.0, 0.0, 0.0, 0.0], [0.0] * 4), (4.1, [0.0] * 4, [0.0, 0.0, 0.0, 3.0])],
                [
                    ("left", [1.0, 0.0, 0.0, 0.0], 0.25, 0.75),
                    ("right", [0.0, 0.0, 0.0, -1.0], 0.3, 0.8),
                ],
            ),
        )
    }
