# SPDX-License-Identifier: Apache-2.0
"""Parameters from impact times alone, undetermined ones, spurious impacts."""

import warnings
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import EPOCH, Harmonic, event, forcing, run, sample, system

from impact_observer.errors import IdentificationError, UsageError
from impact_observer.events import ImpactEvent
from impact_observer.identify import fit_report
from impact_observer.identify.constrained import constrained_least_squares
from impact_observer.identify.fit_check import check_fit
from impact_observer.identify.fit_picture import fit_picture
from impact_observer.identify.identification import Identification, identify
from impact_observer.identify.model_edit import changes
from impact_observer.identify.residuals import independence, whiteness
from impact_observer.io.bag_part import TimeZero
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in
from impact_observer.model import System, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.model_file import edited, load_yaml
from impact_observer.options import Options
from impact_observer.plant import Run, SensorModel, simulate_sensor
from impact_observer.resources import shared
from impact_observer.smooth import smoothed_runs
from impact_observer.stamps import from_seconds

Array = NDArray[np.float64]
FREE = ("restitution", "stiffness-scale", "gap")


@lru_cache
def recorded(name: str) -> Run:
    """A minute of a sample model."""
    model = sample(name)
    return run(model.system, *model.initial_state(), seconds=60.0, rate=1.0)


def sensed(name: str, seed: int = 0, **faults: float) -> list[ImpactEvent]:
    """The events of a sensor of that run."""
    made, model = recorded(name), sample(name).system
    last = int(made.stamps[-1])
    sensor = SensorModel(**faults)  # type: ignore[arg-type]
    messages = simulate_sensor(
        sensor, model, made.switchings, epoch=made.epoch, last=last, seed=seed
    )
    return sorted((each.event for each in messages), key=lambda each: each.stamp)


def wrong(model: System, stiffness: float = 1.03) -> System:
    """The model with restitutions off by 0.1, stiffness by 3 % and gaps by 2 %."""
    return replace(
        model,
        K=model.K * stiffness,
        contacts=tuple(
            replace(each, gap=1.02 * each.gap, restitution=each.restitution + 0.1 * (-1) ** i)
            for i, each in enumerate(model.contacts)
        ),
    )


def truth(found: Identification, model: System, stiffness: float = 1.03) -> Array:
    """The true values of the estimated parameters."""
    true = {f"restitution.{each.name}": each.restitution for each in model.contacts}
    true |= {f"gap.{each.name}": each.gap for each in model.contacts}
    true |= {"stiffness-scale": 1 / stiffness}
    return np.array([true[name] for name in found.family.names])


@pytest.mark.parametrize("name", ["two_mass", pytest.param("three_mass", marks=pytest.mark.slow)])
def test_exact_times_give_every_parameter(name: str) -> None:
    """To a part in ten millions: the estimated clock error is the rounding to 1 ns."""
    model = sample(name)
    found = identify(parametric_family(wrong(model.system), FREE), sensed(name))
    assert found.converged
    assert not found.undetermined
    np.testing.assert_allclose(found.values, truth(found, model.system), rtol=1e-7)
    np.testing.assert_allclose(found.start, np.concatenate(model.initial_state()), atol=1e-7)
    assert found.rms < 1e-9
    assert check_fit(found).fits


@pytest.mark.slow
def test_errors_under_jitter_match_their_standard_errors() -> None:
    """The squares of 12 normalised errors; their sum is that of the right number, nearly."""
    model = sample("two_mass").system
    family = parametric_family(wrong(model), FREE)
    weight, freedom, sizes = 0.0, 0, []
    for seed in range(4):
        found = identify(
            family, sensed("two_mass", seed, jitter=1e-3), clock=1e-3, trust_events=True
        )
        error = found.values - truth(found, model)
        own = found.covariance[found.start.size :, found.start.size :]
        weight += float(error @ np.linalg.solve(own, error))
        freedom += error.size
        sizes.append(found.rms)
    assert np.mean(sizes) == pytest.approx(1e-3, rel=0.2)
    assert abs(weight / freedom - 1) < 4 * np.sqrt(2 / freedom)


