# SPDX-License-Identifier: Apache-2.0
"""Observers of plants on moving grounds: what is proved of them, and how exact they become."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import EPOCH, estimates, examples, observer, run, systems, vectors

from impact_observer.dynamics.lyapunov import distance
from impact_observer.model import System, parse_model
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.kinematic import Kinematic
from impact_observer.observer.replay import replay_batches
from impact_observer.states import Estimates

Array = NDArray[np.float64]
RIG = """\
name: rig
bodies:  [{name: x1, mass: 1}, {name: x2, mass: 2}]
grounds: [{name: base, motion: {harmonics: [{amplitude: 0.1, frequency: 3, phase: 0.4}]}},
          {name: wall, motion: {sampled: "time,displacement\\n0,0\\n2,0.1\\n5,-0.1\\n20,0\\n"}}]
springs:
  - {between: [base, x1], stiffness: 10, damping: 0.3}
  - {between: [x1, x2], stiffness: 20, damping: 0.2}
  - {between: [x2, ground], stiffness: 5}
forces:  [{body: x2, amplitude: 4, frequency: 2.5}]
stops:
  - {name: foot, between: [base, x1], gap: 0.2, restitution: 0.7}
  - {name: head, body: x2, limit: 0.3, side: above, ground: wall, restitution: 0.7}
"""


def between(model: System, one: Array, two: Array) -> float:
    """V of two states."""
    q, u = np.split(one - two, 2)
    return float(distance(model, q, u))


@pytest.mark.parametrize(
    "law", ["kinematic", "geometric", pytest.param("unilateral", marks=pytest.mark.slow)]
)
def test_laws_converge_on_moving_stops(law: str) -> None:
    """What is published are the coordinates, not those of the frame: the error vanishes."""
    system = parse_model(RIG, "rig").system
    plant = run(system, [0.1, 0.0], [0.0, 0.5], seconds=60.0, rate=20.0)
    assert len(plant.impacts) > 30
    watcher = observer(system, law, [0.3, -0.2, 0.5, -0.5], epoch=EPOCH, history=100.0)
    for event in plant.events:
        watcher.receive(event)
    found = np.concatenate([each.x for each in watcher.estimates(plant.stamps)])
    q, u = np.split(found - plant.states, 2, axis=1)
    V = distance(system, q, u)
    assert V[-1] < 1e-4 * V[0]
    np.testing.assert_array_equal(found[::100], estimates(watcher, plant.stamps[::100]))


@pytest.mark.slow
def test_minimum_variance_knows_the_state_after_a_few_impacts() -> None:
    """With exact events the error falls to rounding."""
    system = parse_model(RIG, "rig").system
    plant = run(system, [0.1, 0.0], [0.0, 0.5], seconds=30.0, rate=20.0)
    watcher = observer(system, "minimum-variance", [0.3, -0.2, 0.5, -0.5], epoch=EPOCH)
    parts = [
        each
        for each in replay_batches(watcher, plant.events, plant.stamps)
        if isinstance(each, Estimates)
    ]
    found = np.concatenate([each.x for each in parts])
    q, u = np.split(found - plant.states, 2, axis=1)
    V = distance(system, q, u)
    assert V[-1] < 1e-14 * V[0]


@pytest.mark.parametrize("kind", ["displacement", "speed"])
@examples(20)
@given(st.data())
def test_wrong_motion_of_stops_adds_what_is_proved(kind: str, data: st.DataObject) -> None:
    """An exact identity for ``w``; for ``w'`` a bound, with one restitution of all."""
    model = data.draw(systems(contacts=(1, 2), forced=False))
    assume(np.linalg.eigvalsh(model.K)[0] > 1e-3)
    assume(np.linalg.matrix_rank(model.W, tol=1e-3) == model.m)
    every, n = tuple(range(model.m)), model.n
    one, two = (data.draw(vectors(2 * n)) for _ in range(2))
    wrong = data.draw(vectors(model.m))
    shift = model.W @ np.linalg.solve(model.W.T @ model.W, -wrong)  # of W' shift = -wrong
    before = between(model, one, two)
    if kind == "displacement":
        law = Geometric(model)
        offset = np.append(shift, np.zeros(n))
        after = [each.impact(x, every, ()) for each, x in ((law, one), (law, two - offset))]
        L = model.W.T @ np.linalg.solve(model.K, model.W)
        dg = model.W.T @ (one - two)[:n]
        jumped = (after[0] - (after[1] + offset))[:n]
        V = float(distance(model, jumped, np.zeros(n)))
        start = float(distance(model, (one - two)[:n], np.zeros(n)))
        gain = wrong @ np.linalg.solve(L, wrong) / 2 - dg @ np.linalg.solve(L, dg) / 2
        assert pytest.approx(start + gain, abs=1e-8 * (1 + start + abs(gain))) == V
        return
    eps = float(model.eps[0])
    assume(np.all(model.eps == eps))
    offset = np.append(np.zeros(n), shift)
    sprag = Kinematic(model)
    after = [sprag.impact(one, every, ()), sprag.impact(two - offset, every, ()) + offset]
    G = model.W.T @ np.linalg.solve(model.M, model.W)
    added = np.sqrt((1 + eps) ** 2 * wrong @ np.linalg.solve(G, wrong) / 2)
    assert np.sqrt(between(model, *after)) <= np.sqrt(before) + added + 1e-9 * (1 + added)
