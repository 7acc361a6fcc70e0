# SPDX-License-Identifier: Apache-2.0
"""The stamps of the estimates that an observer node publishes."""

import pytest

from impact_observer.ros.estimate_times import MOST_DUE, EstimateTimes
from impact_observer.stamps import NS_PER_S

EPOCH = 5 * NS_PER_S


@pytest.mark.parametrize("rate", [0.7, 100.0, 1000.0, 1e5 / 3])
def test_every_stamp_of_the_grid_is_due_once(rate: float) -> None:
    """The stamps do not depend on the instants of the calls."""
    times, stamps, now = EstimateTimes(rate), list[int](), EPOCH
    while len(stamps) < 500:
        now += int(0.9 * NS_PER_S / rate)
        due = times.due(EPOCH, EPOCH, now)
        assert due.skipped == 0
        assert all(stamp <= now for stamp in due.stamps)
        stamps += due.stamps
    assert stamps == [EPOCH + round(k * NS_PER_S / rate) for k in range(len(stamps))]


def test_old_estimates_are_skipped_and_counted_but_never_the_first() -> None:
    """Old estimates occur after a jump of the clock."""
    times = EstimateTimes(100.0)
    due = times.due(EPOCH, EPOCH, EPOCH + 3 * NS_PER_S)
    assert due.stamps[0] == EPOCH
    assert due.stamps[1] == EPOCH + 2_810_000_000
    assert due.stamps[-1] == EPOCH + 3 * NS_PER_S
    assert (len(due.stamps), due.skipped) == (MOST_DUE + 1, 280)
    assert times.due(EPOCH, EPOCH, EPOCH + 3_005_000_000) == ([], 0)
    due = times.due(EPOCH, EPOCH, EPOCH + 4 * NS_PER_S)
    assert (len(due.stamps), due.skipped) == (MOST_DUE, 80)


def test_estimates_may_begin_before_the_epoch_and_another_rate_goes_on_ascending() -> None:
    """Estimates begin at the first stamp of the grid that is not before the start."""
    times = EstimateTimes(10.0)
    due = times.due(EPOCH, EPOCH - 250_000_000, EPOCH)
    assert [stamp - EPOCH for stamp in due.stamps] == [-200_000_000, -100_000_000, 0]
    times.change_rate(4.0, EPOCH, EPOCH)
    due = times.due(EPOCH, EPOCH - 250_000_000, EPOCH + 600_000_000)
    assert [stamp - EPOCH for stamp in due.stamps] == [250_000_000, 500_000_000]
    times.restart()
    assert times.due(EPOCH, EPOCH, EPOCH).stamps == [EPOCH]