@pytest.mark.slow
def test_spurious_impacts_are_rejected() -> None:
    """One in ten, one of them 5 ms from a true one; nothing is missing in the end."""
    model = sample("two_mass").system
    events = sensed("two_mass", 3, spurious=0.08)
    events = [each for each in events if each.stamp < EPOCH + from_seconds(25.0)]
    true = {each.stamp for each in recorded("two_mass").events}
    found = identify(parametric_family(wrong(model), FREE), events)
    assert {stamp for stamp, _ in found.recording.rejected} == {
        each.stamp for each in events if each.stamp not in true
    }
    np.testing.assert_allclose(found.values, truth(found, model), rtol=1e-6)


def test_parameters_that_move_no_impact_are_named() -> None:
    """Mass, damping and stiffness have a common scale where no force is given."""
    free_fall = system(
        np.eye(1), [[0.1]], [[4.0]], contacts=[([1.0], -0.2, 0.9)], force=forcing(1, 0.0)
    )
    made = run(free_fall, [1.0], [0.0], seconds=12.0, rate=1.0)
    scales = ["mass-scale", "damping-scale", "stiffness-scale"]
    with pytest.raises(
        IdentificationError, match=r"\+1 mass-scale \+1 damping-scale \+1 stiffness-scale: "
    ):
        identify(parametric_family(free_fall, scales), list(made.events))
    alone = identify(
        parametric_family(free_fall, ["restitution", "stiffness-scale"]), list(made.events)
    )
    np.testing.assert_allclose(alone.values, [0.9, 1.0], rtol=1e-6)


def test_a_motion_without_a_scale_is_refused() -> None:
    """No force and no gap: the impacts of a motion twice as large come at the same times."""
    same = system(np.eye(1), [[0.1]], [[4.0]], contacts=[([1.0], 0.0, 0.9)])
    made = run(same, [1.0], [0.0], seconds=12.0, rate=1.0)
    with pytest.raises(IdentificationError, match="size of the motion"):
        identify(parametric_family(same, ["restitution"]), list(made.events))


def test_a_clock_offset_beside_a_phase_is_undetermined() -> None:
    """An offset of the clock and a phase of the forcing move impacts in the same way."""
    model = sample("two_mass").system
    family = parametric_family(model, ["clock-offset", "forcing-phase"])
    with pytest.raises(IdentificationError, match="clock-offset"):
        identify(family, sensed("two_mass"))


def test_too_few_impacts_are_refused() -> None:
    """With both numbers."""
    model = sample("two_mass").system
    with pytest.raises(IdentificationError, match="3 impacts for 7 unknowns"):
        identify(parametric_family(model, FREE), sensed("two_mass")[:3])


def bounced(restitution: float, free: list[str]) -> Identification:
    """A fit to five seconds of a ball, from a first guess of its restitution."""
    model = sample("bouncing_ball")
    made = run(model.system, *model.initial_state(), seconds=5.0, rate=1.0)
    floor = replace(model.system.contacts[0], restitution=restitution)
    family = parametric_family(replace(model.system, contacts=(floor,)), free)
    return identify(family, list(made.events))


@pytest.mark.parametrize("guess", [0.9, 0.8])
@pytest.mark.parametrize("free", ["mass-scale", "gap"])
def test_what_another_initial_state_hides_is_named_before_fitting(guess: float, free: str) -> None:
    """The weight is known: a heavier ball falls slower, from less high. A floor may be lower."""
    with pytest.raises(IdentificationError, match=free) as caught:
        bounced(guess, ["restitution", free])
    assert "with a suitable initial state" in str(caught.value)
    assert "restitution" not in str(caught.value)


