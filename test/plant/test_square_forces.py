# SPDX-License-Identifier: Apache-2.0
"""Square forces on the plant and on replicas, against closed forms and sampled forces."""

import math
from pathlib import Path

import numpy as np
import pytest
from contact_cases import kinds_in_order, seconds
from numpy.typing import NDArray
from systems import EPOCH, observer, run, system

from impact_observer.cli.main import main
from impact_observer.events import Kind
from impact_observer.model import Forcing, System, parse_model
from impact_observer.model.force_samples import Samples
from impact_observer.model.square_waves import SquareWaves

Array = NDArray[np.float64]

HAMMER = """
name: hammer
bodies: [{name: x1, mass: 1}, {name: x2, mass: 0.5}]
springs:
  - {between: [ground, x1], stiffness: 200, damping: 0.4}
  - {between: [x1, x2], stiffness: 100, damping: 0.2}
forces:
  - {body: x1, shape: square, amplitude: 8, hertz: 1.9, phase: 0.3}
  - {body: x2, shape: square, amplitude: -3, hertz: 0.7}
  - {body: x2, amplitude: 2, frequency: 5}
stops: [{name: anvil, body: x2, limit: 0.02, side: above, restitution: 0.6}]
initial_state: {position: [0, 0], velocity: [0, 0]}
"""


def square(omega: float, phase: float, size: float, constant: float = 0.0) -> Forcing:
    """A square wave and a constant on one coordinate."""
    none = np.zeros((0, 1))
    waves = SquareWaves(np.array([omega]), np.array([phase]), np.array([[size]]))
    return Forcing(np.array([constant]), np.zeros(0), none, none, squares=waves)


def as_samples(model: System, until: float) -> System:
    """The same system, its square forces given as samples at their switches."""
    waves = model.forcing.squares
    assert waves is not None
    instants = [0.0]
    for omega, phase in zip(waves.frequency, waves.phase, strict=True):
        k = np.arange(-2, until * omega / math.pi + 2)
        instants += [t for t in (math.pi / 2 + k * math.pi - phase) / omega if 0 < t < until]
    time = np.array(sorted(instants))
    middle = (time + np.append(time[1:], time[-1] + 1e-6)) / 2
    signs = np.sign(np.cos(np.outer(middle, waves.frequency) + waves.phase))
    forcing = model.forcing
    sampled = Forcing(
        forcing.constant,
        forcing.frequency,
        forcing.cosine,
        forcing.sine,
        Samples(time, signs @ waves.force, "previous"),
    )
    return System("test", model.coordinates, model.M, model.C, model.K, sampled, model.contacts)


def test_mass_on_a_spring_turns_about_the_two_ends_of_its_load() -> None:
    """In the plane of position and velocity over frequency, for a thousand switches."""
    own, omega, size, phase = 3.0, 7.3, 5.0, 0.4
    force = square(omega, phase, size)
    found = run(system(1, 0, own**2, force=force), [0.2], [-0.1], seconds=430.0, rate=10.0)
    x, t = np.array([0.2, -0.1 / own]), 0.0
    switches = (math.pi / 2 - phase + math.pi * np.arange(1100)) / omega
    sign, k, states = 1.0, 0, []
    for instant in np.arange(4301) / 10.0:
        while switches[k] <= instant:
            x, t = turned(x, own * (switches[k] - t), sign * size / own**2), switches[k]
            sign, k = -sign, k + 1
        states.append(turned(x, own * (instant - t), sign * size / own**2) * [1.0, own])
    assert k > 990
    np.testing.assert_allclose(found.states, states, rtol=0, atol=1e-11)


