# SPDX-License-Identifier: Apache-2.0
"""The content of plots, read from bags."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from impact_observer.draw.plot import series as module
from impact_observer.draw.plot.impact_marks import Mark
from impact_observer.draw.plot.series import PlotContent, read_recording
from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent, Kind, Ruling, Switch, Verdict
from impact_observer.io import BagReader, BagWriter, JointState
from impact_observer.io.messages import bag_messages
from impact_observer.model import read_model
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

SYSTEM = read_model("two_mass").system
EPOCH, STEP = NS_PER_S, 10_000_000
MAKE = bag_messages()


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


def bag(
    folder: Path,
    estimates: Sequence[Estimate],
    events: Sequence[ImpactEvent] = (),
    verdicts: Sequence[Verdict] = (),
    names: tuple[str, ...] = SYSTEM.coordinates,
) -> Path:
    """A bag of estimates, events and verdicts."""
    path = folder / "bag"
    with BagWriter(path) as writer:
        for topic in ("/impacts", "/observer/state", "/observer/verdicts"):
            writer.declare(topic)
        for event in events:
            writer.write("/impacts", event.stamp, MAKE.event(event))
        for each in estimates:
            writer.write("/observer/state", each.stamp, MAKE.estimate(each, names))
        for verdict in verdicts:
            writer.write("/observer/verdicts", verdict.stamp, MAKE.verdict(verdict))
    return path


def recording(path: Path, *select: str) -> PlotContent:
    """The content of a bag's plot."""
    with BagReader(path) as reader:
        return read_recording(reader, SYSTEM, select=select or None)


def test_every_sample_of_a_short_recording_is_drawn(sample_bag: Path) -> None:
    """Curves of truth and estimate have the stamps and numbers of the bag."""
    found = recording(sample_bag, "x1", "stop")
    with BagReader(sample_bag) as reader:
        states = reader.joint_states("/plant/joint_states", SYSTEM.coordinates)
    truth, estimate = found.series
    assert (truth.label, truth.law) == ("truth", "")
    assert (estimate.label, estimate.law) == ("geometric", "geometric")
    expected = np.column_stack([states.q[:, 0], states.u[:, 0], 0.5 - states.q[:, 1]])
    np.testing.assert_array_equal(truth.values, expected)
    np.testing.assert_array_equal(truth.seconds[:, 0], (states.stamps - EPOCH) / NS_PER_S)
    assert np.isnan(truth.deviations).all()
    assert np.isnan(estimate.deviations).all()
    assert (found.start, found.end) == (0.0, 0.5)


def test_deviations_are_those_of_the_covariance(tmp_path: Path) -> None:
    """Coordinates, velocities and gaps have the deviations of the covariance."""
    (estimate,) = recording(bag(tmp_path, [estimated(0), estimated(1)]), "x1", "stop").series
    np.testing.assert_allclose(estimate.deviations, [[1.0, 3.0, 2.0]] * 2)


def test_other_order_of_names_reorders_the_covariance(tmp_path: Path) -> None:
    """A message that names x2 first has the deviation of x2 first."""
    path = bag(tmp_path, [estimated(3)], names=("x2", "x1"))
    (estimate,) = recording(path, "q_x1", "q_x2", "u_x1", "u_x2").series
    assert estimate.values.tolist() == [[-3.0, 3.0, 0.0, 30.0]]
    assert estimate.deviations.tolist() == [[2.0, 1.0, 4.0, 3.0]]


def test_estimates_published_before_their_event_arrived_are_left_out(tmp_path: Path) -> None:
    """Such estimates lack the jump of the event, as in ``compare``."""
    hit = EPOCH + STEP
    events = [ImpactEvent(hit, (Switch("stop"),), 1, 0, EPOCH)]
    samples = [estimated(0), estimated(2), estimated(3, event=hit)]
    path = bag(tmp_path, samples, events, [Verdict(hit, Ruling.APPLIED, 1, "stop")])
    assert recording(path, "q_x1").series[0].values[:, 0].tolist() == [0.0, 3.0]