@pytest.mark.slow
def test_rounding_of_stamps_that_repeats_itself_is_no_error_of_the_model() -> None:
    """A periodic motion has periodic rounding; the same shifts a thousand times larger count.

    Up to half of the error that the clock is declared to have they do not.
    """
    shifts = 4e-10 * np.sign(np.sin(np.arange(200) / 3))
    assert whiteness(shifts) < 1e-3
    assert independence(shifts) == 1.0
    assert independence(1e3 * shifts) < 1e-3
    assert independence(1e3 * shifts, clock=1e-6) == 1.0
    assert independence(1e3 * shifts, clock=7e-7) < 1e-3


@pytest.mark.long
def test_a_short_recording_of_another_model_does_not_fit() -> None:
    """Rejecting impacts leaves fewer than there are unknowns; a longer one would not help."""
    model = sample("two_mass").system
    stop = replace(model.contacts[0], restitution=0.9, gap=1.2 * model.contacts[0].gap)
    family = parametric_family(
        replace(model, K=1.3 * model.K, contacts=(stop,)), ["restitution", "gap"]
    )
    found = identify(family, sensed("two_mass", 1, jitter=1e-3)[:8], clock=1e-3)
    assert not found.converged
    assert found.held_back is None


@pytest.mark.slow
def test_standard_errors_of_exact_stamps_are_not_widened() -> None:
    """Rounding explains the shifts. The last fifth of the impacts is predicted as well."""
    model = sample("two_mass").system
    found = identify(parametric_family(wrong(model), FREE), sensed("two_mass"))
    assert found.widened == 1.0
    held = found.held_back
    assert held is not None
    assert held.impacts == len(found.shifts) // 5
    assert held.carries_over
    assert held.residual < 2e-9


@pytest.mark.slow
def test_standard_errors_of_a_wrong_model_are_widened() -> None:
    """A restitution that is 2 % off, held, moves the stiffness by many standard errors."""
    model = sample("two_mass").system
    stop = replace(model.contacts[0], restitution=1.02 * model.contacts[0].restitution)
    family = parametric_family(replace(model, contacts=(stop,)), ["stiffness-scale"])
    events = sensed("two_mass")
    found = identify(family, events, clock=1e-4, trust_events=True)
    error = abs(found.values[0] - 1) / found.errors[0]
    assert error < 3
    assert error * found.widened > 30
    estimated = identify(family, events, trust_events=True)
    np.testing.assert_allclose(estimated.errors, found.errors, rtol=1e-6)


@pytest.mark.slow
def test_outliers_ask_for_a_larger_clock_error_only(capsys: pytest.CaptureFixture[str]) -> None:
    """A search may reject many impacts, though the declared error exceeds all shifts."""
    family = parametric_family(sample("two_mass").system, ["restitution"])
    found = identify(family, sensed("two_mass", jitter=1e-5), clock=1e-5, trust_events=True)
    for clock, named in ((1e-3, False), (1e-8, True)):
        searched = replace(found, doubted=len(found.shifts), accepted=found.rms, clock=clock)
        fit_report.print_check(searched, check_fit(searched))
        assert ("makes outliers" in capsys.readouterr().out) == named


