# SPDX-License-Identifier: Apache-2.0
"""Which run of the sender is followed: no single message resets, blinds or freezes an observer."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import EPOCH, chain, event, examples, observer

from impact_observer.events import ImpactEvent, Kind, Remark, Ruling, Switch
from impact_observer.observer import Observer, replay
from impact_observer.observer.episode import last_episode
from impact_observer.observer.sender_runs import in_order
from impact_observer.stamps import MAX_STAMP, NS_PER_S

MODEL = chain(2, contacts=[([0, -1], 0.1, 0.5), ([1, 0], 0.2, 0.3)])
LATER = EPOCH + 3 * NS_PER_S
NONE = np.empty(0, dtype=np.int64)
LAST = 2**32 - 1


def watcher(*events: ImpactEvent, epoch: int = 0) -> Observer:
    """An observer that has received ``events``."""
    found = observer(MODEL, "geometric", [0.3, -0.4, 1.0, -2.0], ensemble=1, epoch=epoch)
    for each in events:
        found.receive(each)
    return found


def numbered(count: int, begin: float = 0.0, **run: int) -> list[ImpactEvent]:
    """Impacts every 0.1 s after ``begin``, with numbers from 1 on."""
    return [
        event(begin + 0.1 * k, f"c{1 + k % 2}", sequence=k, **run) for k in range(1, count + 1)
    ]


def bits(found: Observer) -> list[object]:
    """The estimates of some instants, by their bits."""
    stamps = [EPOCH + k * NS_PER_S // 8 for k in range(60)]
    estimates = [found.estimate(s) for s in stamps if s >= (found.start or 0)]
    return [(e.stamp, e.closed, e.q.tobytes(), e.u.tobytes()) for e in estimates]


def live_and_offline(events: list[ImpactEvent]) -> tuple[Observer, Observer]:
    """Observers that have received ``events`` one by one, and as a recording."""
    offline = watcher()
    list(replay(offline, in_order(events), NONE))
    return watcher(*events), offline


HOSTILE = st.builds(
    ImpactEvent,
    stamp=st.sampled_from([1, EPOCH - 1, EPOCH + NS_PER_S // 3, LATER + 1, MAX_STAMP]),
    switches=st.sampled_from([(Switch("c1"),), (Switch("c2", Kind.CLOSE),), ()]),
    sequence=st.sampled_from([0, 1, 5, 2**63, 2**64 - 1]),
    episode=st.sampled_from([0, 1, 2, 3, 2**31, LAST]),
    epoch=st.sampled_from([0, 1, EPOCH, EPOCH + 7, LATER, LATER + NS_PER_S, MAX_STAMP]),
)


@examples(30)
@given(hostile=HOSTILE, at=st.sampled_from([*range(7), *range(8, 13)]))
def test_a_single_message_of_another_run_changes_no_bit(hostile: ImpactEvent, at: int) -> None:
    """Whatever it says and whenever it comes, but between the first two events of a run."""
    true = [*numbered(6, episode=1), *numbered(6, 3.0, episode=1, epoch=LATER)]
    if (hostile.epoch or EPOCH, hostile.episode) in {(EPOCH, 1), (LATER, 1)}:
        hostile = replace(hostile, episode=LAST)
    if hostile.episode == 1:
        hostile = replace(hostile, epoch=hostile.epoch or 1)
    attacked = [*true[:at], hostile, *true[at:]]
    wanted = bits(watcher(*true))
    assert [bits(each) for each in live_and_offline(attacked)] == [wanted, wanted]


@pytest.mark.parametrize("law", ["geometric", "minimum-variance"])
@pytest.mark.parametrize("leap", [2**64 - 1, 2**63, 60])
def test_a_number_that_leaps_decides_on_no_contact(law: str, leap: int) -> None:
    """A contact that closes later is closed, though the leap was at that contact."""
    found = observer(MODEL, law, [0.3, -0.4, 1.0, -2.0], ensemble=1)
    for each in [*numbered(5), event(0.55, "c1", sequence=leap)]:
        found.receive(each)
    closing = replace(event(1.7, sequence=6), switches=(Switch("c1", Kind.CLOSE),))
    assert found.receive(closing)[0].ruling is Ruling.APPLIED
    if law == "geometric":
        assert found.estimate(closing.stamp + 1).closed == ("c1",)
    assert found.missing == (0 if leap > 1000 else 53)
    assert found.remarks[Remark.LEAP] == (leap > 1000)


def test_numbers_that_leap_count_once_a_second_one_confirms_them() -> None:
    """Up or down, of which nothing is missing; then gaps are counted from there."""
    outage = [event(0.001 * k, "c1", sequence=k) for k in (5000, 5001, 5004)]
    assert watcher(*numbered(3), *outage[:2]).missing == 0
    assert watcher(*numbered(3), *outage).missing == 2
    again = [event(6.0 + k, "c1", sequence=k) for k in (1, 2)]
    assert watcher(*outage[:2], *again).missing == 0


def test_two_events_in_a_row_change_the_run() -> None:
    """Both are applied; an event of the run in use between them is one of a run that goes on."""
    old, new = numbered(4), numbered(3, 3.0, epoch=LATER)
    found = watcher(*old[:3], new[0], old[3])
    assert found.receive(new[1])[0].ruling is Ruling.REJECTED
    found.receive(new[2])
    assert found.restarts == 1
    assert bits(found) == bits(watcher(*new[1:]))


def test_two_corrupt_messages_reset_an_observer_and_two_true_ones_bring_it_back() -> None:
    """It begins anew with the true ones."""
    true, corrupt = numbered(25), numbered(2, 0.5, episode=9)
    found = watcher(*true[:6], *corrupt, *true[6:])
    assert found.restarts == 2
    assert bits(found)[-1] == bits(watcher(*true[6:]))[-1]


def test_a_recording_ends_in_the_run_that_is_in_use() -> None:
    """A corrupt episode does not hide the events from identify and observability."""
    true = numbered(6)
    corrupt = replace(true[2], episode=LAST, sequence=9)
    found = last_episode(MODEL, in_order([*true, corrupt]))
    assert [key.sequence for key in found.keys] == [1, 2, 3, 4, 5, 6]
