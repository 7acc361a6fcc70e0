# SPDX-License-Identifier: Apache-2.0
"""Smoothed recordings: against a fit of simulated instants, and the filter where both agree."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from conditioning import conditioned
from scipy import optimize
from systems import EPOCH, sample

from impact_observer.errors import DynamicsError
from impact_observer.events import ImpactEvent, Ruling, Switch
from impact_observer.model import Model, System, parse_model
from impact_observer.model.measurement import Measurement
from impact_observer.observer import make_observer, replay
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options
from impact_observer.plant import Plant, SensorModel, simulate, simulate_sensor
from impact_observer.smooth import SmoothedMotion, smoothed_runs
from impact_observer.smooth.chain import Chain
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate, Vector

JITTER = 1e-3
DEVIATION = 0.02
"""Of a start that is nearly known."""
SURE = Options(
    law="minimum-variance",
    clock_error=JITTER,
    model_error=0.0,
    missed=0.0,
    spurious=0.0,
    mislabelled=0.0,
    ensemble=1,
)
"""Every event is trusted, so that the least squares have no choice."""
PRESSED = """
name: pressed
bodies: [{name: x1, mass: 1}, {name: x2, mass: 0.5}]
springs:
  - {between: [ground, x1], stiffness: 30, damping: 0.3}
  - {between: [x1, x2], stiffness: 20, damping: 0.2}
forces: [{body: x2, constant: 4}, {body: x1, amplitude: 6, frequency: 3.1}]
stops: [{name: stop, body: x2, limit: 0.1, side: above, restitution: 0.4}]
initial_state: {position: [0.05, -0.2], velocity: [0.4, 0]}
"""

DRILL = """
name: drill
bodies: [{name: machine, mass: 1.2}, {name: bit, mass: 0.4}]
springs:
  - {between: [ground, machine], stiffness: 2000, damping: 12}
  - {between: [machine, bit], stiffness: 9000, damping: 6}
