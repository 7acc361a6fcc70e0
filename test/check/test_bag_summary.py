# SPDX-License-Identifier: Apache-2.0
"""The summary of a bag: impacts counted by contact and episode."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from impact_observer.check import bag_summary
from impact_observer.check.bag_summary import summarize
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io import BagWriter
from impact_observer.io.messages import bag_messages
from impact_observer.observer.event_order import impacts_of


def test_impacts_are_counted_by_contact_and_episode(tmp_path: Path) -> None:
    """A closing is an impact, an opening is none."""
    make = bag_messages()
    both = (Switch("left"), Switch("right", Kind.CLOSE))
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/impacts", 1, make.event(ImpactEvent(1, both, 1, 1)))
        writer.write(
            "/impacts", 2, make.event(ImpactEvent(2, (Switch("right", Kind.OPEN),), 2, 1))
        )
        writer.write("/impacts", 3, make.event(ImpactEvent(3, (Switch("left"),), 3, 2)))
    summary = summarize(tmp_path / "bag")
    assert summary.impacts == {"left": 2, "right": 1}
    assert summary.closings == {"right": 1}
    assert summary.episodes == 2
    assert summary.model is None
    assert summary.observers == {}


def test_impact_superseded_by_a_close_is_counted_once(tmp_path: Path) -> None:
    """The impact counts as persistent contact; a duplicate is counted once too."""
    make = bag_messages()
    switches = [(1, Kind.IMPACT), (2, Kind.IMPACT), (2, Kind.CLOSE), (3, Kind.OPEN)]
    events = [
        ImpactEvent(stamp, (Switch("stop", kind),), k + 1)
        for k, (stamp, kind) in enumerate(switches)
    ]
    with BagWriter(tmp_path / "bag") as writer:
        for event in [*events, events[0]]:
            writer.write("/impacts", 10, make.event(event))
    summary = summarize(tmp_path / "bag")
    assert (summary.impacts, summary.closings) == ({"stop": 2}, {"stop": 1})


def test_many_events_are_counted_in_windows_as_all_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The events have superseded impacts, disorder, duplicates and several runs."""
    draw = np.random.default_rng(5)
    events, number = [], 0
    for episode in (1, 2):
        for stamp in np.sort(draw.integers(1, 4000, 600)).tolist():
            kinds = (Kind.IMPACT, Kind.CLOSE) if draw.random() < 0.2 else (Kind.IMPACT,)
            for kind in kinds:
                number += 1
                name = str(draw.choice(["left", "right"]))
                events.append(ImpactEvent(stamp, (Switch(name, kind),), number, episode))
                if kind is Kind.CLOSE:
                    number += 1
                    opened = (Switch(name, Kind.OPEN),)
                    events.append(ImpactEvent(stamp + 1, opened, number, episode))
    for i in draw.integers(0, len(events) - 8, 200).tolist():
        events.insert(i + 5, events.pop(i))
    whole = [impact[1:] for impact in impacts_of(events)]
    monkeypatch.setattr(bag_summary, "WINDOW", 50)
    assert Counter(bag_summary.impacts_in_order(iter(events))) == Counter(whole)
