# SPDX-License-Identifier: Apache-2.0
"""Checking the events of a bag: every fault has its line, and there is no other line."""

from pathlib import Path

import pytest
from faulty_bags import GOOD, MAKE, STOP, S, event_message, model, state, write

from impact_observer.check.bag_check import check_bag
from impact_observer.errors import BagError
from impact_observer.events import ImpactEvent, Kind, Ruling, Switch
from impact_observer.io import BagReader, BagWriter
from impact_observer.io.observed_bag import observe_bag
from impact_observer.io.recordings import model_of
from impact_observer.observer import Options, make_observer

pytestmark = pytest.mark.usefixtures("in_tmp_path")


def lines(*, usable: bool) -> list[str]:
    """Severity and line of each finding in ``bag``."""
    report = check_bag(Path("bag"))
    assert report.usable is usable
    return [f"{each.severity} {each.line}" for each in report.findings]


def observed() -> bool:
    """Whether an observer applies any event of ``bag``.

    The epoch is given to the observer if no event has one.
    """
    with BagReader(Path("bag")) as reader:
        epoch = 0 if any(event.epoch for event in reader.events()) else S
        observer = make_observer(
            model_of(reader).system, Options("kinematic", epoch=epoch, ensemble=1)
        )
        try:
            _, rulings = observe_bag(reader, observer, Path("out"), epoch=epoch)
        except BagError:
            return False
    return rulings[Ruling.APPLIED] > 0


CASES: dict[str, tuple[list[ImpactEvent], bool, list[str]]] = {
    "unsorted stamps": (
        [GOOD[0], GOOD[2], GOOD[1], GOOD[3], GOOD[4]],
        True,
        [
            (
                "note /impacts: 1 event stamped before an earlier message, by up to 1 s, the"
                " first is message 2 at 3.000000000 s; they are put in the order of their stamps"
            )
        ],
    ),
    "a message twice": (
        [*GOOD, GOOD[4]],
        True,
        [
            (
                "warning /impacts: 1 message came twice, the first is message 5 at 6.000000000"
                " s; each counts once"
            )
        ],
    ),
    "a number twice": (
        [*GOOD, ImpactEvent(7 * S, STOP, 5, 1, S)],
        True,
        [
            (
                "warning /impacts: 1 message with a sequence number that another event had, the"
                " first is message 5 at 7.000000000 s; expected +1 a message; an observer applies"
                " them, and remarks on it; was the bag made of two? Then let the second have a"
                " higher episode"
            )
        ],
    ),
    "a run without a second event": (
        [*GOOD, ImpactEvent(7 * S, STOP, 1, 5, S)],
        True,
        [
            (
                "warning /impacts: 1 event without effect, of another run of the sender, the first"
                " is message 5 at 7.000000000 s: episode 5 is new: it takes effect with 2 events"
                " in agreement; no others bear them out (docs/events.md); is it one sender, or"
                " are messages corrupt?"
            ),
            "note /impacts: 2 episodes: at each, an observer starts again",
        ],
    ),
    "a stamp twice": (
        [*GOOD, ImpactEvent(6 * S, STOP, 6, 1, S)],
        True,
        [
            (
                "warning /impacts: 1 event with the stamp and contact of another one, the first"
                " is message 5 at 6.000000000 s; are stamps too coarse, or was an event sent"
                " twice under two numbers?"
            )
        ],
    ),
    "a gap": (
        [GOOD[0], GOOD[3], GOOD[4]],
        True,
        [
            (
                "warning /impacts: 2 events missing by the sequence numbers, the first is number"
                " 2, before 5.000000000 s; record with reliable quality of service and a depth"
                " of 2000"
            )
        ],
    ),
    "no numbers": (
        [ImpactEvent(event.stamp, STOP, 0, 1, S) for event in GOOD],
        True,
        [
            (
                "note /impacts: 5 messages without a sequence number; expected numbers from 1"
                " on; without them nobody notices what is lost or comes twice"
            )
        ],
    ),
    "episodes": (
        [*GOOD[:2], *(ImpactEvent(k * S, STOP, k - 3, 2, S) for k in (4, 5, 6))],
        True,
        ["note /impacts: 2 episodes: at each, an observer starts again"],
    ),
    "no epoch": (
        [ImpactEvent(event.stamp, STOP, event.sequence, 1) for event in GOOD],
        True,
        [
            (
                "warning /impacts: no event says the epoch, and the forcing of two_mass depends"
                " on time; expected the stamp of t = 0 in every event; give it with --epoch S;"
                " without it the first pulse on phase_reference counts"
            )
        ],
    ),
    "epochs": (
        [*GOOD[:2], *(ImpactEvent(k * S, STOP, k - 3, 1, 4 * S) for k in (4, 5, 6))],
        True,
        [
            (
                "note /impacts: 2 epochs, 1.000000000 to 4.000000000 s: at each later one, an"
                " observer starts again"
            )
        ],
    ),
    "epoch after events": (
        [ImpactEvent(event.stamp, STOP, event.sequence, 1, 3 * S) for event in GOOD],
        True,
        [
            (
                "warning /impacts: 1 event stamped before their epoch, the first is message 0 at"
                " 2.000000000 s; expected stamps after the epoch, 3.000000000 s; such events are"
                " not applied; is the epoch of another clock, or time 0 of a signal that begins"
                " before its trigger? Give --epoch S, earlier by whole periods of the forcing, or"
                " detect --pulses COLUMN"
            )
        ],
    ),
    "an unknown contact": (
        [*GOOD[:4], ImpactEvent(6 * S, (Switch("wall"),), 5, 1, S)],
        True,
        [
            (
                "warning /impacts wall: 1 event of a contact that the model two_mass does not"
                " have; expected one of stop; they are not applied; rename it in the model or at"
                " the sender"
            )
        ],
    ),
    "none but unknown contacts": (
        [ImpactEvent(event.stamp, (Switch("wall"),), event.sequence, 1, S) for event in GOOD],
        False,
        [
            (
                "error /impacts: none of its contacts (wall) is one of the model two_mass;"
                " expected stop; name the model of this rig with --model"
            )
        ],
    ),
    "OPEN without CLOSE": (
        [*GOOD[:4], ImpactEvent(6 * S, (Switch("stop", Kind.OPEN),), 5, 1, S)],
        True,
        [
            (
                "warning /impacts: 1 OPEN of a contact that is not closed, first of stop,"
                " message 4 at 6.000000000 s; expected CLOSE and OPEN in turn; a CLOSE was lost"
            )
        ],
    ),
    "CLOSE twice": (
        [ImpactEvent(k * S, (Switch("stop", Kind.CLOSE),), k - 1, 1, S) for k in (2, 3)],
        True,
        [
            (
                "warning /impacts: 1 CLOSE of a contact that is closed, first of stop, message 1"
                " at 3.000000000 s; expected CLOSE and OPEN in turn; an OPEN was lost"
            )
        ],
    ),
    "IMPACT of a closed contact": (
        [ImpactEvent(2 * S, (Switch("stop", Kind.CLOSE),), 1, 1, S), GOOD[1]],
        True,
        [
            (
                "warning /impacts: 1 IMPACT of a contact that is closed, first of stop, message"
                " 1 at 3.000000000 s; expected CLOSE and OPEN in turn; an OPEN was lost"
            )
        ],
    ),
    "chatter": (
        [
            ImpactEvent(k * S + i * 1_000_000, STOP, 3 * (k - 2) + i + 1, 1, S)
            for k in range(2, 6)
            for i in range(3)
        ],
        True,
        [
            (
                "warning /impacts stop: 8 of 12 impacts follow another in less than 5 ms; a switch"
                " that is not debounced looks like this (run detect on its signal, with a"
                " dead_time), and so do hits that die out (CLOSE reports rest)"
            )
        ],
    ),
}


