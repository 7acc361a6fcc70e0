# SPDX-License-Identifier: Apache-2.0
"""Contacts of a replica that stay closed: slipping, caught, held and released."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from quadrature import NODES, integral
from scipy import optimize
from systems import Harmonic, examples, forcing, numbers, system, systems, vectors, whole_numbers

from impact_observer.dynamics import Clutches, ImpactLaw, Motion, PositionProjection
from impact_observer.dynamics.contact import clutch
from impact_observer.model import Forcing, System
from impact_observer.model.force_samples import Samples

Array = NDArray[np.float64]
BOTH = pytest.mark.parametrize("fix", [False, True], ids=["kinematic", "geometric"])
PIECES = 24
"""Pieces in which a motion is checked."""


class Closed(NamedTuple):
    """A system, its contacts that stay closed, and a motion of its replica from ``start`` on."""

    system: System
    start: Array
    contacts: tuple[int, ...]
    motion: Motion
    fix: bool


def started(model: System, t: float, x: Array, contacts: tuple[int, ...], *, fix: bool) -> Closed:
    """The motion from ``x`` on, after the impact that closes ``contacts``."""
    n = model.n
    position = PositionProjection(model).position_after(x[:n], contacts) if fix else x[:n]
    velocity = ImpactLaw(model).velocity_held(x[n:], contacts, contacts)
    start = np.concatenate([position, velocity])
    return Closed(model, start, contacts, Clutches(model).motion(t, start, contacts, fix=fix), fix)


def drawn(data: st.DataObject, model: System, *, fix: bool) -> Closed:
    """Any contacts of ``model``, closed from any state on; often from rest."""
    some = data.draw(st.sets(st.integers(0, model.m - 1), min_size=1))
    x = np.concatenate([data.draw(vectors(model.n)), data.draw(vectors(model.n))])
    if data.draw(st.booleans()):
        x[model.n :] = 0.0
    return started(model, data.draw(numbers(0, 3)), x, tuple(sorted(some)), fix=fix)


def unexplained(W: Array, push: Array) -> float:
    """What is left of ``push`` by impulses ``P >= 0`` on directions ``W``."""
    if not W.shape[1]:
        return float(np.linalg.norm(push))
    return float(optimize.nnls(W / np.linalg.norm(W, axis=0), push)[1])


def assert_is_a_motion(closed: Closed, seconds: float) -> None:
    """The equations of the theory, integrated over short pieces without a switch.

    ``M du = (-C u - K q + f) dt + W lambda dt`` with ``lambda_i >= 0`` where ``gamma_i`` gets down
    to zero and none elsewhere, ``gamma >= 0``, and ``dq = (u - Z gamma) dt``, ``Z = 0`` without
    fixed gaps. A piece has a switch where the integrals over its halves have another sum.
    """
    model, contacts = closed.system, list(closed.contacts)
    n, W = model.n, model.W[:, contacts]
    ends = np.linspace(0.0, seconds, 2 * PIECES + 1)
    half = seconds / PIECES / 4
    nodes = (ends[:-1, None] + half * (1 + NODES)).ravel()
    whole = (ends[:-2:2, None] + 2 * half * (1 + NODES)).ravel()
    edge, x, y = (closed.motion.states(s) for s in (ends, nodes, whole))
    size = 1 + float(np.max(np.abs(x)))
    Z = PositionProjection(model).jump(closed.contacts) if closed.fix else np.zeros(W.shape)

    def rates(s: Array, x: Array) -> Array:
        force = model.forcing.derivatives(closed.motion.t + s, 0)[0]
        force -= x[:, n:] @ model.C.T + x[:, :n] @ model.K.T
        return np.hstack([x[:, n:] - x[:, n:] @ W @ Z.T, force])

    summed = integral(rates(nodes, x), ends).reshape(PIECES, 2, -1).sum(axis=1)
    tolerance = 1e-10 * size * (1 + np.max(np.abs(model.K)) + np.max(np.abs(model.M)))
    smooth = np.max(np.abs(summed - integral(rates(whole, y), ends[::2])), axis=1) <= tolerance
    gamma = (x[:, n:] @ W).reshape(PIECES, 2 * NODES.size, -1)
    assert np.min(gamma) >= -1e-11 * size
    ended = edge[:, n:] @ W
    moving = np.concatenate([gamma, np.stack([ended[:-2:2], ended[1::2], ended[2::2]], 1)], 1)
    moves = moving > 1e-9 * size
    # A switch close to an edge changes the sums by less than the tolerance.
    smooth &= np.all(np.all(moves, axis=1) | ~np.any(moves, axis=1), axis=1)
    assert np.sum(~smooth) <= PIECES / 2
    change = edge[2::2] - edge[:-2:2]
    np.testing.assert_allclose(change[smooth, :n], summed[smooth, :n], atol=2 * tolerance)
    slow = np.min(gamma, axis=1) <= 1e-10 * size
    push = change[:, n:] @ model.M - summed[:, n:]
    for k in np.flatnonzero(smooth):
        assert unexplained(W[:, slow[k]], push[k]) <= 5 * tolerance
    if closed.fix:
        gaps = edge[:, :n] @ W
        np.testing.assert_allclose(gaps, gaps[[0] * len(gaps)], atol=1e-10 * size)


@pytest.mark.slow
@BOTH
@examples(150)
@given(st.data())
def test_every_motion_obeys_the_complementarity_of_speeds_and_loads(
    fix: bool, data: st.DataObject
) -> None:
    """Any contacts closed, redundant ones too, any state: no error, all equations hold."""
    model = data.draw(systems(max_n=3, contacts=(1, 4), common_restitution=True))
    assert_is_a_motion(drawn(data, model, fix=fix), 3.0)


@pytest.mark.slow
@examples(150)
@given(st.data())
def test_motions_with_integer_data_obey_it(data: st.DataObject) -> None:
    """Loads and speeds that are zero together, equal and opposite contacts."""
    model, x = data.draw(whole_numbers())
    closed = started(model, 0.0, x, tuple(range(model.m)), fix=data.draw(st.booleans()))
    assert_is_a_motion(closed, 5.0)


def test_a_load_that_is_always_zero_ends_in_no_search_without_end() -> None:
    """Of three contacts two hold the body; what is left for the third one is rounding."""
    model = system(
        np.eye(2),
        np.zeros((2, 2)),
        np.eye(2),
        contacts=[([-1, 0], 0.0, 0.5), ([-1, 1], 0.0, 0.5), ([-1, -1], 0.0, 0.5)],
        force=forcing(2, [1.0, 0.0], [Harmonic(2.0, [-1.0, -1.0], [1.0, 1.0])]),
    )
    start = np.array([1.0, 0.0, -1.0, -1.0])
    assert_is_a_motion(started(model, 0.0, start, (0, 1, 2), fix=False), 5.0)


def test_slipping_ball_is_caught_as_it_stops() -> None:
    """``gamma = v - 9.81 s``: the kinematic replica rises to ``v^2 / 2 g`` and stays there."""
    ball = system(1, 0, 0, contacts=[([1], 0.0, 0.5)], force=forcing(1, -9.81))
    s = np.linspace(0.0, 2.0, 41)
    v, stop = 3.0, 3.0 / 9.81
    flying = np.minimum(s, stop)
    speed = v - 9.81 * flying
    height = 0.25 + v * flying - 9.81 * flying**2 / 2
    kinematic = Clutches(ball).motion(0.0, np.array([0.25, v]), (0,), fix=False).states(s)
    np.testing.assert_allclose(kinematic, np.column_stack([height, speed]), atol=1e-14)
    geometric = Clutches(ball).motion(0.0, np.array([0.0, v]), (0,), fix=True).states(s)
    np.testing.assert_allclose(geometric, np.column_stack([0 * s, speed]), atol=1e-14)


def ratchet(s: Array, c: float, w: float, mass: float) -> Array:
    """A mass pressed by ``c - sin(w t)``, from rest: its displacement and speed.

    Released where ``sin(w t) = c``, caught where the speed is back at zero, then held until the
    load is used up again.
    """
    released = np.arcsin(c) / w

    def speed(t: float) -> float:
        return float((np.cos(w * released) - np.cos(w * t)) / w - c * (t - released))

    def way(t: float) -> float:
        start, since = w * released, t - released
        swing = np.cos(start) * since / w - (np.sin(w * t) - np.sin(start)) / w**2
        return float(swing - c * since**2 / 2)

    turn = 2 * np.pi / w
    # The speed rises until sin(w t) = c again and falls from there on.
    caught = optimize.brentq(speed, (np.pi - np.arcsin(c)) / w, released + turn, xtol=1e-15)
    found = []
    for at in s:
        turns, inside = divmod(at - released, turn)
        t = min(released + inside, caught)
        up = turns * way(caught) + way(t) if at >= released else 0.0
        found.append([up / mass, speed(t) / mass if at >= released else 0.0])
    return np.array(found)


@pytest.mark.parametrize(
    "frequency", [0.9, pytest.param(1.9838269257012868, marks=pytest.mark.slow), 5.5]
)
@pytest.mark.parametrize(
    "load", [0.3397695124299078, pytest.param(0.6095693498571635, marks=pytest.mark.slow), 0.9]
)
@pytest.mark.parametrize("mass", [0.34462461592702853, pytest.param(1.0, marks=pytest.mark.slow)])
def test_pressed_mass_is_released_and_caught_each_turn(
    frequency: float, load: float, mass: float
) -> None:
    """In closed form: released at the root of lambda, caught at that of gamma, for ten turns."""
    push = forcing(1, -load, [Harmonic(frequency, [0.0], [1.0])])
    model = system(mass, 0, 0, contacts=[([1], 0.0, 0.5)], force=push)
    s = np.linspace(0.0, 20 * np.pi / frequency, 201)
    expected = ratchet(s, load, frequency, mass)
    motion = Clutches(model).motion(0.0, np.zeros(2), (0,), fix=False)
    np.testing.assert_allclose(motion.states(s), expected, atol=2e-12 * (1 + expected.max()))
    fixed = Clutches(model).motion(0.0, np.zeros(2), (0,), fix=True).states(s)
    np.testing.assert_allclose(fixed[:, 1], expected[:, 1], atol=2e-12)
    np.testing.assert_allclose(fixed[:, 0], 0.0, atol=1e-15)


@BOTH
@examples(15)
@given(st.data())
def test_motion_does_not_depend_on_when_it_is_requested(fix: bool, data: st.DataObject) -> None:
    """One by one in any order, far ahead first: the same bits; at once, but for rounding."""
    model = data.draw(systems(max_n=3, contacts=(1, 3), common_restitution=True))
    one = drawn(data, model, fix=fix)
    s = np.array(data.draw(st.lists(numbers(0, 4), min_size=1, max_size=12)))
    singly = np.array([one.motion.state(float(at)) for at in s])
    ahead = Clutches(model).motion(one.motion.t, one.start, one.contacts, fix=fix)
    ahead.state(7.0)
    backwards = np.array([ahead.state(float(at)) for at in s[::-1]])
    np.testing.assert_array_equal(backwards[::-1], singly)
    # Products of matrices round differently with the number of samples.
    size = 1 + np.max(np.abs(singly))
    np.testing.assert_allclose(ahead.states(s), singly, atol=1e-13 * size)


@pytest.mark.slow
@BOTH
@examples(100)
@given(st.data())
def test_distance_of_two_replicas_never_grows_where_contacts_are_redundant(
    fix: bool, data: st.DataObject
) -> None:
    """More contacts than coordinates need, a common restitution, K singular or not."""
    model = data.draw(systems(max_n=5, contacts=(3, 6), common_restitution=True))
    contacts = tuple(range(model.m))
    s, t = np.linspace(0.0, 3.0, 49), data.draw(numbers(0, 3))
    runs = []
    for _ in range(2):
        x = np.concatenate([data.draw(vectors(model.n)), data.draw(vectors(model.n))])
        runs.append(started(model, t, x, contacts, fix=fix).motion.states(s))
    q, u = np.split(runs[0] - runs[1], 2, axis=1)
    V = (np.einsum("si,si->s", u @ model.M, u) + np.einsum("si,si->s", q @ model.K, q)) / 2
    size = max(float(np.max(np.abs(run))) for run in runs)
    assert np.max(np.diff(V)) <= 1e-9 * (1 + V[0]) + 1e-12 * size**2


def switches(closed: Closed, seconds: float) -> int:
    """How often some contact is caught or released, as far as samples show."""
    x = closed.motion.states(np.linspace(0.0, seconds, 2001))
    gamma = x[:, closed.system.n :] @ closed.system.W[:, list(closed.contacts)]
    return int(np.sum(np.diff(gamma > 1e-10 * (1 + np.max(np.abs(gamma))), axis=0) != 0))


def test_contact_that_is_pulled_slowly_beside_a_fast_one_is_released() -> None:
    """Its load falls by less than a part in 1e11 of what happens elsewhere."""
    slow, fast = 1e-6, 100.0
    model = system(
        np.eye(2),
        np.zeros((2, 2)),
        np.diag([0.0, fast**2]),
        contacts=[([1, 0], 0.0, 0.5)],
        force=forcing(2, 0, [Harmonic(slow, [0.0, 0], [1.0, 0])]),
    )
    motion = Clutches(model).motion(-0.5, np.array([0.0, 1, 0, 0]), (0,), fix=False)
    states = motion.states(np.array([0.25, 0.5, 3.5]))
    np.testing.assert_array_equal(states[:2, [0, 2]], 0.0)
    assert states[2, 2] == pytest.approx(slow * 3.0**2 / 2, rel=1e-6)


def test_loads_move_between_three_supports_of_a_rocking_bar() -> None:
    """The bar is pressed to and fro beyond its outer supports: it tips on either side."""
    supports = [([1, -1], 0.0, 0.5), ([1, 0], 0.0, 0.5), ([1, 1], 0.0, 0.5)]
    push = forcing(2, [-1.0, 0.0], [Harmonic(2.0, [0, 0], [0, 1.5])])
    model = system(
        np.diag([1, 0.5]), np.zeros((2, 2)), np.zeros((2, 2)), contacts=supports, force=push
    )
    for fix in (False, True):
        closed = started(model, 0.0, np.zeros(4), (0, 1, 2), fix=fix)
        assert_is_a_motion(closed, 6.0)
        assert 4 <= switches(closed, 6.0) <= 40


def test_contact_without_any_load_stays_closed() -> None:
    """In equilibrium on its stop, another mass moving: nothing switches for a hundred seconds."""
    model = system(
        np.eye(2),
        np.zeros((2, 2)),
        np.diag([2.0, 9.0]),
        contacts=[([1, 0], 0.0, 0.5), ([-1, 0], 0.0, 0.5)],
        force=forcing(2, 0, [Harmonic(2.0, [0, 1.0], [0, 0])]),
    )
    for contacts in ((0,), (1,), (0, 1)):
        motion = Clutches(model).motion(0.0, np.array([0, 1.0, 0, 0]), contacts, fix=False)
        states = motion.states(np.linspace(0.0, 100.0, 101))
        np.testing.assert_array_equal(states[:, [0, 2]], 0.0)


def sampled(time: list[float], force: list[float], hold: str) -> Forcing:
    """A recorded force on one coordinate."""
    return Forcing.of_samples(Samples(np.array(time), np.array(force)[:, None], hold))


def test_force_that_jumps_releases_at_its_jump() -> None:
    """Pressed for a second, pulled for one, pressed again: no contact waits for a root."""
    push = sampled([0.0, 1.0, 2.0, 10.0], [-1.0, 1.0, -1.0, -1.0], "previous")
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.5)], force=push)
    motion = Clutches(model).motion(0.0, np.zeros(2), (0,), fix=False)
    found = motion.states(np.array([1.0, 1.5, 2.0, 2.5, 3.0, 4.0]))
    expected = np.array([[0, 0], [0.125, 0.5], [0.5, 1], [0.875, 0.5], [1, 0], [1, 0]])
    np.testing.assert_allclose(found, expected, atol=1e-13)


@BOTH
def test_a_stamp_of_another_day_costs_no_more_than_hours(
    fix: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The phase stays after so many windows, whatever was requested before; here after fewer."""
    monkeypatch.setattr(clutch, "_SEARCHED", 500)
    pushed = forcing(1, -20.0, [Harmonic(2.5, [4.0], [0.0])])
    model = system([[1.0]], [[0.2]], [[20.0]], contacts=[([1.0], 0.0, 0.5)], force=pushed)
    first, second = (started(model, 0.0, np.zeros(2), (0,), fix=fix).motion for _ in range(2))
    day = 1e5
    for s in np.linspace(1.0, 200.0, 30):
        first.state(float(s))
    np.testing.assert_array_equal(first.state(day), second.state(day))
    assert np.all(np.isfinite(second.state(day)))
