"""When each message of a bag is due."""

import threading
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from impact_observer.bag.reader import RawMessage
from impact_observer.bag.schedule import Schedule, read_ahead, steps
from impact_observer.errors import BagError

LOG_TIMES = st.lists(st.integers(10**9, 10**9 + 10**8), max_size=20).map(sorted)


def messages(log_times: list[int]) -> list[RawMessage]:
    """Messages at these log times, ns."""
    return [RawMessage("/x", log_time, b"") for log_time in log_times]


def test_message_is_due_at_its_distance_from_the_start() -> None:
    """Divided by the rate, rounded to the nanosecond."""
    assert Schedule(start=1000).due(1750) == 750
    assert Schedule(start=1000, rate=4.0).due(2002) == 250
    assert Schedule(start=1000, rate=0.5).due(1001) == 2


def test_due_times_do_not_drift() -> None:
    """The millionth message is as exact as the first."""
    schedule = Schedule(start=10**18, rate=3.0)
    dues = [schedule.due(10**18 + k * 1_000_000) for k in (0, 1, 999_999, 1_000_000)]
    assert dues == [0, 333_333, 333_333_000_000, 333_333_333_333]


@given(log_times=LOG_TIMES, rate=st.sampled_from([0.5, 1.0, 2.0, 10.0]))
def test_every_message_is_a_step_in_its_order(log_times: list[int], rate: float) -> None:
    """With a clock and without, never going back."""
    wanted, schedule = messages(log_times), Schedule(10**9, rate)
    for clock_rate in (None, 100.0):
        found = list(steps(wanted, schedule, clock_rate))
        assert [step.message for step in found if step.message] == wanted
        assert [step.due for step in found] == sorted(step.due for step in found)
        assert [step.bag_time for step in found] == sorted(step.bag_time for step in found)


@given(log_times=LOG_TIMES.filter(len), rate=st.sampled_from([0.5, 1.0, 2.0]))
def test_clock_ticks_on_a_grid_of_wall_time_until_the_last_message(
    log_times: list[int], rate: float
) -> None:
    """And shows exactly the log time when a message goes out."""
    found = list(steps(messages(log_times), Schedule(10**9, rate), clock_rate=100.0))
    ticks = [step for step in found if step.message is None]
    assert all(step.due % 10_000_000 == 0 for step in ticks)
    assert all(step.bag_time == 10**9 + step.due * rate for step in ticks)
    covered = {step.due // 10_000_000 for step in found}
    assert covered == set(range(max(covered) + 1)) or len(ticks) >= max(covered)
    assert all(step.bag_time == step.message.log_time for step in found if step.message)


def test_without_clock_nothing_but_messages() -> None:
    """However far apart they are."""
    assert len(list(steps(messages([10**9, 10**12]), Schedule(10**9)))) == 2


def test_reading_ahead_changes_nothing() -> None:
    """Also for more messages than are read ahead."""
    wanted = messages(list(range(1, 12_001)))
    assert list(read_ahead(wanted)) == wanted
    assert list(read_ahead([])) == []


def test_reading_ahead_ends_when_nobody_wants_more() -> None:
    """Its thread too, however long the bag is."""
    before = threading.active_count()
    ahead = read_ahead(messages(list(range(1, 20_001))))
    assert next(ahead).log_time == 1
    ahead.close()
    assert threading.active_count() == before


def test_damage_is_told_where_it_was_met() -> None:
    """After the messages before it."""

    def damaged() -> Iterator[RawMessage]:
        yield from messages([1, 2])
        raise BagError("torn")

    ahead = read_ahead(damaged())
    assert [next(ahead).log_time, next(ahead).log_time] == [1, 2]
    with pytest.raises(BagError, match="torn"):
        next(ahead)
