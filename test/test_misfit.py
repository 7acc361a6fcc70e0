# SPDX-License-Identifier: Apache-2.0
"""The evaluation of ``./dev bench misfit``, and its plants under the law."""

import numpy as np
import pytest
import systems

from benchmarks.misfit import goals, main
from benchmarks.misfit_alarms import most
from benchmarks.misfit_motion import EPOCH, Recording
from benchmarks.misfit_runs import (
    EVERY,
    GEOMETRIC,
    Followed,
    Job,
    Outcome,
    consistency,
    followed,
    outcome,
    relative_error,
    wrongly_synchronized,
)
from impact_observer import Options

SYSTEM = systems.system(2.0, 0.0, 8.0, contacts=[([1.0], 0.1, 0.5)])
"""V = u^2 + 4 q^2."""


def made(**changes: object) -> Outcome:
    """A run of a wrong plant that meets all goals."""
    given = {
        "plant": "a",
        "group": "tuned",
        "kind": "gap",
        "seed": 0,
        "impacts": 60,
        "z": 1.0,
        "flag": 0.0,
        "geometric": 0.04,
        "filtered": 0.02,
        "warned": 40,
    }
    return Outcome(**{**given, **changes})  # type: ignore[arg-type]


def test_relative_error_is_of_the_median_energy_of_errors() -> None:
    """Errors of V = 4e-4, 1e-4, 9e-4 J in a motion of 4, 4 and 1 J: sqrt(4e-4 / 3)."""
    truth = np.array([[1.0, 0.0], [0.0, 2.0], [0.0, 1.0]])
    errors = np.array([[0.01, 0.0], [0.0, 0.01], [0.0, 0.03]])
    assert relative_error(SYSTEM, truth + errors, truth) == pytest.approx(np.sqrt(4e-4 / 3))


def test_z_is_the_median_of_samples_and_coordinates() -> None:
    """Of 1, 2, 3 and, without any uncertainty, infinity; 0 / 0 says nothing."""
    covariances = np.array([np.diag([4.0, 1.0]), np.diag([1.0, 0.0]), np.diag([0.0, 1e-2])])
    errors = np.array([[-2.0, 2.0], [3.0, 1.0], [0.0, 0.25]])
    assert consistency(errors, covariances) == pytest.approx(2.5)


def test_flag_is_wrong_above_ten_deviations() -> None:
    """E[V] = (2 0.01 + 8 0.04) / 2 = 0.17 J, so from V = 17 J on, and only while it is true."""
    covariances = np.tile(np.diag([0.04, 0.01]), (3, 1, 1))
    found = Followed(np.zeros((3, 2)), covariances, np.array([True, True, False]), None)
    errors = np.array([[0.0, 4.12], [0.0, 4.13], [0.0, 5.0]])
    assert wrongly_synchronized(SYSTEM, errors, found).tolist() == [False, True, False]


@pytest.mark.parametrize(
    ("changes", "missed"),
    [
        ({}, None),
        ({"z": 0.2}, 0),
        ({"z": 5.1}, 1),
        ({"flag": 0.2}, 2),
        ({"geometric": 0.01}, 3),
        ({"warned": 41}, 5),
        ({"warned": None}, 5),
        ({"warned": None, "filtered": 0.01}, None),
        ({"kind": "exact", "z": 9.0, "filtered": 1.0}, None),
    ],
)
def test_two_runs_of_ten_miss_a_goal(changes: dict[str, object], missed: int | None) -> None:
    """An error of 1 % needs no warning; an exact plant has no goal."""
    found = goals([*[made() for _ in range(8)], *[made(**changes) for _ in range(2)]])
    met = [goal.is_met for goal in found]
    assert met == [k != missed and not (missed == 1 and k == 0) for k in range(6)]


def test_bound_of_the_rate_without_alarms_is_three_over_the_events() -> None:
    """And 4.74 over them after one: Poisson."""
    assert most(1000, 0) == pytest.approx(3e-3, rel=2e-3)
    assert most(1000, 1) == pytest.approx(4.744e-3, rel=1e-3)


def test_an_event_counts_from_its_stamp_on() -> None:
    """The replica jumps onto the stop at -0.1 m, then it swings with 2 rad/s."""
    stamps = EPOCH + np.arange(7) * 10**8
    hit = Recording(stamps[3:4], np.array([0]), stamps[3:4], stamps, np.zeros((7, 2)))
    found = followed(SYSTEM, hit, Options(law=GEOMETRIC, epoch=EPOCH))
    np.testing.assert_allclose(found.states[:, 0], [0.0, -0.1, -0.1 * np.cos(0.6)], atol=1e-12)
    assert len(stamps[::EVERY]) == 3
    assert found.warned is None


@pytest.mark.slow
def test_a_wrong_plant_is_warned_of_and_an_exact_one_is_not() -> None:
    """Restitution that depends on the speed, beside the model with a constant one."""
    wrong = outcome(Job("two_mass-restitution-by-speed-0.1", 0, 20.0))
    exact = outcome(Job("two_mass-exact", 0, 20.0))
    assert isinstance(wrong, Outcome)
    assert isinstance(exact, Outcome)
    assert wrong.warned is not None
    assert wrong.warned < wrong.impacts
    assert wrong.z < 5
    assert exact.warned is None
    assert exact.filtered < 1e-8
    assert 0.1 < exact.z < 5


@pytest.mark.slow
def test_command_prints_the_plants_that_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    """With their goals."""
    assert main(["two_stops-restitution-*", "--seconds", "12", "--jobs", "1"]) == 0
    printed = capsys.readouterr().out
    assert "two_stops-restitution-0.05" in printed
    assert "two_mass" not in printed
    assert "median ratio below 0.8" in printed


def test_an_unknown_plant_is_wrong_use(capsys: pytest.CaptureFixture[str]) -> None:
    """The name is in the message."""
    with pytest.raises(SystemExit, match="2"):
        main(["nothing-*"])
    assert "nothing-*" in capsys.readouterr().err