@pytest.mark.slow
def test_a_drift_below_the_declared_clock_error_carries_over() -> None:
    """Residuals may be many times those of the fitted part, and still be errors of the clock."""
    family = parametric_family(sample("two_mass").system, ["stiffness-scale"])
    events = sensed("two_mass")
    late = events[-len(events) // 5].stamp
    changed = [replace(e, stamp=e.stamp + max(e.stamp - late, 0) // 100_000) for e in events]
    carried = []
    for clock in (1e-3, 1e-8):
        found = identify(family, changed, clock=clock, trust_events=True)
        held = found.held_back
        assert held is not None
        assert 100 * held.fitted < held.residual < 1e-3
        carried.append(found.carries_over)
    assert carried == [True, False]


@pytest.mark.long
def test_a_model_that_drifts_does_not_carry_over() -> None:
    """The clock runs faster in the last fifth, as if all springs were weaker."""
    model = sample("two_mass").system
    family = parametric_family(model, ["stiffness-scale"])
    events = sensed("two_mass", jitter=1e-4)
    late = events[-len(events) // 5].stamp
    changed = [replace(e, stamp=e.stamp + max(e.stamp - late, 0) // 100) for e in events]
    kept = identify(family, events, clock=1e-4, trust_events=True).held_back
    lost = identify(family, changed, clock=1e-4, trust_events=True).held_back
    assert kept is not None
    assert kept.carries_over
    assert lost is not None
    assert not lost.carries_over
    assert lost.residual > 10 * lost.fitted
    short = identify(family, events[:9], clock=1e-4, trust_events=True)
    assert short.held_back is None


@pytest.mark.slow
def test_check_rejects_a_wrong_model_and_accepts_the_right_one() -> None:
    """By the declared clock error, or by correlated shifts of successive impacts."""
    model = sample("three_mass").system
    events = sensed("three_mass", jitter=1e-3)
    events = events[: len(events) // 2]
    right = check_fit(
        identify(parametric_family(model, ()), events, clock=1e-3, trust_events=True)
    )
    assert right.fits
    off = replace(model, K=1.02 * model.K)
    bad = check_fit(identify(parametric_family(off, ()), events, clock=1e-3, trust_events=True))
    assert not bad.fits
    assert bad.worst in {"left", "right"}


def test_constrained_least_squares_is_the_generalised_one() -> None:
    """Where ``B`` can be inverted it is the textbook's formula."""
    rng = np.random.default_rng(1)
    A, B, d = rng.normal(size=(9, 3)), rng.normal(size=(9, 9)), rng.normal(size=9)
    x, e, root = constrained_least_squares(A, B, d)
    inverse = np.linalg.inv(B @ B.T)
    covariance = np.linalg.inv(A.T @ inverse @ A)
    np.testing.assert_allclose(x, covariance @ A.T @ inverse @ d, rtol=1e-9)
    np.testing.assert_allclose(A @ x + B @ e, d, atol=1e-11)
    np.testing.assert_allclose(root @ root.T, covariance, rtol=1e-9)


ELEMENTS = """\
# a rig
name: rig
bodies: [{name: x1, mass: 1}, {name: x2, mass: 2}]     # kg
springs:
  - {between: [ground, x1], stiffness: 10, damping: 0.1}
  - {between: [x1, x2], stiffness: 20}
forces: [{body: x2, constant: 1}, {body: x2, amplitude: 4, frequency: 2.5}]
stops:
  - {name: above, body: x2, limit: 0.5, side: above, restitution: 0.7}
  - {name: below, body: x1, limit: -0.4, side: below, restitution: 0.6}
  - {name: between, between: [x1, x2], gap: 0.3, restitution: 0.5}
"""
MATRICES = """\
name: rig
coordinates: [x1, x2]
mass: [[1, 0], [0, 2]]
damping: [[0.2, -0.1], [-0.1, 0.1]]
stiffness: [[30, -20], [-20, 20]]
forcing: {harmonics: [{frequency: 2.5, cosine: [0, 4], sine: [1, 0]}]}
contacts: [{name: stop, direction: [0, -1], gap: 0.5, restitution: 0.7}]   # the anvil
"""


@pytest.mark.parametrize(
    ("text", "free"),
    [
        (ELEMENTS, ("restitution", "gap", "stiffness", "damping", "mass")),
        (ELEMENTS, ("stiffness-scale", "damping-scale", "mass-scale", "forcing-phase")),
        (ELEMENTS, ("forcing-amplitude", "gap.below", "stiffness.x1-x2")),
        (MATRICES, ("restitution", "gap", "stiffness-scale", "damping-scale", "mass-scale")),
        (MATRICES, ("forcing-amplitude", "forcing-phase")),
        (MATRICES, ("forcing-frequency", "constant-force")),
        (MATRICES.replace("forcing: {", "forcing: {constant: [0, 1], "), ("constant-force.x1",)),
        (MATRICES.replace("forcing: {", "# forcing: {"), ("constant-force",)),
        (ELEMENTS, ("forcing-frequency", "constant-force")),
        (ELEMENTS.replace("forces:", "# forces:"), ("constant-force",)),
        (ELEMENTS.replace("forces: [", "forces: [{body: x2, constant: 2}, "), ("constant-force",)),
        (ELEMENTS.replace("forces: [", "forces: [{body: x2, input: a}, "), ("forcing-phase",)),
    ],
)
def test_a_written_model_reads_as_the_identified_one(text: str, free: tuple[str, ...]) -> None:
    """In its own form, with its comments."""
    document = load_yaml(text)
    assert isinstance(document, dict)
    model = parse_model(text, "rig")
    family = parametric_family(model.system, free, model.elements)
    values = family.nominal + 0.07 * np.arange(1, family.size + 1) / family.size
    written = edited(text, changes(document, family, values))
    wanted, found = family.system_at(values), parse_model(written, "rig").system
    for part in ("M", "C", "K", "q_r", "eps"):
        np.testing.assert_allclose(getattr(found, part), getattr(wanted, part), rtol=1e-12)
    np.testing.assert_allclose(found.forcing.cosine, wanted.forcing.cosine, atol=1e-12)
    np.testing.assert_allclose(found.forcing.sine, wanted.forcing.sine, atol=1e-12)
    np.testing.assert_allclose(found.forcing.constant, wanted.forcing.constant, atol=1e-12)
    np.testing.assert_allclose(found.forcing.frequency, wanted.forcing.frequency, rtol=1e-12)
    assert text.count("#") == written.count("#")


def test_the_picture_shows_every_contact() -> None:
    """A row of marks each, and the clock's error."""
    model = sample("three_mass").system
    found = identify(parametric_family(model, ["restitution"]), sensed("three_mass"))
    axes = fit_picture(found, title="three", zero=TimeZero(0, "the first impact")).axes[0]
    assert axes.get_xlabel() == "time since the first impact [s]"
    legend = axes.get_legend()
    assert legend is not None
    assert [each.get_text() for each in legend.get_texts()] == [
        "left",
        "right",
        "2 standard deviations",
    ]


def test_the_picture_shows_rejected_and_inserted_impacts() -> None:
    """On the axis of time, as many as the sensor of that bag has made up and missed."""
    model = sample("two_mass").system
    family = parametric_family(model, ["restitution"])
    with BagReader(shared("bags") / "missed_and_spurious") as reader:
        found = identify(family, events_in(reader), clock=1e-5)
    axes = fit_picture(found, title="two", zero=TimeZero(0, "the epoch")).axes[0]
    marks = {str(line.get_label()): line for line in axes.get_lines()}
    assert {name: len(np.asarray(line.get_xdata())) for name, line in marks.items()} == {
        "stop": 19,
        "rejected": 5,
        "inserted": 3,
    }
    np.testing.assert_array_equal(np.asarray(marks["rejected"].get_ydata()), 0.0)
    assert marks["rejected"].get_transform() == axes.get_xaxis_transform()


@pytest.mark.long
def test_a_strongly_damped_mode_is_no_obstacle_and_the_smoother_finds_the_same() -> None:
    """It decays at 400 1/s, so no impact depends on its start; hits follow after 17 ms."""
    text = sample("two_mass").text()
    model = replace(
        parse_model(text, "damped").system, C=np.array([[200.1, -200.0], [-200.0, 200.0]])
    )
    made = run(model, [0.1, -0.2], [0.5, 0.0], seconds=30.0, rate=1.0)
    sensor, last = SensorModel(jitter=1e-3), int(made.stamps[-1])
    received = simulate_sensor(sensor, model, made.switchings, epoch=EPOCH, last=last, seed=1)
    events = [each.event for each in received]
    off = replace(model, K=1.03 * model.K)
    found = identify(parametric_family(off, ["stiffness-scale"]), events, clock=1e-3)
    assert found.converged
    assert np.max(np.abs(found.start)) < 3.0
    assert abs(found.values[0] - 1 / 1.03) < 4 * found.errors[0]
    options = Options(
        law="minimum-variance", clock_error=1e-3, estimate_parameters=("stiffness-scale",)
    )
    (motion,) = smoothed_runs(off, events, options)
    ((_, value, deviation),) = motion.parameters
    assert abs(value - found.values[0]) < deviation
    assert found.errors[0] < 1.2 * deviation


@pytest.mark.slow
def test_persistent_contacts_are_part_of_the_motion() -> None:
    """A mass that is pressed against its stop once a period."""
    push = forcing(1, 0.0, [Harmonic(2.0, [6.0], [0.0])])
    model = system(1.0, 0.5, 4.0, contacts=[([-1.0], 0.5, 0.0)], force=push)
    made = run(model, [0.0], [0.5], seconds=60.0, rate=1.0)
    off = replace(model, K=1.03 * model.K)
    found = identify(parametric_family(off, ["stiffness-scale"]), list(made.events))
    np.testing.assert_allclose(found.values, [1 / 1.03], rtol=1e-6)


@pytest.mark.long
def test_impacts_that_accumulate_are_part_of_the_recording() -> None:
    """A ball until it rests: 174 events, the last ones within microseconds."""
    model = sample("bouncing_ball")
    made = run(model.system, *model.initial_state(), seconds=12.0, rate=1.0)
    ball = replace(model.system.contacts[0], restitution=0.8)
    family = parametric_family(replace(model.system, contacts=(ball,)), ["restitution"])
    found = identify(family, list(made.events))
    assert found.converged
    np.testing.assert_allclose(found.values, [0.9], rtol=1e-9)


def test_stamps_without_an_epoch_begin_with_the_first() -> None:
    """A ball whose events have no epoch: the first stamp is the start."""
    ball = system(1.0, 0.0, 0.0, contacts=[([1.0], 0.0, 0.9)], force=forcing(1, -9.81))
    t, flight, events = 0.0, 2.0, []
    for k in range(8):
        events.append(event(t, "c1", sequence=k + 1, epoch=0))
        t += flight
        flight *= 0.9
    family = parametric_family(
        replace(ball, contacts=(replace(ball.contacts[0], restitution=0.8),)), ["restitution"]
    )
    found = identify(family, events)
    np.testing.assert_allclose(found.values, [0.9], rtol=1e-7)
    assert found.recording.start == 0.0
    assert events[0].stamp == EPOCH + from_seconds(0.0)


def test_weakly_determined_parameters_are_named_after_the_fit() -> None:
    """Their standard error is as large as their value; the others are kept."""
    model = sample("two_mass").system
    family = parametric_family(model, ["restitution", "damping-scale"])
    found = identify(family, sensed("two_mass")[:12], clock=0.3, trust_events=True)
    restitution, damping = found.errors
    assert 2 * restitution < 1.0 < damping
    ((name,),) = found.undetermined
    assert name == "damping-scale"
    precise = identify(family, sensed("two_mass")[:12], clock=1e-4, trust_events=True)
    assert precise.undetermined == ()


def test_a_forcing_that_depends_on_time_needs_an_epoch() -> None:
    """Without one the fit would have it begin at the first impact."""
    events = [replace(each, epoch=0) for each in sensed("two_mass")]
    family = parametric_family(sample("two_mass").system, ["restitution"])
    with pytest.raises(UsageError, match="forcing of two_mass depends on time") as caught:
        identify(family, events)
    for remedy in ("--epoch S", "detect --pulses COLUMN", "import --time-zero S"):
        assert remedy in str(caught.value)


def test_a_fit_that_fails_names_outliers_beside_how_many_are_recorded(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The declared error of the clock is far too small."""
    family = parametric_family(sample("two_mass").system, ["restitution"])
    found = identify(family, sensed("two_mass")[:12], clock=1e-4, trust_events=True)
    failed = replace(found, converged=False, doubted=66, clock=1e-12, accepted=found.rms)
    fit_report.print_parameters(failed, check_fit(failed))
    said = " ".join(capsys.readouterr().out.split())
    assert "up to 66 impacts were rejected or inserted, 12 are recorded" in said


def test_a_fit_shows_no_warnings_of_its_trial_motions() -> None:
    """Whatever overflows while it searches."""
    family = parametric_family(sample("two_mass").system, ["restitution"])
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        identify(
            family,
            sensed("two_mass")[:12],
            trust_events=True,
            progress=lambda _: warnings.warn("overflow", RuntimeWarning, stacklevel=1),
        )
    assert seen == []


@pytest.mark.slow
def test_a_parameter_at_its_bound_ends_there() -> None:
    """It is held at its bound and the others are fitted."""
    force = forcing(1, 0.0, [Harmonic(1.3, [3.0], [0.0])])
    model = system(1.0, 0.2, 4.0, contacts=[([1.0], 0.3, 1.0)], force=force)
    made = run(model, [0.5], [0.0], seconds=40.0, rate=1.0)
    at_bound = 0
    for seed in range(4):
        late = 1e-3 * np.random.default_rng(seed).normal(size=len(made.events))
        events = [
            replace(e, stamp=e.stamp + from_seconds(s))
            for e, s in zip(made.events, late.tolist(), strict=True)
        ]
        contacts = (replace(model.contacts[0], gap=0.303, restitution=0.95),)
        family = parametric_family(replace(model, contacts=contacts), ["restitution", "gap"])
        found = identify(family, events, clock=1e-3, trust_events=True)
        assert found.converged
        restitution, gap = found.values
        assert 0.98 < restitution <= 1.0
        assert abs(gap - 0.3) < 5 * found.errors[1]
        assert (restitution == 1.0) == ("restitution.c1" in found.bounded)
        at_bound += restitution == 1.0
    assert 0 < at_bound < 6


@pytest.mark.slow
def test_amplitude_and_phase_of_a_ground_are_found() -> None:
    """From exact times alone, beside a restitution, from a model that is wrong in all three."""
    text = """\
name: rig
bodies:  [{name: x1, mass: 1}, {name: x2, mass: 2}]
grounds: [{name: base, motion: {harmonics: [{amplitude: 0.1, frequency: 3, phase: 0.4}]}}]
springs:
  - {between: [base, x1], stiffness: 10, damping: 0.3}
  - {between: [x1, x2], stiffness: 20, damping: 0.2}
forces:  [{body: x2, amplitude: 4, frequency: 2.5}]
stops:
  - {name: foot, between: [base, x1], gap: 0.2, restitution: 0.7}
  - {name: head, body: x2, limit: 0.3, side: above, restitution: 0.7}
"""
    plant = run(parse_model(text, "rig").system, [0.1, 0.0], [0.0, 0.5], seconds=40.0, rate=1.0)
    other = text.replace("amplitude: 0.1,", "amplitude: 0.11,").replace(
        "phase: 0.4", "phase: 0.45"
    )
    free = ("ground-amplitude", "ground-phase", "restitution.foot")
    family = parametric_family(parse_model(other, "rig").system, free)
    found = identify(family, list(plant.events), clock=1e-9)
    np.testing.assert_allclose(found.values, [0.1 / 0.11, -0.05, 0.7], rtol=1e-7)
    assert np.all(np.abs(found.values - [0.1 / 0.11, -0.05, 0.7]) < 5 * found.errors)