def turned(x: Array, angle: float, centre: float) -> Array:
    """``x`` turned about the point at rest (centre, 0)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([centre, 0.0]) + np.array([[c, s], [-s, c]]) @ (x - [centre, 0.0])


def test_impacts_are_those_of_a_force_sampled_at_the_switches() -> None:
    """Two square waves beside a harmonic, with impacts, over many switches."""
    model = parse_model(HAMMER, "hammer").system
    one = run(model, [0.0, 0.0], [0.0, 0.0], seconds=20.0)
    other = run(as_samples(model, 21.0), [0.0, 0.0], [0.0, 0.0], seconds=20.0)
    assert len(one.impacts) > 40
    assert [each.contacts for each in one.impacts] == [each.contacts for each in other.impacts]
    late = [
        a.instant.until(b.instant.stamp) + b.instant.remainder
        for a, b in zip(one.impacts, other.impacts, strict=True)
    ]
    np.testing.assert_allclose(late, 0.0, atol=1e-10)
    np.testing.assert_allclose(one.states, other.states, rtol=0, atol=1e-9)


@pytest.mark.parametrize("beyond", [0.0, 1e-13, 1e-10, 1e-6])
def test_impact_at_a_switch_is_not_skipped(beyond: float) -> None:
    """A free mass reaches its stop at the switch of its push, or ``beyond``, m."""
    omega = math.pi / 2
    gap = 0.5 + beyond
    model = system(1, 0, 0, contacts=[([-1], gap, 0.5)], force=square(omega, 0.0, 1.0))
    found = run(model, [0.0], [0.0], seconds=1.5)
    after = 1.0 - math.sqrt(1.0 - 2 * beyond)
    assert [each.contacts for each in found.impacts] == [(0,)]
    assert seconds(found.impacts[0]) == pytest.approx(1.0 + after, abs=1e-12)


def test_valve_releases_and_presses_a_mass_at_its_switches() -> None:
    """OPEN at each second switch; the mass comes back when the closed form says so.

    It goes away with 0.4 m/s2 for half a period, comes back with 1.6 m/s2, and stays.
    """
    half = 0.3
    force = square(math.pi / half, math.pi, 1.0, constant=-0.6)
    model = system(1, 0, 0, contacts=[([1], 0.0, 0.0)], force=force)
    found = run(model, [0.0], [0.0], seconds=600 * half).switchings
    back = (0.4 + math.sqrt(0.4**2 + 4 * 0.8 * 0.2)) / 1.6
    assert [kinds_in_order(each) for each in found[:3]] == [
        [Kind.CLOSE],
        [Kind.OPEN],
        [Kind.CLOSE],
    ]
    opened, closed = found[1::2], found[2::2]
    assert (len(opened), len(closed)) == (300, 299)
    first = half / 2
    expected = first + 2 * half * np.arange(len(opened))
    np.testing.assert_allclose([seconds(each) for each in opened], expected, rtol=0, atol=1e-10)
    np.testing.assert_allclose(
        [seconds(each) for each in closed], expected[:-1] + (1 + back) * half, rtol=0, atol=1e-10
    )


@pytest.mark.parametrize("law", ["open-loop", "kinematic", "geometric", "unilateral"])
def test_replica_that_starts_at_the_truth_stays_there(law: str) -> None:
    """Through switches and impacts, to the rounding of the stamps."""
    model = parse_model(HAMMER, "hammer").system
    found = run(model, [0.0, 0.0], [0.0, 0.0], seconds=6.0)
    replica = observer(model, law, np.zeros(4), epoch=EPOCH)
    for event in found.events if law != "open-loop" else ():
        replica.receive(event)
    first = found.impacts[0].instant.stamp
    last = first if law == "open-loop" else int(found.stamps[-1])
    kept = found.stamps < last
    estimates = [replica.estimate(int(stamp)) for stamp in found.stamps[kept]]
    states = [np.concatenate([each.q, each.u]) for each in estimates]
    assert sum(kept) > 20
    np.testing.assert_allclose(states, found.states[kept], rtol=0, atol=1e-6)


def test_the_filter_follows_a_square_force() -> None:
    """From a start that is off, by exact events: the flights break where the force switches."""
    model = parse_model(HAMMER, "hammer")
    whole = run(model.system, *model.initial_state(), seconds=10.0, rate=10.0)
    watcher = observer(
        model.system, "minimum-variance", np.concatenate(model.initial_state()) + 0.05, epoch=EPOCH
    )
    for each in whole.events:
        watcher.receive(each)
    last = watcher.estimate(int(whole.stamps[-1]))
    error = np.concatenate([last.q, last.u]) - whole.states[-1]
    assert np.max(np.abs(error)) < 1e-5


def test_commands_that_fit_refuse_a_square_force(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2 and one line; a bag with such a model is made, checked and observed."""
    model, bag = tmp_path / "hammer.yaml", str(tmp_path / "bag")
    model.write_text(
        HAMMER.replace("restitution: 0.6", "restitution: {value: 0.6, deviation: 0.1}")
    )
    assert main(["simulate", str(model), "--duration", "6", "-o", bag]) == 0
    assert main(["check-model", str(model)]) == 0
    assert "square force on x1" in capsys.readouterr().out
    words = ["observe", bag, "--law", "geometric", "-o", str(tmp_path / "estimate")]
    assert main(words) == 0
    capsys.readouterr()
    for name, *others in (("smooth",), ("identify", "--free", "restitution"), ("fit", str(model))):
        output = ["-o", str(tmp_path / f"{name}.yaml")]
        assert main([name, bag, *others, *output]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "shape" in line
