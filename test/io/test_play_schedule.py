# SPDX-License-Identifier: Apache-2.0
"""How a bag is played, and when each message is due."""

import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.errors import BagError, UsageError
from impact_observer.io.play_schedule import Pace, Playing, ReadAhead, Ticks
from impact_observer.io.reader import RawMessage

WALL = 10**15
TIMES = st.integers(0, 10**9)


def messages(log_times: list[int]) -> list[RawMessage]:
    """Messages at these log times, ns."""
    return [RawMessage("/x", log_time, b"") for log_time in log_times]


def test_message_is_due_at_its_distance_from_the_start() -> None:
    """Divided by the rate, rounded to the nanosecond."""
    assert Pace(1000, WALL).due(1750) == WALL + 750
    assert Pace(1000, WALL, rate=4.0).due(2002) == WALL + 250
    assert Pace(1000, WALL, rate=0.5).due(1001) == WALL + 2
    assert Pace(1000, WALL, paused=True).due(1001) is None


def test_due_times_do_not_drift() -> None:
    """The millionth message is as exact as the first, and so is the millionth tick."""
    pace, ticks = Pace(10**18, 0, rate=3.0), Ticks(3.0, WALL, 1_000_000)
    dues = [pace.due(10**18 + k * 1_000_000) for k in (0, 1, 999_999, 1_000_000)]
    assert dues == [0, 333_333, 333_333_000_000, 333_333_333_333]
    assert ticks.next == WALL + 333_333_333_333_333


@examples(50)
@given(
    begin=TIMES, pause=TIMES, length=TIMES, log_time=TIMES, rate=st.sampled_from([0.5, 1.0, 4.0])
)
def test_pause_delays_messages_by_its_length(
    begin: int, pause: int, length: int, log_time: int, rate: float
) -> None:
    """And the bag's time stands still during the pause."""
    pace = Pace(0, begin, rate)
    before = pace.due(log_time)
    assert before is not None
    there = pace.at(begin + pause)
    pace.toggle_pause(begin + pause, 10**18)
    assert pace.at(begin + pause) == pace.at(begin + pause + length) == there
    assert pace.due(log_time) is None
    pace.toggle_pause(begin + pause + length, 10**18)
    after = pace.due(log_time)
    assert after is not None
    assert abs(after - before - length) <= 2  # rounded to ns of the bag at the pause


@examples(50)
@given(change=TIMES, later=TIMES, factor=st.sampled_from([1.1, 1 / 1.1, 2.0]))
def test_another_rate_holds_from_now_on(change: int, later: int, factor: float) -> None:
    """The bag's time does not jump."""
    pace = Pace(500, WALL)
    there = pace.at(WALL + change)
    pace.scale_rate(WALL + change, 10**18, factor)
    assert pace.at(WALL + change) == there == 500 + change
    assert abs(pace.at(WALL + change + later) - (there + later * factor)) <= 1


def test_message_that_is_late_is_not_passed_over_by_a_pause() -> None:
    """The bag's time stops at the next message, so that the clock need not go back."""
    pace = Pace(0, WALL)
    pace.toggle_pause(WALL + 1000, latest=700)
    assert pace.paused
    assert pace.at(WALL + 2000) == 700


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"rate": 0.0}, r"rate is 0\.0; expected a positive number"),
        ({"rate": float("nan")}, "rate is nan"),
        ({"clock_rate": -1.0}, r"clock rate is -1\.0"),
        ({"duration": float("inf")}, "duration is inf"),
    ],
)
def test_number_out_of_range_is_named(wrong: dict[str, float], said: str) -> None:
    """With what is expected."""
    with pytest.raises(UsageError, match=said):
        Playing(**wrong)  # type: ignore[arg-type]


def test_reading_ahead_changes_nothing() -> None:
    """Also for more messages than are read ahead."""
    wanted = messages(list(range(1, 12_001)))
    assert list(ReadAhead(wanted)) == wanted
    assert list(ReadAhead([])) == []


def test_reading_ahead_ends_with_its_consumer() -> None:
    """Its thread ends as well, however long the bag is."""
    before = threading.active_count()
    ahead = ReadAhead(messages(list(range(1, 20_001))))
    assert next(iter(ahead)).log_time == 1
    ahead.close()
    assert threading.active_count() == before


def test_damage_is_raised_at_its_message() -> None:
    """After the messages before it."""

    def damaged() -> Iterator[RawMessage]:
        yield from messages([1, 2])
        raise BagError("torn")

    ahead = iter(ReadAhead(damaged()))
    assert [next(ahead).log_time, next(ahead).log_time] == [1, 2]
    with pytest.raises(BagError, match="torn"):
        next(ahead)
