# SPDX-License-Identifier: Apache-2.0
"""The plant against numbers that others published, and their closed forms.

What is published are a few digits each; the closed forms, in double or in fifty digits, are ours.
"""

from decimal import Decimal, localcontext

import numpy as np
import pytest
from contact_cases import approach, seconds
from systems import EPOCH, Harmonic, flow_of, forcing, run, sample, started, system

from impact_observer.events import Kind
from impact_observer.model import parse_model
from impact_observer.plant import Plant, Switching
from impact_observer.stamps import NS_PER_S


def crossed(plant: Plant, count: int) -> list[Switching]:
    """The next ``count`` switchings, all of them impacts and no more."""
    found = []
    for _ in range(count):
        switching = plant.next_switching(EPOCH + 1000 * NS_PER_S)
        assert switching is not None
        assert {switch.kind for switch in switching.switches} == {Kind.IMPACT}
        plant.cross(switching)
        found.append(switching)
    return found


def test_ball_bounces_at_the_published_times() -> None:
    """Eps 0.9 from 1 m: published are the first three, the closed form gives all before rest."""
    model = sample("bouncing_ball").system
    times = [seconds(impact) for impact in crossed(started(model, [1.0], [0.0]), 150)]
    published = [0.4515236409857308, 1.264266194760045, 1.995734493156927]
    np.testing.assert_allclose(times[:3], published, rtol=0, atol=1e-14)
    first = np.sqrt(2 / 9.81)
    flights = 2 * first * 0.9 ** np.arange(1, 150)
    expected = first + np.concatenate([[0], np.cumsum(flights)])
    np.testing.assert_allclose(times, expected, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_ball_comes_to_rest_at_the_published_time() -> None:
    """Published is the accumulation at 8.578949178728887 s; we stop up to 1e-7 s before it."""
    plant = started(sample("bouncing_ball").system, [1.0], [0.0])
    switchings = []
    while (switching := plant.next_switching(EPOCH + 20 * NS_PER_S)) is not None:
        plant.cross(switching)
        switchings.append(switching)
    assert [switch.kind for switch in switchings[-1].switches] == [Kind.CLOSE]
    # The first flight that is left out is no longer than 1e-8 s, and all of them ten times that.
    assert 0 <= 8.578949178728887 - seconds(switchings[-1]) <= 1e-7


def test_siconos_oscillator_hits_at_the_published_times() -> None:
    """LinearOscillatorED: m 1e-3, k 100, gravity, eps 0.9, a stop in the rest position.

    Published are the first three times and the first speed; the others of the 40 are closed form.
    """
    model = system(1e-3, 0, 100, contacts=[([1], 0.0, 0.9)], force=forcing(1, -9.81e-3))
    impacts = crossed(started(model, [1.0], [0.0]), 40)
    times = [seconds(impact) for impact in impacts]
    published = [0.004966983943888618, 0.01490088290077536, 0.02483470526778414]
    np.testing.assert_allclose(times[:3], published, rtol=0, atol=1e-15)
    assert approach(model, impacts[0]) == pytest.approx(-316.2587864392096, rel=1e-14)
    # x - s = (1 - s) cos wt at first. Thrown from x = 0 with v it comes back with -v, after the
    # root of s (1 - cos wt) + (v / w) sin wt = 0, which is tan(wt / 2) = -v / (w s).
    omega, static = np.sqrt(1e5), -9.81e-5
    speeds = omega * np.sqrt((1 - static) ** 2 - static**2) * 0.9 ** np.arange(40)
    first = np.arccos(-static / (1 - static)) / omega
    flights = 2 * np.arctan2(0.9 * speeds[:-1], -omega * static) / omega
    expected = first + np.concatenate([[0], np.cumsum(flights)])
    np.testing.assert_allclose(times, expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose([-approach(model, one) for one in impacts], speeds, rtol=1e-12)


def parabolas(count: int) -> tuple[list[float], list[int]]:
    """Instants and contacts of a ball between floor 0 and ceiling 1.5, one parabola a flight."""
    with localcontext() as context:
        context.prec = 50
        half, eps, heights = Decimal(5), Decimal("0.8"), (Decimal(0), Decimal("1.5"))
        t, y, v = Decimal(0), Decimal(1), Decimal(10)
        times, contacts = [], []
        for _ in range(count):
            # Ceiling, if it gets there: the earlier root; floor: the later one.
            reach = v * v - 4 * half * (heights[1] - y)
            upwards = v > 0 and reach > 0
            speed = reach.sqrt() if upwards else -(v * v + 4 * half * y).sqrt()
            t += (v - speed) / (2 * half)
            y, v = heights[upwards], -eps * speed
            times.append(float(t))
            contacts.append(int(upwards))
    return times, contacts


def test_siconos_ball_between_floor_and_ceiling_hits_at_the_published_times() -> None:
    """Two contacts, eps 0.8: three times are published, twenty are parabola by parabola."""
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.8), ([-1], 1.5, 0.8)], force=forcing(1, -10.0))
    impacts = crossed(started(model, [1.0], [10.0]), 20)
    times = [seconds(impact) for impact in impacts]
    published = [0.0513167019494863, 0.2283187800528825, 0.4665486160195453]
    np.testing.assert_allclose(times[:3], published, rtol=0, atol=1e-14)
    expected, contacts = parabolas(20)
    np.testing.assert_allclose(times, expected, rtol=0, atol=1e-11)
    assert [impact.contacts for impact in impacts] == [(i,) for i in contacts]


