# SPDX-License-Identifier: Apache-2.0
"""A recording through an observer: events are received in the order of their stamps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import EPOCH, chain, event, examples, observer

from impact_observer.events import ImpactEvent, Kind, Remark, Ruling, Switch, Verdict
from impact_observer.observer import Observer, replay
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

MODEL = chain(2, contacts=[([0, -1], 0.1, 0.5), ([1, 0], 0.2, 0.3)])
STAMPS = EPOCH + np.arange(1, 40) * (NS_PER_S // 8)


def watcher() -> Observer:
    """An observer that has received nothing."""
    return observer(MODEL, "geometric", [0.3, -0.4, 1.0, -2.0], ensemble=1)


def replayed(events: list[ImpactEvent]) -> tuple[Observer, list[Estimate], list[Verdict]]:
    """The observer, its estimates at ``STAMPS`` and its verdicts on a recording."""
    found, estimates, verdicts = watcher(), list[Estimate](), list[Verdict]()
    recorded = sorted(events, key=lambda e: (e.episode, e.stamp, e.sequence))
    for item in replay(found, recorded, STAMPS):
        if isinstance(item, Estimate):
            estimates.append(item)
        else:
            verdicts.append(item)
    return found, estimates, verdicts


def bits(estimate: Estimate) -> tuple[bytes, bytes, int]:
    """An estimate, by its bits."""
    return estimate.q.tobytes(), estimate.u.tobytes(), estimate.stamp


def test_verdicts_on_jittered_stamps_are_plain() -> None:
    """Numbers 2 and 3 have changed places, and a CLOSE has the stamp of an earlier edge."""
    events = [
        event(0.500, "c1", sequence=1),
        event(1.003, "c2", sequence=2),
        event(1.001, "c1", sequence=3),
        event(1.300, "c2", sequence=4),
        event(1.350, "c1", sequence=5),
        replace(event(1.300, "c2", sequence=6), switches=(Switch("c2", Kind.CLOSE),)),
    ]
    found, estimates, verdicts = replayed(events)
    assert found.missing == 0
    assert [(v.sequence, v.ruling) for v in verdicts if v.ruling is not Ruling.REJECTED] == [
        (each, Ruling.APPLIED) for each in (1, 3, 2, 4, 6, 5)
    ]
    assert not any(v.reason for v in verdicts)
    assert estimates[-1].closed == ("c2",)


def test_events_missing_from_the_recording_are_counted() -> None:
    """By their numbers."""
    found, _, _ = replayed([event(0.1 * k, "c1", sequence=k) for k in (1, 2, 5, 6)])
    assert found.missing == 2


@examples(12)
@given(
    st.lists(st.integers(1, 600), min_size=1, max_size=12),
    st.lists(st.integers(-700, 700), min_size=12, max_size=12),
    st.booleans(),
)
def test_every_estimate_contains_all_events_at_or_before_it(
    gaps: list[int], errors: list[int], numbered: bool
) -> None:
    """For any stamps: it equals that of an observer that has received all events."""
    true = 800 + np.cumsum(gaps)
    events = [
        event((t + e) / 1000, f"c{1 + k % 2}", sequence=(k + 1) * numbered)
        for k, (t, e) in enumerate(zip(true.tolist(), errors, strict=False))
    ]
    found, estimates, verdicts = replayed(events)
    assert not found.remarks[Remark.TOO_LATE]
    assert len(verdicts) == len(events)
    whole = watcher()
    for each in events:
        whole.receive(each)
    stamps = [stamp for stamp in STAMPS.tolist() if stamp >= (whole.start or 0)]
    by_stamp = {each.stamp: each for each in estimates}
    assert [bits(by_stamp[s]) for s in stamps] == [bits(whole.estimate(s)) for s in stamps]


def test_stamp_from_far_ahead_moves_no_estimate() -> None:
    """It is received at its own stamp, whatever its sequence number, so the history is kept."""
    events = [event(0.1 * k, "c1", sequence=k) for k in range(1, 10)]
    ahead = replace(events[4], stamp=EPOCH + 1000 * NS_PER_S)
    found, estimates, _ = replayed([*events[:4], ahead, *events[5:]])
    _, without, _ = replayed([*events[:4], *events[5:]])
    assert len(estimates) == len(STAMPS)
    assert list(map(bits, estimates)) == list(map(bits, without))
    assert found.last_event == ahead.stamp


@pytest.mark.parametrize("moved", [{"episode": 1}, {"epoch": EPOCH + 2 * NS_PER_S}])
def test_sequence_numbers_of_two_runs_are_separate(moved: dict[str, int]) -> None:
    """They begin at 1 again, after those of the run before."""
    first = [event(0.1 * k, "c1", sequence=k) for k in range(1, 8)]
    second = [replace(event(2 + 0.1 * k, "c1", sequence=k), **moved) for k in range(1, 8)]  # type: ignore[arg-type]
    found, _, verdicts = replayed([*first, *second])
    assert [v.sequence for v in verdicts] == [*range(1, 8), *range(1, 8)]
    assert {v.ruling for v in verdicts} == {Ruling.APPLIED}
    assert found.missing == 0
    assert found.restarts == 1
