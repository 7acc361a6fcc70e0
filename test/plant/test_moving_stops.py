# SPDX-License-Identifier: Apache-2.0
"""The plant on moving grounds, against a closed form, other integrators and other frames."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import integrate, optimize
from systems import EPOCH, run

from impact_observer.model import Model, parse_model

Array = NDArray[np.float64]

OMEGA, AMPLITUDE, GRAVITY = 20 * np.pi, 0.003, 9.81
BALL = f"""\
name: ball
bodies: [{{name: z, mass: 0.1}}]
grounds:
  - name: table
    motion:
      harmonics: [{{amplitude: {AMPLITUDE}, frequency: {OMEGA!r}, phase: {-np.pi / 2!r}}}]
forces: [{{body: z, constant: {-0.1 * GRAVITY!r}}}]
stops: [{{name: plate, between: [table, z], gap: 0, restitution: 0.5}}]
"""
RIG = """\
name: rig
bodies:  [{name: x1, mass: 1}, {name: x2, mass: 2}]
grounds: [{name: base, motion: {harmonics: [{amplitude: 0.1, frequency: 3, phase: 0.4},
                                            {amplitude: 0.05, frequency: 7.1}]}}]
springs:
  - {between: [base, x1], stiffness: 10, damping: 0.3}
  - {between: [x1, x2], stiffness: 20, damping: 0.2}
  - {between: [x2, ground], stiffness: 5}
forces:  [{body: x2, amplitude: 4, frequency: 2.5}]
stops:
  - {name: foot, between: [base, x1], gap: 0.3, restitution: 0.5}
  - {name: head, body: x1, limit: 0.25, side: above, ground: base, restitution: 0.7}
  - {name: wall, body: x2, limit: 0.4, side: above, restitution: 0.6}
"""


def with_table(text: str, end: float, step: float) -> str:
    """A model whose ground moves by the table of a harmonic, sampled every ``step`` s."""
    t = np.arange(-0.1, end, step)
    s = AMPLITUDE * np.sin(OMEGA * t)
    rows = "".join(f"      {a!r},{b!r}\n" for a, b in zip(t.tolist(), s.tolist(), strict=True))
    head = text[: text.index("    motion:")]
    tail = text[text.index("forces:") :]
    return f"{head}    motion:\n     sampled: |\n      time,displacement\n{rows}{tail}"


def impacts(model: Model, x: Array, seconds: float) -> Array:
    """Instants of impacts, s since the epoch."""
    n = model.system.n
    found = run(model.system, x[:n], x[n:], seconds=seconds, rate=10.0).impacts
    return np.array([-each.instant.until(EPOCH) for each in found])


def phase_of_orbit() -> float:
    """Of the impact in the orbit of period one, rad, by momentum over one period."""
    cosine = np.pi * GRAVITY * (1 - 0.5) / ((1 + 0.5) * AMPLITUDE * OMEGA**2)
    return float(np.arccos(cosine))


def on_orbit(after: float, faster: float = 0.0) -> Array:
    """The ball ``after`` s after an impact of the orbit at the epoch's phase zero of the table."""
    speed = GRAVITY * np.pi / OMEGA  # a flight of one period
    table = AMPLITUDE * np.sin(phase_of_orbit())
    s, v = after, speed + faster
    return np.array([table + v * s - GRAVITY * s**2 / 2, v - GRAVITY * s])


def test_ball_on_a_table_settles_on_the_orbit_of_period_one() -> None:
    """The phase of its impacts is the closed one, and errors halve in modulus at each impact."""
    model = parse_model(BALL, "ball")
    phase = phase_of_orbit()
    assert phase == pytest.approx(0.5209, abs=1e-4)
    late = (2 * np.pi - phase) / OMEGA  # the epoch comes so long after an impact
    exact = impacts(model, on_orbit(late), 2.0)
    assert exact.size == 20
    np.testing.assert_allclose(np.mod(OMEGA * exact, 2 * np.pi), phase, atol=1e-10)
    once, twice = (
        np.mod(OMEGA * impacts(model, on_orbit(late, each), 2.0), 2 * np.pi) - phase
        for each in (1e-5, 2e-5)
    )
    error = 2 * once - twice / 2  # without what is quadratic in the disturbance
    assert np.max(np.abs(error[:2])) > 1e-5
    # The product of both multipliers is the restitution squared, and they are complex: over many
    # impacts the error falls by 0.5 each, as the energy of a pair of modes does.
    state = np.stack([error[:-1], error[1:]])
    map_, *_ = np.linalg.lstsq(state[:, :12].T, state[:, 1:13].T, rcond=None)
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(map_)), 0.5, atol=1e-3)


def test_table_that_is_sampled_is_the_harmonic_one() -> None:
    """Its speed, between the samples, is exact to the third order of the step."""
    start = np.array([0.004, 0.1])
    late = impacts(parse_model(BALL, "ball"), start, 1.0)[:10]
    errors = []
    for step in (4e-3, 5e-4):
        text = with_table(BALL, 1.2, step)
        found = impacts(parse_model(text, "ball"), start, 1.0)[:10]
        errors.append(np.max(np.abs(found - late)))
    assert errors[1] < 1e-7
    assert errors[1] < errors[0] / 100


