# SPDX-License-Identifier: Apache-2.0
"""Impacts whose restitution depends on the speed: laws, plant, filter, identification."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import (
    EPOCH,
    delassus,
    estimates,
    examples,
    observer,
    run,
    sample,
    system,
    systems,
    vectors,
)

from impact_observer.batch.identification import identify
from impact_observer.batch.model_edit import changes
from impact_observer.check.model_check import check_model
from impact_observer.dynamics import ImpactLaw, lyapunov
from impact_observer.events import Kind
from impact_observer.model import System, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.rebounds import ReboundLaw
from impact_observer.model.rebounds.power_law import PowerLaw
from impact_observer.model.yaml_text import edited, load_yaml
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
POWER = PowerLaw(0.7, 1.0, -0.25, 0.9)


class Steep(PowerLaw):
    """A law of a user that tells of itself that its slope leaves [-1, 1]."""

    @property
    def is_nonexpansive(self) -> bool:
        """No."""
        return False

    def checked(self, key: str) -> "Steep":
        """The same law."""
        del key
        return self


def with_curve(model: System, *curves: ReboundLaw | None) -> System:
    """The same system whose first contacts have restitutions by speed."""
    given_ = [*curves, *[None] * (model.m - len(curves))]
    contacts = zip(model.contacts, given_, strict=True)
    return replace(model, contacts=tuple(replace(c, rebound=curve) for c, curve in contacts))


@st.composite
def curves(draw: st.DrawFn) -> ReboundLaw:
    """Power laws of any kind."""
    value, speed = draw(st.integers(0, 8)) / 8, draw(st.integers(1, 16)) / 8
    return PowerLaw(value, speed, -draw(st.integers(0, 7)) / 8, draw(st.integers(0, 7)) / 8)


def test_single_contact_rebounds_by_its_own_speed() -> None:
    """``gamma+ = -eps(|gamma-|) gamma-`` in closed form, one by one and many at once."""
    model = with_curve(
        system([[2, 0.5], [0.5, 1]], np.eye(2), np.eye(2), contacts=[([1, -3], 0.0, 0.6)]), POWER
    )
    law, U = ImpactLaw(model), np.array([[-1.0, 0.5], [-0.1, 0.0], [-4.0, 1.0], [1.0, 0.0]])
    after = np.array([law.velocity_after(u, (0,)) for u in U])
    before = U @ model.W[:, 0]
    eps = np.minimum(0.9, 0.7 * np.abs(before) ** -0.25)
    expected = np.where(before < 0, -eps * before, before)
    np.testing.assert_allclose(after @ model.W[:, 0], expected, rtol=1e-13)
    np.testing.assert_allclose(law.velocity_held(U, (0,), ()), after, rtol=1e-15, atol=1e-15)


@pytest.mark.slow
@examples(25)
@given(st.data())
def test_several_contacts_have_complementary_impulses_by_their_own_speeds(
    data: st.DataObject,
) -> None:
    """``0 <= gamma+ + eps(|gamma-|) gamma-  _|_  Lambda >= 0``, put back into the law."""
    model = data.draw(systems(contacts=(2, 2), max_n=4))
    assume(np.linalg.matrix_rank(model.W) == 2)
    model = with_curve(model, data.draw(curves()), data.draw(curves()))
    law, u = ImpactLaw(model), data.draw(vectors(model.n))
    impulses = law.impulses(u, (0, 1))
    gamma = model.contact_speed(u)
    rebound = [each.rebound(g) for each, g in zip(model.rebounds, gamma, strict=True)]
    xi = delassus(model) @ impulses + gamma + rebound
    size = 1e-9 * (1 + float(np.max(np.abs(gamma))))
    assert np.all(impulses >= 0)
    assert np.all(xi >= -size)
    assert float(np.max(np.abs(impulses * xi))) <= size * (1 + float(np.max(impulses)))


def test_rebound_heights_of_a_ball_follow_the_law_until_it_rests() -> None:
    """``v -> eps(v) v`` from flight to flight in closed form; the limit brings it to rest."""
    ball = sample("bouncing_ball")
    model = with_curve(ball.system, PowerLaw(0.5, 1.0, -0.25, 0.9))
    made = run(model, *ball.initial_state(), seconds=12.0, rate=10.0)
    (height,), _ = ball.initial_state()
    speed = np.sqrt(2 * 9.81 * height)
    expected = [speed / 9.81]
    for _ in range(12):
        speed *= min(0.9, 0.5 * speed**-0.25)
        expected.append(expected[-1] + 2 * speed / 9.81)
    stamps = np.array([(e.stamp - EPOCH) / NS_PER_S for e in made.events])
    np.testing.assert_allclose(stamps[:13], expected, atol=2e-9)
    assert made.events[-1].switches[0].kind is Kind.CLOSE
    np.testing.assert_allclose(made.states[-1], 0, atol=1e-12)


def test_minimum_variance_finds_the_state_to_rounding() -> None:
    """V falls to 1e-14 of V0 with exact events."""
    model = sample("yielding_stop")
    made = run(model.system, *model.initial_state(), seconds=30.0, rate=10.0)
    start = np.concatenate(model.initial_state()) + np.array([0.5, -0.3, 0.4, -0.6])
    watcher = observer(model.system, "minimum-variance", start)
    for each in made.events:
        watcher.receive(each)
    error = estimates(watcher, made.stamps[-1:])[0] - made.states[-1]
    V = [lyapunov.distance(model.system, *np.split(d, 2)) for d in (error, start - made.states[0])]
    assert V[0] <= 1e-14 * V[1]


@pytest.mark.slow
def test_value_and_exponent_are_identified_and_written_back() -> None:
    """From 60 s of exact times, to 1e-4; the model file gets them in their places."""
    model = sample("yielding_stop")
    made = run(model.system, *model.initial_state(), seconds=60.0, rate=1.0)
    wrong = with_curve(model.system, PowerLaw(0.65, 1.0, -0.15, 0.9))
    family = parametric_family(wrong, ["restitution", "restitution-exponent"])
    found = identify(family, list(made.events))
    assert found.verdict.fits
    np.testing.assert_allclose(found.values, [0.7, -0.25], rtol=1e-4)
    for text in (model.text(), replace(model, form={}).text()):
        document, places = load_yaml(text), parse_model(text, "given").places
        entries = changes(document, places, family, np.array([0.6, -0.1]))  # type: ignore[arg-type]
        written = edited(text, entries)
        curve = parse_model(written, "fitted").system.contacts[0].rebound
        assert curve == PowerLaw(0.6, 1.0, -0.1, 0.9)


def test_a_law_that_is_too_steep_has_no_certified_bound() -> None:
    """Its impact can raise V, so nothing is removed for certain."""
    model = with_curve(sample("two_mass").system, Steep(0.7, 1.0, -0.25, 0.9))
    assert not ImpactLaw(model).is_nonexpansive((0,))
    x = np.array([0.3, 0.4, 1.0, 1.0])
    assert Geometric(model).energy_removed(x, x, (0,)) is None
    assert Geometric(with_curve(model, POWER)).energy_removed(x, x, (0,)) is not None
    assert check_model(model).nonexpansive is False


def test_of_several_contacts_check_model_says_that_v_is_not_proved() -> None:
    """And no bound is certified where they hit together."""
    model = with_curve(sample("three_mass").system, POWER)
    assert check_model(model).nonexpansive is None
    assert not ImpactLaw(model).is_nonexpansive((0, 1))
