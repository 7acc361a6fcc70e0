# SPDX-License-Identifier: Apache-2.0
"""Items that are stamped ahead of the clock."""

from impact_observer.ros.ahead_of_clock import AheadOfClock


def test_items_come_in_the_order_of_their_stamps_and_the_farthest_has_no_room() -> None:
    """Items of one stamp come in the order in which they were kept."""
    ahead = AheadOfClock[str](3)
    given = [(5, "e"), (3, "c"), (5, "f"), (9, "i"), (4, "d")]
    assert [ahead.keep(stamp, item) for stamp, item in given] == [None, None, None, "i", "f"]
    assert ahead.take_next(2) is None
    assert [ahead.take_next(latest) for latest in (3, 3, 9, 9, 9)] == ["c", None, "d", "e", None]
    ahead.keep(1, "a")
    ahead.clear()
    assert ahead.take_next(9) is None
