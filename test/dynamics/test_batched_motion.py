# SPDX-License-Identifier: Apache-2.0
"""States of many instants at once are those of each instant, in every bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import Harmonic, chain, examples, flow_of, forcing, system, systems

from impact_observer.dynamics import Motion
from impact_observer.model import System

SIZES = (1, 2, 3, 4, 5, 7, 8, 9, 15, 16, 17, 31, 33, 64, 100, 257, 1000)
"""Of batches: about the widths of vector registers, and about those of blocks of BLAS."""


def motions() -> dict[str, Motion]:
    """One of each kind of flow and of spectrum."""
    loads = [Harmonic(2.5, [0, 4], [1, 0]), Harmonic(0.3, [1, 2], [0, 0])]
    many = chain(12, force=forcing(12, 0.1, [Harmonic(1.7, np.ones(12).tolist(), [0.0] * 12)]))
    made = {
        "free": chain(2),
        "driven": chain(2, force=forcing(2, [1, -2], loads)),
        "many": many,
        "overdamped": system(np.eye(2), 30 * np.eye(2), [[20, -10], [-10, 10]]),
        "resonant": system(1, 0, 4, force=forcing(1, 0, [Harmonic(2.0, [1], [0])])),
        "dense": system(np.eye(2), [[2, 1], [0, 2]], np.eye(2)),
        "soft": system(np.eye(1), 0, 1e-6, force=forcing(1, 9.81)),
    }
    return {name: start(each) for name, each in made.items()}


def start(model: System) -> Motion:
    """A motion with a random state."""
    x = np.random.default_rng(4).normal(size=2 * model.n)
    return flow_of(model).start(0.37, x)


def each_alone(motion: Motion, s: NDArray[np.float64]) -> bytes:
    """The bytes of the states, asked for one by one."""
    return b"".join(motion.state(at).tobytes() for at in s.tolist())


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=pytest.mark.slow if kind in {"resonant", "soft"} else ())
        for kind in motions()
    ],
)
def test_states_are_those_of_each_instant_alone(kind: str) -> None:
    """For any size of the batch, and any place of an instant in it."""
    motion, random = motions()[kind], np.random.default_rng(7)
    for size in SIZES[: -1 if kind in {"dense", "resonant", "soft"} else None]:
        s = np.sort(random.uniform(0, 50, size))
        assert motion.states(s).tobytes() == each_alone(motion, s)
        assert motion.states(s[::-1]).tobytes() == each_alone(motion, s[::-1])


@examples(30)
@given(systems(), st.sampled_from(SIZES[:12]), st.floats(1e-9, 1e3))
def test_states_of_any_system_are_those_of_each_instant_alone(
    model: System, size: int, longest: float
) -> None:
    """Rigid bodies, critical damping, resonance."""
    motion = start(model)
    s = np.linspace(longest / size, longest, size)
    assert motion.states(s).tobytes() == each_alone(motion, s)
