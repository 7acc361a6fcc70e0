# SPDX-License-Identifier: Apache-2.0
"""V under everything that a rig may have at once: what is proved of each holds for all."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import (
    EPOCH,
    distance,
    examples,
    ground_motion,
    largest_rise,
    numbers,
    passes_eigenvalue_test,
    switched,
    switchings,
    systems,
    vectors,
)

from impact_observer.model import Forcing, System
from impact_observer.model.force_samples import Samples
from impact_observer.model.grounds import Grounds, LiveNames
from impact_observer.model.live_signals import connected
from impact_observer.model.rebounds.power_law import PowerLaw
from impact_observer.model.system import moving_system
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.kinematic import Kinematic
from impact_observer.observer.laws.replica_law import ReplicaLaw
from impact_observer.observer.laws.unilateral import Unilateral
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
LAWS = pytest.mark.parametrize("law", [Kinematic, Geometric, Unilateral], ids=lambda law: law.name)


def stamps(seconds: st.SearchStrategy[float], most: int) -> st.SearchStrategy[list[int]]:
    """Some stamps, in any order."""
    return st.lists(
        seconds.map(lambda s: EPOCH + round(s * NS_PER_S)), min_size=1, max_size=most, unique=True
    )


@st.composite
def rigs(draw: st.DrawFn, gaps: tuple[float, float] = (-1.0, 2.0)) -> System:
    """Harmonics, samples and live forces; stops on grounds that move.

    The restitution of a single contact depends on the speed.
    """
    model = draw(systems(max_n=3, contacts=(1, 2), gaps=gaps))
    n, times = model.n, numbers(0.0, 5.0)
    contacts = model.contacts
    if model.m == 1 and draw(st.booleans()):
        law = PowerLaw(draw(numbers(0.0, 1.0)), 1.0, -draw(numbers(0.0, 0.875)), 0.9)
        contacts = (replace(contacts[0], rebound=law),)
    jets = np.array([[draw(vectors(n, -1.0, 1.0)) for _ in range(3)] for _ in range(4)])
    forcing = model.forcing.added(Forcing.of_samples(Samples.of_jets(np.arange(3.0), jets)))
    model = replace(model, contacts=contacts, forcing=forcing)
    shift, stiffness, damping = (np.array([draw(vectors(2)) for _ in range(n)]) for _ in range(3))
    motion = ground_motion(draw)
    factors = -(model.W.T @ shift)
    model = moving_system(
        model, Grounds(("shaken", "steered"), motion, (0, 1), stiffness, damping, factors)
    )
    push = draw(vectors(n))[:, None]
    live = LiveNames(("motor",), push)
    found, signals = connected(replace(model, live=live))
    assert signals is not None
    for stamp in draw(stamps(times, 4)):
        signals.add_force("motor", stamp, draw(numbers()))
    signals.follow(EPOCH)
    return found


@pytest.mark.slow
@LAWS
@examples(12)
@given(st.data())
def test_distance_of_two_replicas_never_rises(law: type[ReplicaLaw], data: st.DataObject) -> None:
    """Under any switching, with all of it at once: by less than 1e-9 of the first."""
    model = data.draw(rigs())
    assume(passes_eigenvalue_test(model))
    replica = law(model)
    states = [replica.admissible(data.draw(vectors(2 * model.n))) for _ in range(2)]
    first = last = distance(model, *states)
    size = 1e-9 * (1e-3 + first)
    for found, jumped in switched(replica, states, data.draw(switchings(model.m, most=5))):
        if not jumped:
            size = 1e-9 * (1e-3 + first) + 1e-12 * float(np.max(np.abs(found))) ** 2
        now = distance(model, *found)
        assert now <= last + size
        last = now


@pytest.mark.slow
@LAWS
@examples(12)
@given(st.data())
def test_distance_of_a_replica_to_its_plant_never_rises(
    law: type[ReplicaLaw], data: st.DataObject
) -> None:
    """Under the true switching, with all of it at once: by less than 1e-9 of the first."""
    model = data.draw(rigs(gaps=(0.5, 1.5)))
    assume(passes_eigenvalue_test(model))
    x = np.concatenate([data.draw(vectors(model.n, -0.5, 0.5)), data.draw(vectors(model.n))])
    at_rest = model.to_frame(np.zeros(1, dtype=np.int64), x[None])[0]
    assume(np.all(model.gap(at_rest[: model.n]) >= 0))
    assert largest_rise(law(model), x, data.draw(vectors(2 * model.n))) <= 0
