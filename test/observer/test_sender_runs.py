# SPDX-License-Identifier: Apache-2.0
"""Which run of the sender is followed: the newest."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from systems import EPOCH, chain, event, examples, observer

from impact_observer.batch.recorded_run import RecordedRun
from impact_observer.events import ImpactEvent, Remark, Ruling
from impact_observer.observer import Observer, replay
from impact_observer.observer.sender_runs import BEGUN_AGAIN, in_order, runs_of
from impact_observer.stamps import NS_PER_S

MODEL = chain(2, contacts=[([0, -1], 0.1, 0.5), ([1, 0], 0.2, 0.3)])
LATER = EPOCH + 3 * NS_PER_S
NONE = np.empty(0, dtype=np.int64)


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


@examples(20)
@given(data=st.data())
def test_live_and_offline_end_in_the_same_bits(data: st.DataObject) -> None:
    """Whatever events of older runs come late, among those of the newest."""
    old, new = numbered(6, episode=1), numbered(6, 3.0, episode=1, epoch=LATER)
    late = data.draw(st.permutations([*old[3:], *new[1:]]))
    wanted = bits(watcher(*new))
    assert [bits(each) for each in live_and_offline([*old[:3], new[0], *late])] == [wanted] * 2


def test_a_new_run_begins_with_its_first_event() -> None:
    """Later events of the old one are rejected and counted."""
    old, new = numbered(4), numbered(3, 3.0, epoch=LATER)
    found = watcher(*old[:3], new[0])
    assert found.restarts == 1
    (verdict,) = found.receive(old[3])
    assert verdict.ruling is Ruling.REJECTED
    assert found.remarks[Remark.OLD_RUN] == 1
    found.receive(new[1])
    assert bits(found) == bits(watcher(*new[:2]))


def test_a_sender_that_begins_again_with_a_lower_episode_is_followed() -> None:
    """Once the newest stamp is some seconds old, so that its event is no late one."""
    before = event(1.0, "c1", sequence=1, episode=5)
    soon = event(2.0, "c1", sequence=1, episode=0)
    again = replace(soon, stamp=before.stamp + BEGUN_AGAIN + 1)
    assert runs_of([before, soon, again]) == [[before], [again]]
    assert watcher(before, soon).restarts == 0
    assert watcher(before, soon, again).restarts == 1


def test_an_epoch_that_becomes_known_begins_no_run() -> None:
    """Nor does one that an event does not say."""
    events = numbered(4)
    unknown = [replace(each, epoch=0) for each in events]
    found = watcher(unknown[0], events[1], unknown[2], events[3])
    assert found.restarts == 0
    assert bits(found) == bits(watcher(*events))


def test_numbers_that_leap_are_counted_as_missing() -> None:
    """Whatever comes first."""
    events = [event(0.1 * k, "c1", sequence=k) for k in (5, 6, 9)]
    assert watcher(*events).missing == watcher(*events[::-1]).missing == 2


def test_a_recording_ends_in_the_run_that_is_in_use() -> None:
    """Late events of an older one are not of it."""
    old, true = numbered(3), numbered(6, 3.0, epoch=LATER)
    found = RecordedRun.last(MODEL, in_order([*old[:2], *true, old[2]]))
    assert [key.sequence for key in found.keys] == [1, 2, 3, 4, 5, 6]
