# SPDX-License-Identifier: Apache-2.0
"""The first pulse of a drive is the epoch of an observer."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigs import EPOCH, hammer_bag, pulses
from systems import sample

from impact_observer.cli.main import main
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Ruling
from impact_observer.io import BagReader
from impact_observer.io.live_inputs import first_pulse
from impact_observer.io.messages import read_pulse
from impact_observer.io.recordings import events_in
from impact_observer.model.measurement import Measurement
from impact_observer.observer import Observer, Options, make_observer
from impact_observer.observer.samples import SensorSample
from impact_observer.resources import shared
from impact_observer.stamps import NS_PER_S

END = EPOCH + 6 * NS_PER_S
BAG = shared("bags/hammer")


def recorded() -> tuple[list[ImpactEvent], list[int]]:
    """Events and pulses of the bag until the end, and the pulses one period on."""
    with BagReader(BAG) as reader:
        read, events = reader.decoder("/phase_reference"), events_in(reader)
        pulses = [read_pulse(read(each.data)) for each in reader.raw(["/phase_reference"])]
    return (
        [each for each in events if each.stamp < END],
        [each for each in pulses if each < END + NS_PER_S],
    )


def watcher(law: str = "geometric", epoch: int = EPOCH) -> Observer:
    """An observer of the hammer from a wrong start."""
    options = Options(law=law, initial_state="random:1", epoch=epoch, clock_error=0.0)
    return make_observer(sample("hammer").system, options)


def without_epoch(events: list[ImpactEvent]) -> list[ImpactEvent]:
    """The same of a sender that does not know it."""
    return [replace(event, epoch=0) for event in events]


def test_first_pulse_is_the_epoch_where_nothing_else_says_it() -> None:
    """Neither the events nor a parameter; without all of them there is one line."""
    events, pulses = recorded()
    observer, given = watcher(epoch=0), watcher(epoch=pulses[0])
    with pytest.raises(UsageError, match="epoch"):
        observer.receive(without_epoch(events)[0])
    for pulse in pulses:
        observer.take_pulse(pulse)
    given.receive(without_epoch(events)[0])  # the other one has kept it
    for event in without_epoch(events)[1:]:
        (first, *_), (second, *_) = observer.receive(event), given.receive(event)
        assert first.ruling is second.ruling is Ruling.APPLIED
    assert observer.epoch == pulses[0]
    np.testing.assert_array_equal(observer.estimate(END).q, given.estimate(END).q)


def test_epoch_of_the_events_replaces_that_of_a_pulse() -> None:
    """Also where a pulse came first; one that was given stays."""
    events, pulses = recorded()
    observer = watcher(epoch=0)
    observer.take_pulse(pulses[0])
    assert observer.epoch == pulses[0]
    observer.receive(events[0])
    assert observer.epoch == EPOCH
    observer.take_pulse(pulses[1])
    assert observer.epoch == EPOCH
    given = watcher(epoch=EPOCH)
    given.take_pulse(pulses[0])
    assert given.epoch == EPOCH


def test_samples_count_that_came_before_the_epoch_of_the_events() -> None:
    """The estimate is the same, in every bit, as if the epoch had been known from the start."""
    events, pulses = recorded()
    sensor = Measurement(
        "encoder",
        "/joints",
        joint="hammer",
        quantity="position",
        position={"hammer": 1.0},
        deviation=0.01,
    )
    options = Options("minimum-variance", "random:1", epoch=0, clock_error=0.0)
    found = []
    for epoch in (0, EPOCH):
        observer = make_observer(
            sample("hammer").system, replace(options, epoch=epoch), measurements=[sensor]
        )
        observer.take_pulse(pulses[0])
        stamps = range(EPOCH + 10**6, events[0].stamp, 10**7)
        observer.measure([SensorSample(0, stamp, 0.01) for stamp in stamps])
        for event in events[:5]:
            observer.receive(event)
        assert observer.samples.counts[0]["accepted"] == len(stamps) > 3
        found.append(observer.estimate(events[4].stamp).q.tobytes())
    assert found[0] == found[1]


@pytest.mark.long
def test_observe_reads_pulses_and_the_epoch_from_a_bag(tmp_path: Path) -> None:
    """The result has the pulses, too; a bag without an epoch is read from the first pulse on."""
    one, two = tmp_path / "one", tmp_path / "two"
    for source, output in ((BAG, one), (one, two)):
        assert (
            main(["observe", str(source), "--initial-state", "random:1", "-o", str(output)]) == 0
        )
    with BagReader(one) as reader, BagReader(two) as again:
        found = reader.observer_states("/observer/state")
        np.testing.assert_array_equal(found.q, again.observer_states("/observer/state").q)
        assert reader.topics["/phase_reference"].count == len(pulses())
        assert first_pulse(reader) == recorded()[1][0]


def test_recorded_hammer_is_what_its_rig_makes(tmp_path: Path) -> None:
    """The same pulses and, except for rounding, the same impacts."""
    with BagReader(hammer_bag(tmp_path / "bag")) as made, BagReader(BAG) as old:
        stamps = [[each.stamp for each in events_in(reader)] for reader in (made, old)]
        pulses = [
            [each.log_time for each in reader.raw(["/phase_reference"])] for reader in (made, old)
        ]
    np.testing.assert_allclose(stamps[0], stamps[1], rtol=0, atol=2)
    np.testing.assert_allclose(pulses[0], pulses[1], rtol=0, atol=2)
