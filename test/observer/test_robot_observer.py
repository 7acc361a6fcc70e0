# SPDX-License-Identifier: Apache-2.0
"""An observer of a robot: velocities through impacts from encoders, efforts and impact times."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from robot_runs import (
    EPOCH,
    JITTER,
    RATE,
    TORQUES,
    Recording,
    Truth,
    differences,
    encoders,
    filtered,
    known_model,
    observer_of,
    without_contacts,
    wrong_plant,
)

from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import Model, read_model
from impact_observer.model.forcing import Forcing
from impact_observer.observer import make_observer
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options
from impact_observer.robots import Robot
from impact_observer.stamps import from_seconds
from impact_observer.states import Vector

DECLARED = Options(law="minimum-variance", clock_error=JITTER, epoch=EPOCH)
MODEL = known_model()
"""Of hammer_arm, five percent wrong."""


def recorded(seed: int, seconds: float) -> Recording:
    """A motion of hammer_arm."""
    plant = wrong_plant(MODEL)
    return Truth.of_plant(plant, MODEL.initial_state(), RATE, seconds).recorded(seed)


def test_velocities_are_known_through_a_hit_with_a_model_that_is_wrong() -> None:
    """The plant's own velocities: far better than without the jump or by differences."""
    recording = recorded(seed=1, seconds=1.3)
    observer = observer_of(MODEL, recording)
    error = recording.error(filtered(observer, recording).speeds)
    free = observer_of(without_contacts(MODEL, 1.0), recording)
    assert error < 0.3
    assert error < recording.error(filtered(free, recording, hits=False).speeds) / 6
    assert error < recording.error(differences(recording, 0.005)) / 2
    last = observer.estimate(int(recording.truth.stamps[-1]))
    z = np.abs(np.concatenate([last.q, last.u]) - recording.truth.states[-1])
    assert np.all(z < 4 * np.sqrt(np.diag(last.covariance)))
    assert not last.misfit


def exactly_modelled(deviation: Vector | None, seconds: float = 2.0) -> tuple[Model, Recording]:
    """hammer_arm as it is, with white torques of a declared ``deviation``, at 200 Hz."""
    model = read_model("hammer_arm")
    assert model.robot is not None
    model = replace(model, robot=replace(model.robot, torque_deviation=deviation))
    truth = Truth.of_plant(Robot(model), model.initial_state(), 200.0, seconds)
    return model, truth.recorded(seed=4)


def test_deviations_cover_what_happens_between_efforts_without_a_declared_one() -> None:
    """Torques that swing on between samples: deviations are true, and at most twice too wide.

    Where efforts are declared exact, they are not.
    """
    shares, sizes = [], []
    for declared in (None, np.zeros(2)):
        model, recording = exactly_modelled(declared)
        found = filtered(observer_of(model, recording), recording)
        z = np.abs(found.speeds - recording.truth.states[:, 2:])[100:] / found.deviations[100:]
        shares.append(np.mean(z < 2, axis=0))
        sizes.append(np.quantile(z, 0.95, axis=0))
    assert np.all(shares[0] > 0.9)
    assert np.all(sizes[0] > 1.0)
    assert np.all(shares[1] < 0.5)


def test_deviations_between_efforts_do_not_depend_on_when_efforts_come() -> None:
    """All before the first sample, or each with the encoders of its stamp: the same estimates."""
    model, recording = exactly_modelled(None, 1.3)
    before = filtered(observer_of(model, recording), recording)
    observer = make_observer(model, DECLARED, measurements=encoders(model))
    samples, events = iter(recording.samples), list(recording.events)
    assert observer.live is not None
    for k, stamp in enumerate(recording.truth.stamps.tolist()):
        for name, value in zip(("shoulder", "elbow"), recording.truth.efforts[k], strict=True):
            observer.live.add_force(name, stamp, float(value))
        while events and events[0].stamp <= stamp:
            observer.receive(events.pop(0))
        observer.measure([next(samples) for _ in range(2)])
        now = observer.estimate(stamp)
        assert np.array_equal(now.u, before.speeds[k])
        assert np.array_equal(np.sqrt(np.diag(now.covariance)[2:]), before.deviations[k])


@pytest.mark.long
def test_velocities_are_known_while_an_arm_bounces_rests_and_leaves() -> None:
    """Bounces whose stamps are out of order, a rest of half a second, and the release."""
    model = MODEL
    assert model.robot is not None
    pressing = Forcing(
        constant=np.array([-7.0, -2.0]),
        frequency=np.array([6.0]),
        cosine=np.zeros((1, 2)),
        sine=np.array([[6.0, 0.0]]),
    )
    robot = replace(model.robot, forcing=pressing)
    start = model.initial_state()
    recording = Truth.of_plant(Robot(robot), start, RATE, 1.4).recorded(seed=0)
    kinds = {switch.kind for event in recording.events for switch in event.switches}
    assert kinds == {Kind.IMPACT, Kind.CLOSE, Kind.OPEN}
    found = filtered(observer_of(replace(model, robot=robot), recording), recording)
    errors = np.linalg.norm(found.speeds - recording.truth.states[:, 2:], axis=1)
    assert np.percentile(errors, 95) < 0.2


