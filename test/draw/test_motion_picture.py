# SPDX-License-Identifier: Apache-2.0
"""The motion in a bag: what is read, and the picture of it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from impact_observer.draw import pictures
from impact_observer.draw.motion_picture import chosen_coordinates, motion_picture
from impact_observer.draw.pictures import extremes
from impact_observer.draw.recorded_motion import MotionCurve, RecordedMotion, read_motion
from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent, Kind, Ruling, Switch, Verdict
from impact_observer.io import BagReader, BagWriter, JointState
from impact_observer.io.bag_part import TimeZero
from impact_observer.io.messages import bag_messages
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

EPOCH, STEP = NS_PER_S, 10_000_000
MAKE = bag_messages()
SECONDS = np.linspace(0.0, 2.0, 21)


def estimated(k: int, *, event: int = 0) -> Estimate:
    """The estimate at sample ``k``: positions ``k`` and ``-k`` with deviations 1 and 2."""
    return Estimate(
        EPOCH + k * STEP,
        "minimum-variance",
        np.array([k, -k], dtype=np.float64),
        np.array([10.0 * k, 0.0]),
        covariance=np.diag([1.0, 4.0, 9.0, 16.0]),
        last_event=event,
    )


def written(
    folder: Path,
    estimates: Sequence[Estimate],
    events: Sequence[ImpactEvent] = (),
    verdicts: Sequence[Verdict] = (),
    observers: Sequence[str] = ("/observer",),
) -> RecordedMotion:
    """The motion in a bag of estimates, events and verdicts, the same of each observer."""
    path = folder / "bag"
    with BagWriter(path) as writer:
        writer.declare("/impacts")
        for event in events:
            writer.write("/impacts", event.stamp, MAKE.event(event))
        for observer in observers:
            writer.declare(f"{observer}/state")
            for k, each in enumerate(estimates):
                names = ("x1", "x2") if k == 0 else ("x2", "x1")  # a message may have any order
                values = each if k == 0 else reordered(each)
                writer.write(f"{observer}/state", each.stamp, MAKE.estimate(values, names))
            for verdict in verdicts:
                writer.write(f"{observer}/verdicts", verdict.stamp, MAKE.verdict(verdict))
    with BagReader(path) as reader:
        return read_motion(reader)


def reordered(estimate: Estimate) -> Estimate:
    """The same estimate with the second coordinate first."""
    order = [1, 0, 3, 2]
    return replace(
        estimate,
        q=estimate.q[::-1],
        u=estimate.u[::-1],
        covariance=estimate.covariance[np.ix_(order, order)],
    )


def test_every_sample_of_a_recording_is_drawn(sample_bag: Path) -> None:
    """Curves of truth and estimate have the stamps and numbers of the bag."""
    with BagReader(sample_bag) as reader:
        motion = read_motion(reader)
        states = reader.joint_states("/plant/joint_states", motion.coordinates)
    truth, estimate = motion.curves
    assert (truth.label, truth.law) == ("truth", None)
    assert (estimate.label, estimate.law) == ("geometric", "geometric")
    np.testing.assert_array_equal(truth.x, np.hstack([states.q, states.u]))
    np.testing.assert_array_equal(truth.seconds, (states.stamps - EPOCH) / NS_PER_S)
    assert np.isnan([truth.deviations, estimate.deviations]).all()
    assert motion.ends == (0.0, 0.5)


def test_deviations_are_those_of_the_covariance_whatever_the_order_of_names(
    tmp_path: Path,
) -> None:
    """Messages may have another order of coordinates from one to the next."""
    (curve,) = written(tmp_path, [estimated(0), estimated(1)]).curves
    np.testing.assert_array_equal(curve.x, [[0.0, 0.0, 0.0, 0.0], [1.0, -1.0, 10.0, 0.0]])
    np.testing.assert_allclose(curve.deviations, [[1.0, 2.0, 3.0, 4.0]] * 2)


def test_estimates_published_before_their_event_arrived_are_left_out(tmp_path: Path) -> None:
    """Such estimates lack the jump of the event, as in ``compare``."""
    hit = EPOCH + STEP
    events = [ImpactEvent(hit, (Switch("stop"),), 1, 0, EPOCH)]
    samples = [estimated(0), estimated(2), estimated(3, event=hit)]
    motion = written(tmp_path, samples, events, [Verdict(hit, Ruling.APPLIED, 1, "stop")])
    assert motion.curves[0].x[:, 0].tolist() == [0.0, 3.0]


AT = [EPOCH + k * STEP for k in range(6)]
EVENTS = [
    ImpactEvent(AT[1], (Switch("stop"),), 1, 0, EPOCH),
    ImpactEvent(AT[2], (Switch("stop", Kind.CLOSE),), 2, 0, EPOCH),
    ImpactEvent(AT[3], (Switch("stop", Kind.OPEN),), 3, 0, EPOCH),
]
VERDICTS = [
    Verdict(AT[1], Ruling.APPLIED, 1, "stop"),
    Verdict(AT[1], Ruling.REJECTED, 1, "stop", revises=True),
    Verdict(AT[2], Ruling.APPLIED, 2, ""),
    Verdict(AT[3], Ruling.APPLIED, 3, "stop"),
    Verdict(AT[4], Ruling.INSERTED, 0, "stop"),
    Verdict(AT[5], Ruling.INSERTED, 0, "stop"),
    Verdict(AT[5], Ruling.REJECTED, 0, "stop"),
]


def test_impacts_are_marked_by_their_final_verdict(tmp_path: Path) -> None:
    """Openings are no impacts, and an insertion that was withdrawn leaves no mark."""
    motion = written(tmp_path, [estimated(k) for k in range(6)], EVENTS, VERDICTS)
    wanted = {Ruling.REJECTED: [0.01], Ruling.APPLIED: [0.02], Ruling.INSERTED: [0.04]}
    assert motion.marks == {"stop": wanted}


def test_two_observers_of_a_law_have_labels_and_marks_of_their_own(tmp_path: Path) -> None:
    """Their laws do not tell them apart."""
    several = ("/observer", "/observer_b")
    motion = written(tmp_path, [estimated(k) for k in range(6)], EVENTS, VERDICTS, several)
    labels = [f"minimum-variance ({each[1:]})" for each in several]
    assert [each.label for each in motion.curves] == labels
    assert [*motion.marks] == [f"stop, {each}" for each in labels]


def test_without_verdicts_the_reports_are_marked(tmp_path: Path) -> None:
    """Reports have no ruling; a report after the last state is left out."""
    motion = written(tmp_path, [estimated(0), estimated(1)], EVENTS)
    assert motion.marks == {"stop": {None: [0.01]}}


def test_bag_without_states_is_one_line(tmp_path: Path) -> None:
    """The error names the expected topics."""
    with pytest.raises(BagError, match="no states; expected true states on /plant/joint_states"):
        written(tmp_path, [])


def test_a_model_that_cannot_be_read_costs_the_units_only(tmp_path: Path) -> None:
    """A bag of another version may have keys that this version does not know."""
    for name, text in (("known", "unit: rad\n"), ("odd", "unheard: 1\n")):
        with BagWriter(tmp_path / name) as writer:
            model = f"name: m\n{text}bodies: [{{name: a, mass: 1}}]\n"
            writer.write("/plant/model", 1, MAKE.model(model))
            state = JointState(2, ("a",), np.ones(1), np.zeros(1))
            writer.write("/plant/joint_states", 2, MAKE.joint_state(state))
    with BagReader(tmp_path / "known") as known, BagReader(tmp_path / "odd") as odd:
        assert read_motion(known).units == ("rad", "rad/s")
        assert read_motion(odd).units == ("m or rad", "m/s or rad/s")


def test_of_many_values_the_extremes_of_each_part_are_drawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No peak of a long curve is lost, and of a short one no value."""
    monkeypatch.setattr(pictures, "MOST_SAMPLES", 100)
    y = np.random.default_rng(1).normal(size=1013)
    kept = extremes(y)
    assert kept.size == 100
    assert (np.diff(kept) > 0).all()
    for part in np.array_split(np.arange(y.size), 50):
        own = np.intersect1d(kept, part)
        assert (y[own].min(), y[own].max()) == (y[part].min(), y[part].max())
    assert extremes(y[:100]).tolist() == [*range(100)]


