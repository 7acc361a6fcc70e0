# SPDX-License-Identifier: Apache-2.0
"""Comparing estimates of robots with the truth: V, errors after hits, coverage."""

from pathlib import Path

import numpy as np
import pytest
from arms import DOUBLE, SLIDER, model_of, wall

pytest.importorskip("pinocchio", reason="not installed: extra robots")

from impact_observer.cli.main import main
from impact_observer.compare.bag_comparison import compare_bag
from impact_observer.compare.comparison import Comparison, compare_states
from impact_observer.compare.error_tables import print_tables
from impact_observer.errors import UnfitBagError
from impact_observer.events import ImpactEvent, Ruling, Switch, Verdict
from impact_observer.io.pairing import samples_of
from impact_observer.io.reader import BagReader
from impact_observer.observer.event_outcomes import EventOutcomes, outcomes_of
from impact_observer.robots import Robot
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Vector

ARM = Robot(model_of(DOUBLE, "shoulder, elbow", rotor_inertia="{elbow: 0.1}", contacts=wall()))
NO_EVENTS = outcomes_of((), ())
STAMPS = NS_PER_S + 1_000_000 * np.arange(400)
HITS = (NS_PER_S + 100_300_000, NS_PER_S + 130_000_000, NS_PER_S + 290_700_000)
EVENTS = [ImpactEvent(stamp, (Switch("wall"),), k) for k, stamp in enumerate(HITS, 1)]


def mass(q: Vector) -> Matrix:
    """The mass matrix of ``ARM``, by hand: two rods of 1.5 and 0.8 kg, and the elbow's rotor."""
    far = 0.02 + 0.8 * 0.3**2
    both = far + 0.8 * 0.7 * 0.3 * np.cos(q[1])
    near = 0.05 + 1.5 * 0.4**2 + 0.8 * 0.7**2 + 2 * both - far
    return np.array([[near, both], [both, far + 0.1]])


def compared(
    truth: Matrix,
    error: Matrix,
    outcomes: EventOutcomes = NO_EVENTS,
    deviations: Matrix | None = None,
) -> Comparison:
    """The comparison of estimates with this ``error``, at as many of ``STAMPS``."""
    stamps = STAMPS[: len(truth)]
    nothing = np.full_like(truth, np.nan)
    estimates = samples_of(stamps, truth + error, deviations=deviations)
    return compare_states(
        ARM, "some law", samples_of(stamps, truth, deviations=nothing), estimates, outcomes
    )


def test_distance_weighs_both_errors_with_the_mass_at_the_true_position() -> None:
    """A hand-written mass matrix gives the same V."""
    rng = np.random.default_rng(1)
    truth, error = rng.normal(size=(2, 50, 4))
    wanted = [
        (e[:2] @ mass(x[:2]) @ e[:2] + e[2:] @ mass(x[:2]) @ e[2:]) / 2
        for x, e in zip(truth, error, strict=True)
    ]
    np.testing.assert_allclose(compared(truth, error).V, wanted, rtol=1e-12)


def test_whole_turns_of_a_continuous_joint_are_no_error() -> None:
    """The encoder that an observer started from may count modulo a turn."""
    error = np.full((3, 4), 0.1)
    turned = error + np.array([4 * np.pi, -2 * np.pi, 0, 0])
    found = compared(np.ones((3, 4)), turned)
    np.testing.assert_allclose(found.error, error, atol=1e-14)
    assert compared(np.ones((3, 4)), error).largest[0] == pytest.approx(0.1)


