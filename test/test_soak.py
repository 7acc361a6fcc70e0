"""Hostile inputs to everything that reads something foreign; ``./dev soak`` gives many more."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from benchmarks.soak import soak
from benchmarks.soak_targets import TARGETS, Target
from impact_observer.errors import UsageError

INPUTS = {"bag": 4, "csv": 12, "model": 12, "measurements": 12, "sensors": 12}


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


@pytest.mark.parametrize("number", [4628, 13717])
def test_numbers_of_any_length_are_refused(number: int, tmp_path: Path) -> None:
    """Found by ./dev soak: whole numbers beyond a float, and of 5000 digits."""
    target = next(each for each in TARGETS if each.name == "parameters")
    assert soak(target, [number], 1, tmp_path).refused == 1