def test_coco_orbit_returns_after_one_period() -> None:
    """COCO's example 15.2: k 1, c 0.1, cos t, gap 1, eps 0.8; phase and speed are published.

    They are printed with sixteen digits; started on them, ten impacts come back to them.
    """
    model = system(
        1, 0.1, 1, contacts=[([-1], 1.0, 0.8)], force=forcing(1, 0, [Harmonic(1.0, [1], [0])])
    )
    phase, speed = 0.07595216493832649, 1.695732937594892
    x = flow_of(model).start(phase, np.array([1.0, -0.8 * speed])).state(2 * np.pi - phase)
    impacts = crossed(started(model, [x[0]], [x[1]]), 10)
    expected = phase + 2 * np.pi * np.arange(10)
    np.testing.assert_allclose([seconds(one) for one in impacts], expected, rtol=0, atol=1e-10)
    speeds = [-approach(model, one) for one in impacts]
    np.testing.assert_allclose(speeds, speed, rtol=0, atol=1e-10)


BALL_ON_MOVING_PLANE = """
name: BallOnMovingPlane
bodies: [{name: q, mass: 1}]
grounds: [{name: plane, motion: {harmonics: [{amplitude: %r, frequency: %r, phase: %r}]}}]
forces: [{body: q, constant: -9.81}]
stops: [{name: s, between: [plane, q], gap: 0, restitution: 0.9}]
"""


def test_siconos_ball_on_a_moving_plane_is_within_its_steps() -> None:
    """BallOnMovingPlane.ref of the Siconos tutorials (Apache-2.0, Siconos team): steps of 5 ms.

    The plane moves with 2 + cos(pi t / 2): ours are seen by an observer who moves with the 2 m/s.
    At its first hit, within a step of 5 ms, the speeds are those of its end.
    """
    omega = np.pi / 2
    text = BALL_ON_MOVING_PLANE % (1 / omega, omega, -omega)
    made = run(parse_model(text, "b").system, [1.0], [-2.0], seconds=2.4, rate=200.0)
    first, _, third = [(event.stamp - EPOCH) / NS_PER_S for event in made.events[:3]]
    assert 0.24 < first <= 0.245
    assert third == pytest.approx(2.2775, abs=4 * 0.005)
    t = (made.stamps - EPOCH) / NS_PER_S
    q, u = made.states[:, 0] + 2 * t, made.states[:, 1] + 2
    np.testing.assert_allclose((q[48], u[48]), (0.717472, -2.3544), atol=1e-9)
    np.testing.assert_allclose((q[59], u[59]), (1.10266081, 7.19211543), atol=9.81 * 0.005)
    np.testing.assert_allclose(q[400], 4.83582431, atol=3 * 10 * 0.005)


CAM_FOLLOWER = """
name: CamFollower
bodies: [{name: q, mass: 1.221}]
springs: [{between: [ground, q], stiffness: 1430.8}]
stops: [{name: s, body: q, limit: 0, side: below, restitution: 0.8}]
"""


def test_siconos_cam_follower_is_within_its_steps() -> None:
    """CamFollower-Rheonomous.ref of the Siconos tutorials (Apache-2.0, Siconos team): 0.1 ms.

    Its cam is only plotted: the relation of its plugin ends with ``y = q``, and the force is zero,
    so the stop is still. In CF.ref nothing moves at all. Each of its hits is within a step late.
    """
    made = run(parse_model(CAM_FOLLOWER, "c").system, [0.4], [0.4], seconds=1.0)
    published = {
        0: (0.0468, -13.69860822, 10.95888658),
        1: (0.1386, -10.95888718, 8.76710974),
        2: (0.2304, -8.76710666, 7.01368533),
        5: (0.5058, -4.48875858, 3.59100686),
        10: (0.9649, -1.47087469, 1.17669976),
    }
    assert len(made.switchings) == 11
    for k, (t, before, after) in published.items():
        hit = made.switchings[k]
        late = t - (hit.instant.stamp - EPOCH) / NS_PER_S
        assert 0 < late < 1e-4 * (k + 1)
        assert (hit.before[1], hit.after[1]) == pytest.approx((before, after), rel=1e-5)