def test_impacts_are_marked_by_their_final_verdict(tmp_path: Path) -> None:
    """Openings are no impacts, and an insertion that was withdrawn leaves no mark."""
    at = [EPOCH + k * STEP for k in range(6)]
    events = [
        ImpactEvent(at[1], (Switch("stop"),), 1, 0, EPOCH),
        ImpactEvent(at[2], (Switch("stop", Kind.CLOSE),), 2, 0, EPOCH),
        ImpactEvent(at[3], (Switch("stop", Kind.OPEN),), 3, 0, EPOCH),
    ]
    verdicts = [
        Verdict(at[1], Ruling.APPLIED, 1, "stop"),
        Verdict(at[1], Ruling.REJECTED, 1, "stop", revises=True),
        Verdict(at[2], Ruling.APPLIED, 2, "stop"),
        Verdict(at[3], Ruling.APPLIED, 3, "stop"),
        Verdict(at[4], Ruling.INSERTED, 0, "stop"),
        Verdict(at[5], Ruling.INSERTED, 0, "stop"),
        Verdict(at[5], Ruling.REJECTED, 0, "stop"),
    ]
    samples = [estimated(k) for k in range(6)]
    found = recording(bag(tmp_path, samples, events, verdicts), "q_x1")
    law = "minimum-variance"
    assert {mark: seconds.tolist() for mark, seconds in found.marks.items()} == {
        Mark("stop", law, Ruling.REJECTED): [0.01],
        Mark("stop", law, Ruling.APPLIED): [0.02],
        Mark("stop", law, Ruling.INSERTED): [0.04],
    }


def test_without_verdicts_the_reports_are_marked(tmp_path: Path) -> None:
    """Reports have no ruling, and belong to no estimate."""
    events = [ImpactEvent(EPOCH + STEP, (Switch("stop"),), 1, 0, EPOCH)]
    found = recording(bag(tmp_path, [estimated(k) for k in range(3)], events), "q_x1")
    assert {mark: seconds.tolist() for mark, seconds in found.marks.items()} == {
        Mark("stop"): [0.01]
    }


def test_bag_without_states_is_one_line(tmp_path: Path) -> None:
    """The error names the expected topics."""
    with pytest.raises(BagError, match="no states; expected true states on /plant/joint_states"):
        recording(bag(tmp_path, []))


def test_observer_that_is_not_there_is_one_line(sample_bag: Path) -> None:
    """The error names the observers of the bag."""
    with BagReader(sample_bag) as reader, pytest.raises(UsageError, match="observer_x: not in"):
        read_recording(reader, SYSTEM, observers=["observer_x"])


def test_long_recording_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The extremes of each column stay at their stamps, and all samples are counted."""
    monkeypatch.setattr(module, "MOST_SAMPLES", 100)
    samples = [estimated(k) for k in range(1000)]
    random = np.random.default_rng(1).normal(size=(1000, 2))
    drawn = [replace(each, q=q) for each, q in zip(samples, random, strict=True)]
    (estimate,) = recording(bag(tmp_path, drawn), "q_x1", "q_x2").series
    assert len(estimate.values) <= 100
    assert estimate.samples == 1000
    assert (np.diff(estimate.seconds, axis=0) >= 0).all()
    k = np.rint(estimate.seconds / (STEP / NS_PER_S)).astype(int)
    np.testing.assert_array_equal(estimate.values, np.take_along_axis(random, k, axis=0))
    for extreme in (np.min, np.max):
        np.testing.assert_array_equal(extreme(estimate.values, axis=0), extreme(random, axis=0))


def test_of_many_coordinates_those_that_move_most_are_drawn(tmp_path: Path) -> None:
    """Positions come first, then velocities, in the order of the model; the rest is counted."""
    names = tuple(f"x{i}" for i in range(20))
    path = tmp_path / "bag"
    with BagWriter(path) as writer:
        writer.declare("/plant/joint_states")
        for k in range(10):
            stamp, q = EPOCH + k * STEP, np.arange(20.0)[::-1] * k
            state = JointState(stamp, names, q, np.zeros(20))
            writer.write("/plant/joint_states", stamp, MAKE.joint_state(state))
    with BagReader(path) as reader:
        found = read_recording(reader, None)
    shown = [f"{kind}_x{i}" for kind in "qu" for i in range(8)]
    assert [each.name for each in found.quantities] == shown
    assert found.left_out == 12
    assert found.series[0].values.shape == (10, 16)