@pytest.mark.long
def test_hits_whose_jumps_the_law_does_not_explain_are_a_misfit_after_a_dozen() -> None:
    """The plant bounces far higher than declared: the encoders tell the velocities then."""
    model = MODEL
    assert model.robot is not None
    plant = Robot(model.robot.with_parameters({"restitution.wall": 0.9}))
    recording = Truth.of_plant(plant, model.initial_state(), RATE, 24.0).recorded(seed=0)
    found = filtered(observer_of(model, recording), recording)
    assert 0 < found.warned <= 14
    free = observer_of(without_contacts(model, TORQUES), recording)
    inflated = filtered(free, recording, inflated=10.0)
    assert recording.error(found.speeds) < 1.1 * recording.error(inflated.speeds)


def test_encoders_at_200_hz_take_few_looks_at_the_gaps_an_instant(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Far from the wall a flight looks at its end, and each sample once: there is no search."""
    recording = recorded(seed=1, seconds=0.4)
    observer, samples, looks = observer_of(MODEL, recording), iter(recording.samples), []
    gaps = Robot.gaps_and_directions

    def counted(*args: object) -> object:
        looks.append(0.0)
        return gaps(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(Robot, "gaps_and_directions", counted)
    for _ in recording.truth.stamps:
        observer.measure([next(samples) for _ in range(2)])
    assert not recording.truth.hits
    assert len(looks) <= 3 * recording.truth.stamps.size


def test_samples_in_any_order_give_the_same_estimate() -> None:
    """A late sample is put in its place, and later ones are applied again."""
    recording = recorded(seed=2, seconds=0.1)
    in_order, late = (observer_of(MODEL, recording) for _ in range(2))
    stamp = int(recording.truth.stamps[-1])
    for samples, observer in (
        (recording.samples, in_order),
        ([*recording.samples[:10], *recording.samples[14:], *recording.samples[10:14]], late),
    ):
        for each in samples:
            observer.measure([each])
    first, second = in_order.estimate(stamp), late.estimate(stamp)
    assert np.array_equal(first.u, second.u)
    assert np.array_equal(first.covariance, second.covariance)


def test_turns_of_a_continuous_joint_do_not_count() -> None:
    """The encoder of the shoulder says 2 pi more: the innovation is the same."""
    recording = recorded(seed=3, seconds=0.05)
    observer = observer_of(MODEL, recording)
    observer.measure(recording.samples[:2])
    first, second = recording.samples[2:4]
    observer.measure([first._replace(value=first.value + 2 * np.pi), second])
    assert observer.samples.counts[0]["accepted"] == 2
    assert abs(observer.estimate(first.stamp).q[0] - recording.truth.states[1, 0]) < 0.005


def test_observer_starts_at_the_first_samples_with_their_deviations() -> None:
    """Velocities may be a tenth of the limits of the URDF."""
    observer = make_observer(
        "hammer_arm", replace(DECLARED, epoch=0), measurements=encoders(MODEL)
    )
    observer.measure([SensorSample(0, EPOCH, -0.5)])
    assert observer.lacking == ("elbow",)
    early, late = (
        ImpactEvent(EPOCH + k * 10**7, (Switch("wall"),), 6 + k, epoch=EPOCH - 10**9)
        for k in (1, 2)
    )
    with pytest.raises(UsageError, match=r"no sample of an encoder of the joint 'elbow' found"):
        observer.receive(early)
    released = observer.measure([SensorSample(1, EPOCH + 10**6, 0.25)])
    assert [(each.sequence, each.revises) for each in released] == [(7, True)]
    observer.measure([SensorSample(1, EPOCH, 0.2)])
    assert observer.start == EPOCH
    first = observer.estimate(EPOCH)
    np.testing.assert_allclose([*first.q, *first.u], [-0.5, 0.2, 0.0, 0.0], atol=1e-9)
    deviations = np.sqrt(np.diag(first.covariance))
    np.testing.assert_allclose(deviations, [7e-4, 7e-4, 2.0, 2.5], rtol=0.02)
    assert [each.sequence for each in observer.receive(late)] == [8]


def test_a_robot_starts_at_its_encoders_after_every_restart() -> None:
    """A reset, and a new episode of the plant: at rest where the encoders are then."""
    observer = make_observer(
        "hammer_arm", replace(DECLARED, epoch=0), measurements=encoders(MODEL)
    )

    def measured(stamp: int, *values: float) -> None:
        observer.measure([SensorSample(i, stamp, value) for i, value in enumerate(values)])

    measured(EPOCH, 0.1, 0.2)
    measured(EPOCH + 10**9, 0.3, 0.4)
    observer.restart("a reset was asked for")
    assert observer.lacking == ("shoulder", "elbow")
    measured(EPOCH + 2 * 10**9, 0.5, 0.6)
    assert observer.start == EPOCH + 2 * 10**9
    np.testing.assert_allclose(observer.estimate(observer.start).q, [0.5, 0.6], atol=1e-9)
    moved = EPOCH + 3 * 10**9
    measured(moved, 0.7, 0.8)
    for k in (1, 2):
        hit = ImpactEvent(moved + k * 10**6, (Switch("wall"),), k, epoch=moved, episode=1)
        observer.receive(hit)
    assert observer.start == observer.epoch == moved
    np.testing.assert_allclose(observer.estimate(moved).q, [0.7, 0.8], atol=1e-9)


@pytest.mark.parametrize(
    ("options", "measured", "expected"),
    [
        (replace(DECLARED, law="geometric"), True, "takes no robot"),
        (replace(DECLARED, model_error=0.1), True, "expected torque_deviation"),
        (replace(DECLARED, estimate_parameters=("restitution",)), True, "are considered"),
        (DECLARED, False, "does not follow from impact times alone"),
    ],
)
def test_what_an_observer_of_a_robot_cannot_do_is_said_in_one_line(
    options: Options, measured: bool, expected: str
) -> None:
    """Other laws, white accelerations, estimated parameters, and impact times alone."""
    with pytest.raises(UsageError, match=expected) as error:
        make_observer("hammer_arm", options, measurements=encoders(MODEL) if measured else ())
    assert "\n" not in str(error.value)


def test_considered_restitution_is_named() -> None:
    """The deviation of the sample's restitution counts, as an error of the state."""
    observer = make_observer(read_model("hammer_arm"), DECLARED, measurements=encoders(MODEL))
    unknowns = observer.law.uncertainty.unknowns
    assert unknowns is not None
    assert unknowns.family.names == ("restitution.wall",)
    assert unknowns.considered == (True,)


def test_an_estimate_goes_on_without_encoders_at_a_bounded_cost() -> None:
    """The estimate is the same once the past is forgotten, and begins at the history's end."""
    options = replace(DECLARED, epoch=0, history=0.25)
    observer = make_observer("hammer_arm", options, measurements=encoders(MODEL))
    observer.measure([SensorSample(i, EPOCH, 0.0) for i in range(2)])
    now = EPOCH + 4 * 10**8
    before = observer.estimate(now)
    observer.forget_silence(now)
    after = observer.estimate(now)
    assert observer.timeline is not None
    assert observer.timeline.entries[-1].since == now - from_seconds(0.25)
    np.testing.assert_allclose(after.q, before.q, atol=1e-3)
    np.testing.assert_allclose(np.diag(after.covariance), np.diag(before.covariance), rtol=0.1)


@pytest.mark.parametrize(("every", "most"), [(1, 1100), (10, 600)])
def test_a_backlog_is_worked_off_by_a_bounded_number_of_steps(
    every: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All encoders of a stamp share a motion; where samples are shed, efforts cost no steps."""
    start = MODEL.initial_state()
    recording = Truth.of_plant(wrong_plant(MODEL), start, 1000.0, 0.5).recorded(seed=5)
    observer = observer_of(MODEL, recording)
    observer.measure(recording.samples[:2])
    count, advanced = [0], Robot.advanced

    def counted(*args: object) -> Vector:
        count[0] += 1
        return advanced(*args)  # type: ignore[arg-type]

    monkeypatch.setattr(Robot, "advanced", counted)
    stamps = recording.truth.stamps[every::every]
    kept = {*stamps.tolist()}
    observer.measure([each for each in recording.samples if each.stamp in kept])
    assert count[0] < most * 0.5  # steps by second
    last = observer.estimate(int(stamps[-1]))
    errors = np.concatenate([last.q, last.u]) - recording.truth.states[-1]
    assert np.all(np.abs(errors) < 4 * np.sqrt(np.diag(last.covariance)))


def test_encoders_of_a_stamp_are_used_together_whichever_comes_first() -> None:
    """One after the other, together, and with other stamps: the same in every bit."""
    recording = recorded(seed=6, seconds=0.1)
    alone, paired, whole, swapped = (observer_of(MODEL, recording) for _ in range(4))
    samples = recording.samples
    pairs = [samples[i : i + 2] for i in range(0, len(samples), 2)]
    for pair in pairs:
        alone.measure(pair[:1])
        alone.measure(pair[1:])
        swapped.measure(pair[1:])
        swapped.measure(pair[:1])
        paired.measure(pair)
    whole.measure(samples)
    stamp = int(recording.truth.stamps[-1])
    expected = paired.estimate(stamp)
    for each in (alone, whole, swapped):
        found = each.estimate(stamp)
        assert np.array_equal(found.q, expected.q)
        assert np.array_equal(found.u, expected.u)
        assert np.array_equal(found.covariance, expected.covariance)
        assert each.samples.counts[1]["accepted"] == len(pairs)