def recorded(events: list[ImpactEvent]) -> None:
    """Record a bag of a plant with these events in this order."""
    with BagWriter(Path("bag")) as writer:
        writer.write("/plant/model", S, MAKE.model(model()))
        for k in range(1, 8):
            writer.write("/plant/joint_states", k * S, state(k * S))
        for k, event in enumerate(events):
            writer.write("/impacts", 2 * S + k, MAKE.event(event))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_fault_of_events_has_its_line(case: str) -> None:
    """The line of a fault names the first message that has the fault."""
    events, usable, expected = CASES[case]
    recorded(events)
    assert lines(usable=usable) == expected


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(
            case, marks=() if case in {"a gap", "none but unknown contacts"} else pytest.mark.slow
        )
        for case in CASES
    ],
)
def test_an_observer_applies_events_of_a_bag_exactly_where_it_is_usable(case: str) -> None:
    """An observer applies no event of a bag with an error."""
    events, usable, _ = CASES[case]
    recorded(events)
    assert observed() is usable


def test_messages_without_a_valid_event_are_errors() -> None:
    """A stamp of zero, too many nanoseconds, an unknown kind and foreign bytes are errors."""
    unknown = event_message(GOOD[0])
    unknown.switches[0].kind = 7
    with BagWriter(Path("bag")) as writer:
        writer.write("/plant/model", S, MAKE.model(model()))
        writer.write("/impacts", 2 * S, event_message(GOOD[0], sec=0))
        too_many = event_message(GOOD[0], nanosec=4_000_000_000)
        writer.write("/impacts", 3 * S, too_many)
        writer.write("/impacts", 4 * S, unknown)
        writer.write_raw("/impacts", 5 * S, b"\x00\x01\x00\x00\x01")
        writer.write("/impacts", 6 * S, event_message(GOOD[0], sec=0))
    assert lines(usable=False)[:5] == [
        (
            "error /impacts: has none but invalid messages (5); expected at least one impact;"
            " was the sender running, and was it subscribed to reliably, transient local?"
        ),
        (
            "error /impacts: 2 messages cannot be used, the first is message 0:"
            " ImpactEvent.header.stamp is 0.000000000 s; expected more than 0, at most"
            " 2147483647.999999999 s;"
            " mend the sender and record again"
        ),
        (
            "error /impacts: 1 message cannot be used, the first is message 1:"
            " ImpactEvent.header.stamp.nanosec is 4000000000; expected less than 1000000000;"
            " mend the sender and record again"
        ),
        (
            "error /impacts: 1 message cannot be used, the first is message 2:"
            " ImpactEvent.switches[0].kind is 7; expected 0 (IMPACT), 1 (CLOSE), 2 (OPEN);"
            " mend the sender and record again"
        ),
        (
            "error /impacts: 1 message cannot be used, the first is message 3: bytes that are no"
            " impact_observer_msgs/msg/ImpactEvent;"
            " mend the sender and record again"
        ),
    ]


def test_stamps_of_another_clock_are_a_warning() -> None:
    """Stamps of simulated time in a bag of wall time are a warning."""
    write(delay=2_000_000 * S)
    assert lines(usable=True) == [
        (
            "warning /impacts: stamps are 555.6 h before the log times; expected both of one"
            " clock; estimates follow the stamps; to play it, record again with use_sim_time"
            " where time is simulated"
        )
    ]