def motion_of(n: int = 2, deviation: float = 100.0, *, truth: int = 1) -> RecordedMotion:
    """Straight lines from 0 to 2: every ``truth``-th sample of the truth, and an estimate."""
    x = np.repeat(SECONDS[:, None], 2 * n, axis=1)
    none = np.full(x.shape, np.nan)
    curves = (
        MotionCurve("truth", None, SECONDS[::truth], x[::truth], none[::truth]),
        MotionCurve("law", "minimum-variance", SECONDS, x, np.full(x.shape, deviation)),
    )
    names = tuple(f"x{i}" for i in range(n))
    marks: dict[str, dict[Ruling | None, list[float]]] = {
        "stop": {Ruling.APPLIED: [0.5, 1.0], Ruling.INSERTED: [1.5]}
    }
    return RecordedMotion(names, ("m",) * n + ("m/s",) * n, curves, marks, TimeZero(0))


def drawn(motion: RecordedMotion) -> Figure:
    """The picture of all coordinates."""
    return motion_picture(motion, range(len(motion.coordinates)))


def test_those_coordinates_that_move_most_are_chosen() -> None:
    """Unless they are named; the order is that of the model, or of the names."""
    motion = motion_of(20)
    truth = replace(motion.curves[0], x=motion.curves[0].x * np.arange(40)[::-1])
    motion = replace(motion, curves=(truth, motion.curves[1]))
    assert chosen_coordinates(motion, None) == [*range(8)]
    assert chosen_coordinates(motion, ["x12", "x3", "x12"]) == [12, 3]
    with pytest.raises(UsageError, match=r"x99.* expected some of x0, x1"):
        chosen_coordinates(motion, ["x99"])