def test_errors_after_hits_are_those_from_2_to_50_ms_after_the_last_hit() -> None:
    """A loop over samples and hits finds the same ones, rejected hits among them."""
    truth, error = np.zeros((400, 4)), np.random.default_rng(2).normal(size=(400, 4))
    verdicts = [Verdict(HITS[0], Ruling.REJECTED, 1), Verdict(HITS[1], Ruling.APPLIED, 2)]
    found = compared(truth, error, outcomes_of(EVENTS, verdicts))
    squares = []
    for stamp, e in zip(STAMPS.tolist(), error, strict=True):
        before = [hit for hit in HITS if hit <= stamp]
        if before and 0.002 <= (stamp - before[-1]) * 1e-9 < 0.05:
            squares.append(e**2)
    assert 100 < len(squares) < 150
    wanted = np.sqrt(np.mean(squares, axis=0))
    assert found.rms_after_hits is not None
    np.testing.assert_allclose(found.rms_after_hits, wanted, rtol=1e-12)
    assert found.velocity_after_hits == pytest.approx(np.hypot(*wanted[2:]), rel=1e-12)
    assert compared(truth, error).velocity_after_hits is None, "there was no hit"


def test_velocities_in_different_units_have_no_common_error() -> None:
    """The sum of rad/s and m/s would mean nothing; each joint has its own number."""
    text = DOUBLE.replace('name="shoulder" type="continuous"', 'name="shoulder" type="prismatic"')
    robot = Robot(model_of(text, "shoulder, elbow", contacts=wall()))
    x = samples_of(STAMPS, np.zeros((400, 4)))
    found = compare_states(robot, "some law", x, x, outcomes_of(EVENTS, None))
    assert found.velocity_after_hits is None
    assert found.rms_after_hits is not None
    slider = Robot(model_of(SLIDER, "rail", contacts=wall(normal="[0, 0, 1]")))
    x = samples_of(STAMPS, np.zeros((400, 2)))
    assert compare_states(slider, "law", x, x, outcomes_of(EVENTS, None)).velocity_after_hits == 0


def test_a_robot_without_contacts_is_compared() -> None:
    """There are no hits, and all samples count."""
    robot = Robot(model_of(SLIDER, "rail"))
    x = samples_of(STAMPS, np.zeros((400, 2)))
    found = compare_states(robot, "law", x, samples_of(STAMPS, np.ones((400, 2))), NO_EVENTS)
    np.testing.assert_allclose(found.V, 2.0)
    assert found.samples == 400
    assert found.rms_after_hits is None
    assert compare_states(robot, "law", x, x, NO_EVENTS).V.max() == 0.0


def test_coverage_is_the_share_of_errors_within_two_deviations() -> None:
    """Counted one by one; estimates without a covariance do not count."""
    rng = np.random.default_rng(3)
    deviations = rng.uniform(0.05, 0.2, size=(400, 4))
    error = rng.normal(size=(400, 4)) * deviations * [1.0, 0.5, 1.0, 2.0]
    deviations[:10] = np.nan
    found = compared(np.zeros((400, 4)), error, deviations=deviations).coverage
    assert found is not None
    for i, share in enumerate(found):
        inside = sum(abs(error[k, i]) <= 2 * deviations[k, i] for k in range(10, 400))
        assert share == pytest.approx(inside / 390, abs=1e-12)
    assert compared(np.zeros((400, 4)), error).coverage is None


@pytest.mark.parametrize(("first", "is_known"), [(0.0, False), (1e-4, False), (1.0, True)])
def test_ratio_to_a_start_at_the_truth_is_not_given(
    first: float, is_known: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where errors begin about zero, and are 0.3 later, no V/V0 is printed, and a note says so."""
    error = np.full((100, 4), 0.3)
    error[0] = 0.3 * first
    found = compared(np.zeros((100, 4)), error)
    assert (found.ratio is not None) == is_known
    print_tables({"some law": found})
    said = " ".join(capsys.readouterr().out.split())
    assert ("V0 of some law is about zero" in said) != is_known
    assert ("V end [J] V/V0" in said) == is_known


def test_a_bag_of_a_robot_without_estimates_is_told_of_observe_alone(tmp_path: Path) -> None:
    """Laws cannot be run by compare: a robot's observers need measurements."""
    bag = str(tmp_path / "bag")
    assert main(["simulate", "hammer_arm", "--duration", "0.1", "--rate", "100", "-o", bag]) == 0
    with BagReader(Path(bag)) as reader, pytest.raises(UnfitBagError) as found:
        compare_bag(reader, ARM)
    wanted = f"{bag}: has no estimates; make them with observe --measurements FILE"
    assert str(found.value) == wanted