forces: [{body: machine, amplitude: 60, frequency: 125.6637}]
stops: [{name: anvil, body: bit, limit: 0.001, side: above, restitution: 0.6}]
"""


def rig(name: str) -> Model:
    """A model of the samples, or one with another stop."""
    if name == "without rebound":
        return parse_model(PRESSED.replace("0.4}", "0}"), name)
    return sample(name)


def recording(
    system: System, x: Vector, seconds: float, sensor: SensorModel, seed: int = 1
) -> list[ImpactEvent]:
    """The events that a sensor makes of a plant that starts at ``x``."""
    last = EPOCH + round(seconds * NS_PER_S)
    run = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), np.array([last]))
    made = simulate_sensor(sensor, system, run.switchings, epoch=EPOCH, last=last, seed=seed)
    return [each.event for each in made]


def smoothed(
    system: System,
    events: Sequence[ImpactEvent],
    options: Options,
    samples: Sequence[SensorSample] = (),
) -> SmoothedMotion:
    """The motion of a recording of one run, with ``samples`` of an encoder if any."""
    sensors = (encoder(system),) if samples else ()
    (motion,) = smoothed_runs(system, events, options, measurements=sensors, samples=samples)
    return motion


def encoder(system: System) -> Measurement:
    """Of the first coordinate, with errors of 5 mm."""
    name = system.coordinates[0]
    return Measurement(
        "encoder", "/encoder", field="data", position=((name, 1.0),), deviation=5e-3
    )


def encoded(system: System, x: Vector, seconds: float, rate: float) -> list[SensorSample]:
    """Its samples of a plant that starts at ``x``."""
    stamps = EPOCH + np.arange(1, round(seconds * rate)) * round(NS_PER_S / rate)
    states = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), stamps).states
    errors = 5e-3 * np.random.default_rng(3).normal(size=len(stamps))
    return [
        SensorSample(0, stamp, value)
        for stamp, value in zip(stamps.tolist(), (states[:, 0] + errors).tolist(), strict=True)
    ]


def states(motion: SmoothedMotion, seconds: Sequence[float]) -> list[Estimate]:
    """Estimates at some instants, s since the epoch."""
    stamps = np.array([EPOCH + round(each * NS_PER_S) for each in seconds])
    return [each for batch in motion.estimates(stamps) for each in batch]


def about(x: Vector, deviation: float, **others: object) -> Options:
    """Every event is trusted; the start has this deviation about ``x``."""
    start = ",".join(f"{each:.17g}" for each in x)
    given = {"initial_state": start, "initial_deviation": f"{deviation}", **others}
    return Options(**{**SURE.__dict__, **given})


@pytest.mark.parametrize(
    ("name", "rate", "learned"),
    [
        ("two_mass", 0, {}),
        ("three_mass", 20, {}),
        ("without rebound", 20, {}),
        (
            "two_mass",
            10,
            {
                "model_error": 0.05,
                "clock_offset_error": 0.02,
                "estimate_parameters": ("stiffness-scale",),
            },
        ),
    ],
)
def test_states_are_those_of_conditioning_on_all_events(
    name: str, rate: float, learned: dict[str, object]
) -> None:
    """About the same path: with jumps that lose directions, and contact that stays.

    An encoder with some samples a second may be beside them.
    """
    model = rig(name)
    x = np.concatenate(model.initial_state())
    seconds = 4.0 if name == "without rebound" else 12.0
    events = recording(model.system, x, seconds, SensorModel(jitter=JITTER))
    samples = encoded(model.system, x, seconds, rate) if rate else []
    options = about(x, 0.1, **learned)
    arc, path, *_ = smoothed(model.system, events, options, samples).smoothed
    assert any(node.group for node in arc.nodes(path)) == bool(rate)
    steps = [arc.step(path, node) for node in arc.nodes(path)]
    chain = Chain(arc.first, len(steps), steps.__getitem__)
    found = dict(chain.states())
    means, covariances, density = conditioned(arc.first, steps)
    for k in range(-1, len(steps)):
        np.testing.assert_allclose(found[k].mean, means[k + 1], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found[k].covariance, covariances[k + 1], atol=1e-11)
    assert chain.evidence == pytest.approx(density + sum(each.density for each in steps))
    ranks = [int(np.linalg.matrix_rank(each.A)) for each in steps]
    assert (min(ranks) < x.size) == (name == "without rebound")


@pytest.mark.parametrize(
    ("name", "learned"),
    [
        ("two_mass", {}),
        ("two_mass", {"clock_offset_error": 0.02}),
        ("without rebound", {}),
    ],
)
def test_states_are_those_of_conditioning_on_exact_stamps(
    name: str, learned: dict[str, object]
) -> None:
    """With stamps of 1 ns, in decimal arithmetic: deviations fall from 0.1 to 1e-9.

    Each number of a covariance is the filter's to 1e-9 of its deviations at the same instant; of
    its own it loses the 1e-8 by which they fall, times the rounding of doubles. Means, in SI
    units, are as exact as a double can be.
    """
    model = rig(name)
    x = np.concatenate(model.initial_state())
    events = recording(model.system, x, 4.0 if name == "without rebound" else 12.0, SensorModel())
    options = about(x, 0.1, clock_error=0.0, **learned)
    arc, path, *_ = smoothed(model.system, events, options).smoothed
    steps = [arc.step(path, node) for node in arc.nodes(path)]
    chain = Chain(arc.first, len(steps), steps.__getitem__)
    found = dict(chain.states())
    means, covariances, density = conditioned(arc.first, steps, precise=True)
    for k in range(-1, len(steps)):
        np.testing.assert_allclose(found[k].mean, means[k + 1], rtol=1e-13, atol=1e-13)
        _, filtered = next(Chain(arc.first, k + 1, steps.__getitem__).states())
        error = np.abs(found[k].covariance - covariances[k + 1])
        own = np.sqrt(np.diag(covariances[k + 1]))
        for deviations, tolerance in ((filtered.deviations, 1e-9), (own, 1e-7)):
            scale = np.maximum(deviations, 1e-16)
            assert np.all(error <= tolerance * np.outer(scale, scale))
    assert chain.evidence == pytest.approx(density + sum(each.density for each in steps), abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "rate", "learned"),
    [
        ("two_mass", 0, ()),
        ("two_mass", 10, ()),
        ("two_mass", 0, ("mass-scale", "restitution")),
        ("two_mass", 10, ("gap", "stiffness-scale")),
    ],
)
def test_start_is_that_of_a_fit_of_simulated_instants(
    name: str, rate: float, learned: tuple[str, ...]
) -> None:
    """The likeliest start and parameters: instants of the event-driven plant, fitted by SciPy.

    An encoder with some samples a second may be beside the impacts.

    Their covariance follows from the derivatives of the instants, by differences.
    """
    model = rig(name)
    system, x = model.system, np.concatenate(model.initial_state())
    events = recording(system, x, 12.0, SensorModel(jitter=JITTER))
    reported = np.array([each.stamp for each in events])
    samples = [
        each
        for each in (encoded(system, x, 12.0, rate) if rate else ())
        if each.stamp < reported[-1] and np.min(np.abs(each.stamp - reported)) > 5e-3 * NS_PER_S
    ]
    values = np.array([each.value for each in samples])
    last = [*(each.stamp for each in samples), int(reported[-1]) + NS_PER_S // 5]
    options = about(x, DEVIATION, estimate_parameters=learned)
    motion = smoothed(system, events, options, samples).smoothed
    found, prior, family = motion.first, motion.arc.first, motion.arc.filter.members.family

    def residuals(y: Vector) -> Vector:
        plant = Plant(family.system_at(y[x.size :]), *np.split(y[: x.size], 2), epoch=EPOCH)
        run = simulate(plant, np.array(last))
        errors = [
            (e.stamp - s.instant.stamp) * 1e-9 - s.instant.remainder
            for e, s in zip(events, run.impacts, strict=True)
        ]
        seen = (run.states[: len(samples), 0] - values) / 5e-3
        declared = (y - prior.mean) / prior.deviations
        return np.concatenate([np.array(errors) / JITTER, seen, declared])

    scale = np.concatenate([np.full(x.size, 1e-2), prior.deviations[x.size :]])
    fit = optimize.least_squares(residuals, prior.mean, x_scale=scale, diff_step=1e-5, xtol=1e-12)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    deviations = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.deviations, deviations, rtol=2e-3)
    assert np.all(np.abs(found.mean - fit.x) < 2e-3 * deviations)


@pytest.mark.slow
def test_last_state_is_the_filters() -> None:
    """With nothing after it the smoother knows what the filter does."""
    model = sample("three_mass")
    system, x = model.system, np.concatenate(model.initial_state())
    events = recording(system, x, 15.0, SensorModel(jitter=JITTER))
    last = np.array([EPOCH + 15 * NS_PER_S])
    options = about(x + 0.01, 0.02)
    (own,) = [
        each
        for each in replay(make_observer(system, options), events, last)
        if isinstance(each, Estimate)
    ]
    (found,) = states(smoothed(system, events, options), [15.0])
    deviations = np.sqrt(np.diag(own.covariance))
    difference = np.append(found.q - own.q, found.u - own.u)
    assert np.all(np.abs(difference) < 0.05 * deviations)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), deviations, rtol=0.05)


@pytest.mark.slow
def test_start_is_exact_though_impacts_are_missed_and_false() -> None:
    """Exact stamps: the account is found, and the start to nanometres, from zero."""
    model = sample("two_mass")
    system, x = model.system, np.concatenate(model.initial_state())
    sensor = SensorModel(missed=0.2, spurious=0.15)
    events = recording(system, x, 16.0, sensor, seed=4)
    motion = smoothed(system, events, Options(law="minimum-variance"))
    (found,) = states(motion, [0.0])
    assert np.max(np.abs(np.append(found.q, found.u) - x)) < 1e-7
    rulings = [each.ruling for each in motion.account.verdicts]
    assert Ruling.INSERTED in rulings
    assert Ruling.REJECTED in rulings
    inserted = [each for each in motion.impacts() if each.ruling is Ruling.INSERTED]
    ideal = {each.stamp for each in recording(system, x, 16.0, SensorModel())}
    assert inserted
    assert all(min(abs(each.stamp - stamp) for stamp in ideal) <= 1 for each in inserted)
    assert all(each.reported == 0 for each in inserted)


@pytest.mark.slow
def test_samples_that_are_far_from_the_motion_are_rejected() -> None:
    """A tenth of them is off by half a metre; impacts are missed and false, and found by them."""
    model = sample("two_mass")
    system, x = model.system, np.concatenate(model.initial_state())
    sensor = SensorModel(jitter=JITTER, missed=0.2, spurious=0.15)
    events = recording(system, x, 10.0, sensor, seed=3)
    samples = [
        each._replace(value=each.value + 0.5 * (k % 10 == 0))
        for k, each in enumerate(encoded(system, x, 10.0, 20))
    ]
    options = Options(law="minimum-variance", clock_error=JITTER)
    motion = smoothed(system, events, options, samples)
    seconds = [0.0, 2.0, 5.0]
    stamps = np.array([EPOCH + round(each * NS_PER_S) for each in seconds])
    truth = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), stamps).states
    for each, true in zip(states(motion, seconds), truth, strict=True):
        error = np.append(each.q, each.u) - true
        assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(each.covariance)))
        assert np.all(np.abs(error) < 0.02)
    used, rejected = motion.smoothed.arc.samples
    until = motion.account.moments[-1].change.t
    far = {k for k, each in enumerate(used) if k % 10 == 0 and each.t < until}
    assert far <= rejected
    assert sum(used[k].t < until for k in rejected) <= len(far) + 3


@pytest.mark.slow
def test_states_are_exact_through_accumulating_impacts_and_contact_that_stays() -> None:
    """Closed contacts, their releases, and the gap of a closed one is zero."""
    model = parse_model(PRESSED, "pressed")
    system, x = model.system, np.concatenate(model.initial_state())
    events = recording(system, x, 6.0, SensorModel())
    motion = smoothed(system, events, Options(law="minimum-variance", clock_error=0.0))
    plant = Plant(system, *np.split(x, 2), epoch=EPOCH)
    seconds = [0.0, 0.33, 0.65, 2.2, 3.1, 4.1, 5.3]
    truth = simulate(plant, np.array([EPOCH + round(s * NS_PER_S) for s in seconds])).states
    found = states(motion, seconds)
    for each, true in zip(found, truth, strict=True):
        np.testing.assert_allclose(np.append(each.q, each.u), true, atol=1e-6)
        assert not each.closed or abs(system.gap(each.q)[0]) < 1e-9
    assert any(each.closed for each in found)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 5])
def test_a_contact_that_chatters_faster_than_stamps_are_exact(seed: int) -> None:
    """Jitter of 1 ms, in which the last flights of each chattering sequence are lost.

    The states are as exact as their covariance says, though the start is wrong by 0.1.
    """
    model = parse_model(PRESSED, "pressed")
    system, x = model.system, np.concatenate(model.initial_state())
    events = recording(system, x, 6.0, SensorModel(jitter=JITTER), seed)
    stamps = [each.stamp for each in events]
    assert stamps != sorted(stamps)
    start = x + np.random.default_rng(seed).normal(scale=0.1, size=x.size)
    declared = Options(
        law="minimum-variance",
        initial_state=",".join(f"{each:.17g}" for each in start),
        initial_deviation="0.1",
        clock_error=JITTER,
    )
    motion = smoothed(system, events, declared)
    assert not motion.misfit
    assert {each.ruling for each in motion.account.verdicts} == {Ruling.APPLIED}
    seconds = [0.0, 0.3, 1.0, 2.2, 3.1, 4.1]
    instants = np.array([EPOCH + round(s * NS_PER_S) for s in seconds])
    truth = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), instants).states
    for each, true in zip(states(motion, seconds), truth, strict=True):
        error = np.append(each.q, each.u) - true
        assert each.synchronized
        assert each.last_event >= max([0, *(s for s in stamps if s <= each.stamp)])
        assert np.all(np.abs(error) < 4 * np.sqrt(np.diag(each.covariance)) + 1e-12)
        assert np.all(np.abs(error) < 0.05)


@pytest.mark.slow
def test_states_between_events_do_not_depend_on_which_are_asked_for() -> None:
    """With white accelerations both ends of a flight tell of a state within it."""
    model = sample("two_mass")
    system, x = model.system, np.concatenate(model.initial_state())
    events = recording(system, x, 8.0, SensorModel(jitter=JITTER))
    options = Options(**{**SURE.__dict__, "model_error": 0.05})
    motion = smoothed(system, events, options)
    alone = states(motion, [3.1])
    among = states(motion, [0.1, 2.0, 3.0, 3.1, 3.2, 6.0])
    np.testing.assert_allclose(alone[0].q, among[3].q, atol=1e-9)
    np.testing.assert_allclose(alone[0].covariance, among[3].covariance, rtol=1e-6, atol=1e-12)
    sure = states(smoothed(system, events, SURE), [3.1])
    assert np.all(np.diag(alone[0].covariance) > np.diag(sure[0].covariance))


@pytest.mark.slow
def test_parameters_and_offset_are_learned_with_the_motion() -> None:
    """A stiffness that is 2 % wrong and stamps that are 10 ms late, from exact instants."""
    model = sample("two_mass")
    x = np.concatenate(model.initial_state())
    events = recording(model.system, x, 20.0, SensorModel(delay=0.01))
    text = model.text().replace("20.0", "19.6").replace("10.0", "9.8")
    wrong = parse_model(text, "softer")
    np.testing.assert_allclose(wrong.system.K, 0.98 * model.system.K)
    options = Options(
        law="minimum-variance",
        clock_error=0.0,
        clock_offset_error=0.02,
        estimate_parameters=("stiffness-scale",),
    )
    motion = smoothed(wrong.system, events, options)
    learned = {name: value for name, value, _ in motion.parameters}
    assert learned["stiffness-scale"] == pytest.approx(1 / 0.98, rel=1e-6)
    assert learned["clock_offset"] == pytest.approx(0.01, abs=1e-6)
    assert not motion.misfit
    assert states(motion, [5.0])[0].synchronized


@pytest.mark.slow
def test_impacts_that_no_motion_explains_are_warned_of() -> None:
    """At random instants, one of them twice; states are finite and not synchronized."""
    system = sample("two_mass").system
    times = [0.956, 2.0478, 2.2566, 3.3849, 5.2355, 6.236, 6.236, 7.2697, 8.0081, 9.4059]
    name = Switch(system.contact_names[0])
    events = [
        ImpactEvent(EPOCH + round(t * NS_PER_S), (name,), k + 1, 0, EPOCH)
        for k, t in enumerate(times)
    ]
    motion = smoothed(system, events, Options(law="minimum-variance"))
    assert "more than 5 deviations" in motion.misfit
    for each in states(motion, [0.0, 3.0, 9.5, 12.0]):
        assert np.all(np.isfinite(np.append(each.q, each.u)))
        assert not each.synchronized


def test_an_account_in_which_a_gap_that_stands_still_hits_is_no_obstacle() -> None:
    """A filter inserts impacts at the epoch, where the declared start stands still.

    The stamps are those of a simulated drill with a restitution of 0.6.
    """
    system = parse_model(DRILL, "drill").system
    microseconds = [12592, 112450, 169441, 260199, 273792, 362570, 380665, 463168]
    events = [
        ImpactEvent(EPOCH + 1000 * each, (Switch("anvil"),), k + 1)
        for k, each in enumerate(microseconds)
    ]
    options = Options(
        law="minimum-variance",
        clock_error=5e-6,
        epoch=EPOCH,
        estimate_parameters=("restitution=0.01",),
    )
    motion = smoothed(system, events, options)
    ((_, value, deviation),) = motion.parameters
    assert abs(value - 0.6) < 3 * deviation < 0.01
    made = states(motion, [0.0, 0.1, 0.2, 0.3, 0.4])
    assert np.all(np.isfinite([[*each.q, *each.u] for each in made]))
    assert np.all(np.isfinite([each.covariance for each in made]))


def test_a_motion_that_grows_beyond_all_bounds_ends_with_one_line() -> None:
    """A ball that has fallen for a day before its first reported impact."""
    ball = sample("bouncing_ball").system
    events = [ImpactEvent(EPOCH + 86400 * NS_PER_S, (Switch("floor"),), 1)]
    with pytest.raises(DynamicsError, match=r"grows beyond 1e\+09 m"):
        smoothed(ball, events, replace(SURE, epoch=EPOCH))


@pytest.mark.slow
def test_another_account_that_is_nearly_as_likely_is_warned_of() -> None:
    """The sensor missed the first impact, and the account that is taken does not say so."""
    model = sample("two_mass")
    system, x = model.system, np.concatenate(model.initial_state())
    events = recording(system, x, 30.0, SensorModel(jitter=JITTER, missed=0.2, spurious=0.13), 9)
    wrong = ",".join(f"{each:.17g}" for each in x + np.random.default_rng(9).normal(size=x.size))
    options = Options(law="minimum-variance", initial_state=wrong, clock_error=JITTER)
    motion = smoothed(system, events, options)
    text, until = motion.early_doubt
    assert 0.003 < motion.doubt.odds <= 1.0
    assert text.startswith("another account of the events before ")
    first, last = states(motion, [0.5, 25.0])
    assert first.stamp < until < last.stamp
    assert first.misfit == text
    assert not first.synchronized
    assert last.synchronized
    true = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), np.array([first.stamp])).states
    error = np.append(first.q, first.u) - true[0]
    assert np.any(np.abs(error) > 5 * np.sqrt(np.diag(first.covariance)))  # it is wrong


@pytest.mark.slow
def test_start_far_from_the_declared_one_is_warned_of() -> None:
    """By 20 declared deviations; what is later is not in doubt."""
    model = sample("two_mass")
    system, x = model.system, np.concatenate(model.initial_state())
    events = recording(system, x, 12.0, SensorModel(jitter=JITTER))
    motion = smoothed(system, events, about(x + np.array([0.2, 0, 0, 0]), 0.01))
    assert "from the declared one" in motion.early_doubt[0]
    first, last = states(motion, [0.1, 11.5])
    assert not first.synchronized
    assert last.synchronized
    assert not smoothed(system, events, about(x, 0.01)).early_doubt[0]


@pytest.mark.slow
def test_ball_from_its_bounce_times_alone() -> None:
    """No epoch: the first stamp is the start, and the speed there that of a fall from 1 m."""
    system = sample("bouncing_ball").system
    first, eps = np.sqrt(2 / 9.81), 0.9
    flights = 2 * first * eps ** np.arange(1, 9)
    stamps = np.rint(1e9 * (2 + np.append(0.0, np.cumsum(flights)))).astype(int).tolist()
    events = [ImpactEvent(stamp, (Switch(system.contact_names[0]),)) for stamp in stamps]
    motion = smoothed(system, events, Options(law="minimum-variance"))
    after = next(iter(motion.estimates(np.array([stamps[0] + 1])))).first
    speed = eps * np.sqrt(2 * 9.81)
    assert after.u[0] == pytest.approx(speed, abs=1e-6)
    assert np.sqrt(after.covariance[1, 1]) < 1e-4  # nine stamps say little of their accuracy


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "until", "seconds"),
    [
        ("ball_on_table", 1.0, [0.0, 0.21, 0.55, 0.93]),
    ],
)
def test_states_are_exact_on_stops_that_move_or_drive_and_while_hits_last(
    name: str, until: float, seconds: list[float]
) -> None:
    """Estimates are coordinates of the model, whatever frame the computation has.

    Of a hit that lasts they are looked at before its jump and after it, too.
    """
    model = rig(name)
    x = np.concatenate(model.initial_state())
    events = recording(model.system, x, until, SensorModel())
    motion = smoothed(model.system, events, Options(law="minimum-variance"))
    hit = (events[3].stamp - EPOCH) * 1e-9
    seconds = sorted([*seconds, hit + 0.0015, hit + 0.0025])
    stamps = np.array([EPOCH + round(each * NS_PER_S) for each in seconds])
    truth = simulate(Plant(model.system, *np.split(x, 2), epoch=EPOCH), stamps).states
    for each, true in zip(states(motion, seconds), truth, strict=True):
        np.testing.assert_allclose(np.append(each.q, each.u), true, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seconds"), [("two_mass", 30), pytest.param("three_mass", 40, marks=pytest.mark.long)]
)
def test_errors_are_as_large_as_the_covariance_says_in_all_directions(
    name: str, seconds: int
) -> None:
    """In the last half of a recording, where errors in some directions have faded.

    The normalised estimation error squared over 2n of 12 runs: their mean is about 1.
    """
    system, x = sample(name).system, np.concatenate(sample(name).initial_state())
    half, size, found = 0.5 * seconds, x.size, list[float]()
    for seed in range(12):
        events = recording(system, x, seconds, SensorModel(jitter=JITTER), seed)
        rng, hits = np.random.default_rng(seed), np.array([each.stamp for each in events])
        stamps = EPOCH + (rng.uniform(half, seconds, 30) * NS_PER_S).astype(np.int64)
        far = np.min(np.abs(stamps[:, None] - hits), axis=1) > 10 * JITTER * NS_PER_S
        stamps = np.unique(stamps[far & (stamps < hits[-1])])
        truth = simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), stamps).states
        motion = smoothed(system, events, about(x + rng.normal(size=size), 1.0))
        made = [one for some in motion.estimates(stamps) for one in some]
        for each, true in zip(made, truth, strict=True):
            error = np.append(each.q, each.u) - true
            found.append(float(error @ np.linalg.solve(each.covariance, error)) / size)
    assert 0.5 < np.mean(found) < 2