def test_impacts_agree_with_a_runge_kutta_method() -> None:
    """DOP853 with events, in the coordinates themselves, with moving stops and springs."""
    model = parse_model(RIG, "rig")

    def table(t: float) -> tuple[float, float]:
        a, b = 3 * t + 0.4, 7.1 * t
        return (0.1 * np.cos(a) + 0.05 * np.cos(b), -0.3 * np.sin(a) - 0.355 * np.sin(b))

    def slope(t: float, y: Array) -> list[float]:
        (s, v), spring = table(t), 20 * (y[1] - y[0]) + 0.2 * (y[3] - y[2])
        one = 10 * (s - y[0]) + 0.3 * (v - y[2]) + spring
        two = -5 * y[1] - spring + 4 * np.cos(2.5 * t)
        return [y[2], y[3], one, two / 2]

    gaps = [
        lambda t, y: y[0] - table(t)[0] + 0.3,
        lambda t, y: 0.25 + table(t)[0] - y[0],
        lambda _, y: 0.4 - y[1],
    ]
    for gap in gaps:
        gap.terminal, gap.direction = True, -1  # type: ignore[attr-defined]
    y, t, expected = np.array([0.1, 0.0, 0.0, 0.5]), 0.0, []
    while t < 6.0:
        found = integrate.solve_ivp(
            slope, (t, 6.0), y, "DOP853", rtol=1e-12, atol=1e-13, events=gaps, max_step=0.05
        )
        t, y = float(found.t[-1]), found.y[:, -1].copy()
        if found.status != 1:
            break
        which = next(k for k in range(3) if found.t_events[k].size)
        v, eps, body = (table(t)[1], table(t)[1], 0.0)[which], (0.5, 0.7, 0.6)[which], which // 2
        y[2 + body] = v - eps * (y[2 + body] - v)
        expected.append(t)
    mine = run(model.system, [0.1, 0.0], [0.0, 0.5], seconds=6.0, rate=50.0)
    times = [-each.instant.until(EPOCH) for each in mine.impacts]
    assert len(expected) > 8
    np.testing.assert_allclose(times, expected, atol=2e-9)
    np.testing.assert_allclose(mine.states[-1], y, atol=1e-8)


def test_ball_rests_on_a_slow_table_and_leaves_it_when_that_falls_too_fast() -> None:
    """Persistent contact contains the table's acceleration: it opens at ``A w^2 sin = g``."""
    fast = 70.0
    text = BALL.replace(repr(OMEGA), repr(fast)).replace("phase: -1.57", "phase: 1.57")
    model = parse_model(text, "ball")  # -A sin
    v = -AMPLITUDE * fast
    found = run(model.system, [0.0], [v], seconds=0.1, rate=1000.0)
    opens = [each for each in found.switchings if each.closed == ()]
    # -A sin(w t) accelerates by +A w^2 sin(w t): it falls by more than g from the second half on.
    expected = (np.pi + np.arcsin(GRAVITY / (AMPLITUDE * fast**2))) / fast
    assert -opens[0].instant.until(EPOCH) == pytest.approx(expected, abs=1e-9)
    t = (found.stamps - EPOCH) * 1e-9
    on = t < expected
    table = -AMPLITUDE * np.sin(fast * t)
    np.testing.assert_allclose(found.states[on, 0], table[on], atol=1e-15)
    np.testing.assert_allclose(
        found.states[on, 1], -AMPLITUDE * fast * np.cos(fast * t[on]), atol=1e-13
    )
    assert np.all(found.states[:, 0] >= table - 1e-15)


BETWEEN = """\
name: between
bodies: [{{name: plate, mass: {0!r}}}, {{name: ball, mass: 1}}]
grounds: [{{name: table, motion: {{harmonics: [{{amplitude: 0.02, frequency: 40}}]}}}}]
springs: [{{between: [table, plate], stiffness: {1!r}, damping: {2!r}}}]
forces: [{{body: ball, constant: -9.81}}]
stops:
  - {{name: foot, between: [plate, ball], gap: 0, restitution: 0.6}}
  - {{name: head, body: ball, limit: 0.05, side: above, restitution: 0.6}}
"""


def between_table_and_ceiling(count: int) -> Array:
    """Impacts of a ball from rest at 0.03 m, s, each where the first of both gaps closes."""
    t, q, u = 0.0, 0.03, 0.0
    found: list[float] = []
    while len(found) < count:
        s = np.arange(1e-7, 1.0, 1e-4)

        def gaps(s: Array, t: float = t, q: float = q, u: float = u) -> Array:
            ball = q + u * s - GRAVITY * s**2 / 2
            return np.stack([ball - 0.02 * np.cos(40 * (t + s)), 0.05 - ball])

        k = int(np.argmax(np.any(gaps(s) < 0, axis=0)))
        hit = int(np.argmin(gaps(s)[:, k]))
        last = optimize.brentq(lambda s, i=hit, g=gaps: g(s)[i], s[k - 1], s[k], xtol=1e-14)
        table = 0.0 if hit else -0.8 * np.sin(40 * (t + last))
        q, u = q + u * last - GRAVITY * last**2 / 2, u - GRAVITY * last
        t, u = t + last, table - 0.6 * (u - table)
        found.append(t)
    return np.array(found)


def test_heavy_body_on_a_stiff_spring_is_a_table_below_a_ceiling_at_rest() -> None:
    """Stops that move against each other, by the recipe of docs/model.md: as exact as it says."""
    exact = between_table_and_ceiling(12)
    for mass, off in ((1e4, 3e-4), (1e6, 3e-6)):
        text = BETWEEN.format(mass, 1e9 * mass, 6.3e4 * mass)
        found = impacts(parse_model(text, "between"), np.array([0.02, 0.03, 0.0, 0.0]), 1.0)
        np.testing.assert_allclose(found[:12], exact, rtol=0, atol=off)
