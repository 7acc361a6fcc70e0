# SPDX-License-Identifier: Apache-2.0
"""Hostile inputs to everything that reads something foreign; ``./dev soak`` gives many more."""

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from benchmarks.soak import soak
from benchmarks.soak_targets import TARGETS, Target, expected_errors
from impact_observer.cli.arguments import value_of
from impact_observer.errors import UsageError
from impact_observer.options import OBSERVER_OPTIONS, Option, Options

INPUTS = {
    "bag": 4,
    "database": 6,
    "commands": 12,
    "robot": 8,
    "csv": 12,
    "model": 12,
    "measurements": 12,
    "sensors": 12,
}


@pytest.mark.parametrize("target", TARGETS, ids=lambda each: each.name)
def test_every_input_is_used_or_refused_by_one_line(target: Target, tmp_path: Path) -> None:
    """Whatever has been done to it; others than those of ./dev soak."""
    count = INPUTS.get(target.name, 60)
    found = soak(target, range(count), 2, tmp_path)
    assert found.foreign == {}
    assert found.used + found.refused == count


def test_a_foreign_exception_is_counted_and_can_be_repeated(tmp_path: Path) -> None:
    """By its kind and place, with the number of its first input."""

    def make(_: Path) -> object:
        def attack(draw: object) -> object:
            number = int(draw.random() * 3)  # type: ignore[attr-defined]
            if number == 0:
                raise UsageError("refused")
            return [][number - 1] if number == 1 else number

        return attack

    found = soak(Target("own", 1.0, make), range(30), 1, tmp_path)  # type: ignore[arg-type]
    assert found.refused
    assert found.used
    ((what, number),) = found.foreign.items()
    assert what.startswith("IndexError at test_soak.py")
    assert soak(Target("own", 1.0, make), [number], 1, tmp_path).foreign  # type: ignore[arg-type]


NUMBERS = [each for each in OBSERVER_OPTIONS if each.type in {"int", "double"}]


@pytest.mark.parametrize("option", NUMBERS, ids=lambda each: each.name)
def test_numbers_of_any_length_are_refused(option: Option) -> None:
    """Found by ./dev soak: whole numbers beyond a float, and of 5000 digits."""
    for digits in (300, 5000):
        with pytest.raises(expected_errors()):
            value_of(option)("9" * digits)
    given: dict[str, Any] = {option.name: 10**400}
    with pytest.raises(UsageError):
        Options(**given)