def test_a_coordinate_has_its_position_at_the_left_and_its_velocity_at_the_right() -> None:
    """Units are on the axes; all axes have one time."""
    labels = [axes.get_ylabel() for axes in drawn(motion_of()).axes]
    assert labels[:2] == ["", ""]  # the marks
    assert labels[2:6] == ["x0\n[m]", "dx0/dt\n[m/s]", "x1\n[m]", "dx1/dt\n[m/s]"]
    assert labels[6:] == ["standard\ndeviation"] * 2
    assert len({axes.get_xlim() for axes in drawn(motion_of()).axes}) == 1


def test_deviations_have_a_logarithmic_scale() -> None:
    """A narrow band is invisible, its line is not; zeros are left out."""
    motion = motion_of()
    deviations = np.array(motion.curves[1].deviations)
    deviations[:, 0], deviations[0, 1] = np.geomspace(1.0, 1e-9, len(deviations)), 0.0
    curves = (motion.curves[0], replace(motion.curves[1], deviations=deviations))
    axes = drawn(replace(motion, curves=curves)).axes[-2]
    assert axes.get_yscale() == "log"
    drawn_lines = [np.asarray(each.get_ydata(), float) for each in axes.get_lines()]
    first, second = (each for each in drawn_lines if each.size)
    np.testing.assert_array_equal(first, deviations[:, 0])
    assert np.flatnonzero(np.isnan(second)).tolist() == [0]
    legend = axes.get_legend()
    assert legend is not None
    assert [each.get_text() for each in legend.get_texts()] == ["x0", "x1"]
    plain = drawn(motion_of(deviation=np.nan)).axes
    assert {axes.get_yscale() for axes in plain} == {"linear"}


def test_legend_has_what_is_drawn_and_nothing_else() -> None:
    """A plot without deviations has no band, a plot without insertions no such mark."""

    def labels(motion: RecordedMotion) -> list[str]:
        return [each.get_text() for each in drawn(motion).legends[0].get_texts()]

    band, applied = "± 2 standard deviations", "impact, applied"
    assert labels(motion_of()) == ["truth", "law", band, applied, "inserted, as missed"]
    plain = replace(motion_of(deviation=np.nan), marks={"stop": {None: [1.0]}})
    assert labels(plain) == ["truth", "law", "impact"]


def test_truth_with_few_samples_is_dots_as_lines_between_them_would_be_wrong() -> None:
    """The bag has true states at 2 Hz and estimates at 10 Hz."""
    (line, _), (dots, estimate) = (
        drawn(motion_of(truth=each)).axes[2].get_lines() for each in (1, 5)
    )
    assert line.get_linestyle() == "-"
    assert (dots.get_linestyle(), dots.get_marker()) == ("None", "o")
    assert estimate.get_linestyle() == "-"
