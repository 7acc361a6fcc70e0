# SPDX-License-Identifier: Apache-2.0
"""The stamps of the estimates that an observer node publishes."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from impact_observer.ros.observer_node import MOST_DUE, due_stamps
from impact_observer.stamps import NS_PER_S

EPOCH = 5 * NS_PER_S


@pytest.mark.parametrize("rate", [0.7, 100.0, 1000.0, 1e5 / 3])
def test_every_stamp_of_the_grid_is_due_once(rate: float) -> None:
    """The stamps do not depend on the instants of the calls."""
    stamps, now = list[int](), EPOCH
    while len(stamps) < 500:
        now += int(0.9 * NS_PER_S / rate)
        due, skipped = due_stamps(rate, EPOCH, EPOCH, stamps[-1] if stamps else None, now)
        assert skipped == 0
        assert all(stamp <= now for stamp in due)
        stamps += due
    assert stamps == [EPOCH + round(k * NS_PER_S / rate) for k in range(len(stamps))]


def test_old_estimates_are_skipped_and_counted_but_never_the_first() -> None:
    """Old estimates occur after a jump of the clock."""
    due, skipped = due_stamps(100.0, EPOCH, EPOCH, None, EPOCH + 3 * NS_PER_S)
    assert due[0] == EPOCH
    assert due[1] == EPOCH + 2_810_000_000
    assert due[-1] == EPOCH + 3 * NS_PER_S
    assert (len(due), skipped) == (MOST_DUE + 1, 280)
    assert due_stamps(100.0, EPOCH, EPOCH, due[-1], EPOCH + 3_005_000_000) == ([], 0)
    due, skipped = due_stamps(100.0, EPOCH, EPOCH, due[-1], EPOCH + 4 * NS_PER_S)
    assert (len(due), skipped) == (MOST_DUE, 80)


def test_estimates_may_begin_before_the_epoch_and_another_rate_goes_on_ascending() -> None:
    """Estimates begin at the first stamp of the grid that is not before the start."""
    start = EPOCH - 250_000_000
    due, _ = due_stamps(10.0, EPOCH, start, None, EPOCH)
    assert [stamp - EPOCH for stamp in due] == [-200_000_000, -100_000_000, 0]
    due, _ = due_stamps(4.0, EPOCH, start, due[-1], EPOCH + 600_000_000)
    assert [stamp - EPOCH for stamp in due] == [250_000_000, 500_000_000]
    assert due_stamps(4.0, EPOCH, EPOCH, None, EPOCH) == ([EPOCH], 0)
