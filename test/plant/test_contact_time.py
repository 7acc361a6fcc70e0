# SPDX-License-Identifier: Apache-2.0
"""Impacts that last: velocities jump half a contact time after the gap is zero."""

import math
from dataclasses import replace

import numpy as np
import pytest
from systems import EPOCH, forcing, run, sample, softened, started, system

from impact_observer.errors import ModelError, UsageError
from impact_observer.events import Kind
from impact_observer.model import parse_model
from impact_observer.plant import make_plant
from impact_observer.stamps import NS_PER_S

BODY = "name: a\nbodies: [{name: x, mass: 1}]\nstops:\n  - {name: s, body: x, limit: 1, %s}\n"


def test_free_body_passes_its_stop_until_its_velocity_jumps() -> None:
    """The event is the onset; the stop is felt again once the gap has reopened."""
    model = softened(system(1.0, 0.0, 0.0, contacts=[([-1.0], 0.5, 0.5)]), 0.1)
    made = run(model, [0.0], [1.0], seconds=2.0, rate=100.0)
    assert [event.stamp for event in made.events] == [EPOCH + NS_PER_S // 2]
    t = (made.stamps - EPOCH) / NS_PER_S
    np.testing.assert_allclose(made.states[:, 0], np.where(t < 0.55, t, 0.825 - t / 2), atol=1e-9)
    at_jump = abs(t - 0.55) < 1e-6
    np.testing.assert_allclose(made.states[~at_jump, 1], np.where(t < 0.55, 1, -0.5)[~at_jump])


def test_body_may_hit_a_second_stop_before_its_velocity_has_jumped() -> None:
    """Each contact jumps by itself, half a contact time after its own onset."""
    contacts = [([-1.0, 1.0], 0.0, 1.0), ([0.0, -1.0], 0.53, 1.0)]
    model = softened(system(np.eye(2), np.zeros((2, 2)), np.zeros((2, 2)), contacts=contacts), 0.1)
    made = run(model, [0.0, 0.5], [1.0, 0.0], seconds=1.0, rate=100.0)
    # 0.5 s: the first hits the second, at 0.55 s they swap speeds; at 0.58 s it hits the wall.
    onsets = [(event.stamp - EPOCH) / NS_PER_S for event in made.events]
    np.testing.assert_allclose(onsets[:2], [0.5, 0.58], atol=1e-9)
    t = (made.stamps - EPOCH) / NS_PER_S
    between = (t > 0.56) & (t < 0.62)
    np.testing.assert_allclose(made.states[between, 2:], [[0.0, 1.0]] * between.sum(), atol=1e-12)
    np.testing.assert_allclose(np.sum(made.states[-1, 2:] ** 2), 1.0, rtol=1e-12)


def test_impacts_that_accumulate_end_in_rest_and_not_beyond_the_stop() -> None:
    """A ball that turns before its gap has reopened comes to rest: it is closed then."""
    model = softened(sample("bouncing_ball").system, 0.02)
    made = run(model, [1.0], [0.0], seconds=12.0, rate=100.0)
    assert made.events[-1].switches[0].kind is Kind.CLOSE
    assert [e.switches[0].kind for e in made.events[:-1]] == [Kind.IMPACT] * (len(made.events) - 1)
    fastest = math.sqrt(2 * 9.81)
    assert made.states[:, 0].min() > -fastest * 0.02
    assert made.states[-1].tolist() == [0.0, 0.0]


def test_plastic_impact_closes_when_its_velocity_jumps() -> None:
    """One event at the onset, one half a contact time later."""
    model = softened(
        system(1.0, 0.0, 0.0, contacts=[([1.0], 0.0, 0.0)], force=forcing(1, -1.0)), 0.1
    )
    made = run(model, [0.5], [0.0], seconds=2.0, rate=10.0)
    onset, close = made.events
    assert (onset.switches[0].kind, close.switches[0].kind) == (Kind.IMPACT, Kind.CLOSE)
    assert close.stamp - onset.stamp == NS_PER_S // 20
    assert onset.stamp == EPOCH + NS_PER_S


@pytest.mark.parametrize("name", ["three_mass", "yielding_stop", "hammer"])
def test_short_contacts_change_a_motion_a_little(name: str) -> None:
    """By as much as they last, with several stops, restitution by speed."""
    model = sample(name)
    rigid = run(model.system, *model.initial_state(), seconds=3.0, rate=50.0)
    short = run(softened(model.system, 1e-6), *model.initial_state(), seconds=3.0, rate=50.0)
    assert len(short.events) == len(rigid.events) > 0
    np.testing.assert_allclose(short.states, rigid.states, atol=1e-4)


def test_contact_time_is_a_key_of_stops_and_contacts() -> None:
    """It is kept in the text of a model; what is no time is one line."""
    model = parse_model(BODY % "side: above, restitution: 0.5, contact_time: 0.002", "a")
    assert model.system.contact_time.tolist() == [0.002]
    assert parse_model(model.text(), "b").system.contact_time.tolist() == [0.002]
    matrices = replace(model, element_form={})
    assert parse_model(matrices.text(), "c").system.contact_time.tolist() == [0.002]
    for value in ("-0.1", "0.2"):
        line = rf"stops\[0\].contact_time: is {value}; expected a number in \[0, 0.1\], s"
        with pytest.raises(ModelError, match=line):
            parse_model(BODY % f"side: above, restitution: 0.5, contact_time: {value}", "a")


def test_what_cannot_take_it_says_so() -> None:
    """The integrator moreau."""
    model = softened(sample("two_mass").system, 0.002)
    q, u = np.zeros(2), np.zeros(2)
    line = "two_mass: a hit of 'stop' lasts 0.002 s, which {} cannot take"
    with pytest.raises(UsageError, match=line.format("the integrator moreau")):
        make_plant(model, q, u, epoch=EPOCH, integrator="moreau")
    assert started(model, q, u).epoch == EPOCH
