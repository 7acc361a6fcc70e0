# SPDX-License-Identifier: Apache-2.0
"""The words that all rooms share: errors, stamps, events, states and shared files."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer import errors, resources
from impact_observer.events import Kind, Ruling
from impact_observer.stamps import (
    MAX_STAMP,
    NS_PER_S,
    Instant,
    from_seconds,
    grid,
    seconds_between,
    text,
)
from impact_observer.states import frozen

STAMPS = st.integers(0, MAX_STAMP)


def test_seconds_between_late_stamps_keep_their_nanoseconds() -> None:
    """Integers are subtracted before anything becomes a float."""
    assert seconds_between(MAX_STAMP - 1, MAX_STAMP) == 1e-9
    assert seconds_between(MAX_STAMP, MAX_STAMP - 250_000_000) == -0.25


@examples(200)
@given(STAMPS, st.floats(-1e3, 1e3))
def test_instant_is_within_half_a_nanosecond_of_its_stamp(start: int, seconds: float) -> None:
    """After any step the remainder is at most half a nanosecond."""
    later = Instant(start).shifted_by(seconds)
    assert abs(later.remainder) <= 0.5e-9 * (1 + 1e-6)
    assert -later.until(start) == pytest.approx(seconds, abs=2e-13)


@examples(200)
@given(STAMPS, st.lists(st.floats(0, 10), max_size=20))
def test_instants_add_up_without_drift(start: int, steps: list[float]) -> None:
    """Many small steps end where one large step ends, far below a nanosecond."""
    instant = Instant(start)
    for step in steps:
        instant = instant.shifted_by(step)
    assert -instant.until(start) == pytest.approx(sum(steps), abs=1e-12)


def test_grid_rounds_every_stamp_from_its_own_product() -> None:
    """At 3 Hz an hour has exactly 10801 samples, each within half a nanosecond."""
    stamps = grid(7, 7 + 3600 * NS_PER_S, 3.0)
    exact = [7 + round(k * NS_PER_S / 3) for k in range(10801)]
    assert stamps.tolist() == exact


def test_grid_ends_at_its_last_stamp_and_not_after() -> None:
    """The interval is closed at both ends, and may be empty or a point."""
    assert grid(0, NS_PER_S, 4.0).tolist() == [0, 250_000_000, 500_000_000, 750_000_000, NS_PER_S]
    assert grid(0, NS_PER_S - 1, 4.0)[-1] == 750_000_000
    assert grid(5, 5, 100.0).tolist() == [5]
    assert grid(5, 4, 100.0).size == 0


def test_stamp_text_has_all_nine_digits() -> None:
    """A stamp is printed exactly, on either side of zero."""
    assert text(12_000_000_345) == "12.000000345"
    assert text(-1) == "-0.000000001"
    assert from_seconds(1.5) == 1_500_000_000


def test_kinds_and_rulings_have_the_numbers_of_the_messages() -> None:
    """Bags carry these numbers; they never change."""
    assert [(k.name, k.value) for k in Kind] == [("IMPACT", 0), ("CLOSE", 1), ("OPEN", 2)]
    assert [(r.name, r.value) for r in Ruling] == [
        ("APPLIED", 0),
        ("REJECTED", 1),
        ("INSERTED", 2),
        ("DUPLICATE", 3),
        ("TOO_LATE", 4),
        ("UNKNOWN_CONTACT", 5),
    ]


def test_frozen_is_a_read_only_copy_without_minus_zero() -> None:
    """Changes of the caller's array do not reach the copy."""
    mine = np.array([-0.0, 1.0])
    theirs = frozen(mine)
    mine[1] = 2.0
    assert theirs.tolist() == [0.0, 1.0]
    assert not np.signbit(theirs).any()
    assert not theirs.flags.writeable


@pytest.mark.parametrize(
    ("error", "builtin", "exit_code"),
    [
        (errors.UsageError("x"), ValueError, 2),
        (errors.ModelError("mass", "x"), ValueError, 2),
        (errors.BagError("x"), Exception, 1),
        (errors.DynamicsError("x"), ArithmeticError, 1),
        (errors.ImpactLawError("x"), ArithmeticError, 1),
    ],
    ids=lambda value: type(value).__name__,
)
def test_every_error_is_of_the_package_with_an_exit_code(
    error: errors.ImpactObserverError, builtin: type[Exception], exit_code: int
) -> None:
    """Callers may catch the package's class or the builtin one."""
    assert isinstance(error, errors.ImpactObserverError)
    assert isinstance(error, builtin)
    assert error.exit_code == exit_code


def test_model_error_is_one_line_whatever_the_file_holds() -> None:
    """A key with a line end in it does not break the line."""
    error = errors.ModelError("a\nb", "is not known\nhere")
    assert str(error) == "a b: is not known here"
    assert error.key == "a\nb"


def test_shared_file_is_found_where_ament_installs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every prefix in AMENT_PREFIX_PATH is looked at."""
    installed = tmp_path / "share" / "impact_observer" / "config" / "x.yaml"
    installed.parent.mkdir(parents=True)
    installed.touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'other'}:{tmp_path}")
    assert resources.shared("config/x.yaml") == installed


def test_missing_shared_file_is_named() -> None:
    """The error says what to do."""
    with pytest.raises(errors.UsageError, match=r"config/no\.yaml"):
        resources.shared("config/no.yaml")
