# SPDX-License-Identifier: Apache-2.0
"""What is received of a running system, in constant memory; no ROS is needed."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plotting_tools import EPOCH, diagnostics, everything

from impact_observer.dynamics.lyapunov import distance
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io import BagReader, JointState
from impact_observer.io.messages import bag_messages
from impact_observer.io.typestores import typestore
from impact_observer.model import read_model
from impact_observer.ros.watch.buffers import Arrivals, HistoryBuffer, RecentMessages
from impact_observer.ros.watch.screen import _sensors
from impact_observer.ros.watch.snapshot import SensorLine, Snapshot
from impact_observer.ros.watch.topic_listener import TopicListener
from impact_observer.stamps import NS_PER_S

LAWS = {"observer": "geometric", "observer_minimum_variance": "minimum-variance"}
SECOND = NS_PER_S
MAKE = bag_messages()


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two observers of one plant, 6 s."""
    return everything(tmp_path_factory.mktemp("listener") / "bag", LAWS, duration=6.0)


def serialized(message: object, kind: str) -> bytes:
    """A message as it travels."""
    return bytes(typestore().serialize_cdr(message, kind))


def clock(stamp: int) -> bytes:
    """A message of ``/clock``."""
    return serialized(MAKE.clock(stamp), "rosgraph_msgs/msg/Clock")


def state(stamp: int, names: tuple[str, ...] = ("x1", "x2"), q: float = 0.0) -> bytes:
    """A ``JointState``."""
    n = len(names)
    found = JointState(stamp, names, np.full(n, q), np.zeros(n))
    return serialized(MAKE.joint_state(found), "sensor_msgs/msg/JointState")


def received(bag: Path, listener: TopicListener, without: Collection[str] = ()) -> Snapshot:
    """A snapshot of all messages in a bag, received in steps of 0.1 s of its time."""
    shown = 0.0
    with BagReader(bag) as reader:
        for topic, stamp, data in reader.raw():
            now = (stamp - EPOCH) / SECOND
            if topic not in without and listener.wants(topic, reader.topics[topic].type):
                listener.receive(topic, data, now, stamp)
            if now > shown + 0.1:
                shown = now
                listener.snapshot(now, stamp)
        return listener.snapshot(shown, reader.end)


@pytest.fixture(scope="module")
def seen(bag: Path) -> Snapshot:
    """What is shown when all of the bag was received."""
    return received(bag, TopicListener())


@pytest.mark.slow
def test_estimates_are_shown_against_the_truth_of_their_stamp(bag: Path, seen: Snapshot) -> None:
    """Both as they are in the bag, at its end."""
    assert [each.name for each in seen.observers] == ["/observer", "/observer_minimum_variance"]
    with BagReader(bag) as reader:
        truth = reader.joint_states("/plant/joint_states")
        for each in seen.observers:
            states = reader.observer_states(f"{each.name}/state")
            assert each.stamp == states.stamps[-1]
            assert [line.estimate for line in each.lines] == [*states.q[-1], *states.u[-1]]
            assert [line.truth for line in each.lines] == [*truth.q[-1], *truth.u[-1]]
            assert [line.unit for line in each.lines] == ["m", "m", "m/s", "m/s"]
    plain, filters = seen.observers
    assert all(line.deviation is None for line in plain.lines)
    assert all(line.deviation is not None and line.deviation > 0 for line in filters.lines)
    learned = [name for name, _, _ in filters.learned]
    assert learned == ["clock_error", "model error", "bounce error"]
    assert (seen.model, seen.truth, seen.epoch, seen.simulated) == ("two_mass", True, EPOCH, False)


@pytest.mark.slow
def test_v_is_that_of_the_monitor_or_computed_to_the_same_value(bag: Path, seen: Snapshot) -> None:
    """Without a monitor it is computed with the model of the plant, or with a given one."""
    published = seen.observers[0]
    monitors = ["/monitor/error", "/monitor_minimum_variance/error"]
    computed = received(bag, TopicListener(), monitors).observers[0]
    system = read_model("two_mass").system
    model = [*monitors, "/plant/model"]
    named = received(bag, TopicListener(system=system), model).observers[0]
    assert (published.source, computed.source, named.source) == ("monitor", "here", "here")
    q, u = (
        np.array([e.estimate - (e.truth or 0.0) for e in published.lines[k : k + 2]])
        for k in (0, 2)
    )
    assert published.distance.now == pytest.approx(float(distance(system, q, u)), rel=1e-9)
    assert computed.distance.now == named.distance.now == pytest.approx(published.distance.now)
    assert received(bag, TopicListener(), model).observers[0].source == ""


def test_v_and_convergence_have_a_history(bag: Path) -> None:
    """It covers the window and falls; before the first estimate it is empty."""
    seen = received(bag, TopicListener(seconds=12.0)).observers[0]
    for history in (seen.distance, seen.convergence):
        assert (len(history.values), history.seconds) == (240, 12.0)
        there = [value for value in history.values if value is not None]
        assert history.values[0] is None
        assert 110 < len(there) < 130
        assert there[-1] == history.now
        assert there[-1] < 0.5 * there[0]


def test_without_truth_there_are_estimates_only(bag: Path) -> None:
    """V cannot be computed."""
    silent = ["/plant/joint_states", "/monitor/error", "/monitor_minimum_variance/error"]
    seen = received(bag, TopicListener(), silent)
    assert not seen.truth
    assert all(line.truth is None for line in seen.observers[0].lines)
    assert seen.observers[0].distance.now is None


def test_events_and_verdicts_are_counted_and_the_last_are_kept(bag: Path, seen: Snapshot) -> None:
    """RecentMessages first, with what became of them."""
    with BagReader(bag) as reader:
        events = list(reader.events())
        verdicts = list(reader.verdicts("/observer/verdicts"))
    assert (seen.impacts, seen.last_impact) == (len(events), (events[-1].stamp, "stop"))
    plain, filters = seen.observers
    assert plain.counts == (("applied", len(verdicts)),)
    assert [verdict for verdict, _ in plain.verdicts] == verdicts[::-1]
    assert {latency for _, latency in plain.verdicts} == {0.001}
    assert all(verdict.innovation >= 0 for verdict, _ in filters.verdicts)
    assert plain.bound is not None
    assert plain.bound > 0
    assert filters.bound is None


def test_diagnostics_go_to_their_observer() -> None:
    """By the node's name; diagnostics of other nodes are ignored."""
    listener = TopicListener(["observer", "rig/observer"])
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    for name, level in (("/observer", 1), ("/rig/observer", 2), ("/elsewhere", 0)):
        data = serialized(diagnostics(name, "two_mass", level, f"of {name}"), kind)
        listener.receive("/diagnostics", data, 0.0, EPOCH)
    seen = listener.snapshot(0.0, EPOCH)
    assert [(each.name, each.health) for each in seen.observers] == [
        ("/observer", (1, "of /observer")),
        ("/rig/observer", (2, "of /rig/observer")),
    ]


def test_an_estimate_that_is_not_synchronized_is_shown_with_its_reason(bag: Path) -> None:
    """It comes with the diagnostics; a state that is synchronized has none."""
    listener = TopicListener(["observer"])
    received(bag, listener)
    message = diagnostics("/observer", "two_mass")
    (value, *_) = message.status[0].values  # type: ignore[attr-defined]
    value.key, value.value = "not synchronized", "one replica"
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    listener.receive("/diagnostics", serialized(message, kind), 0.0, EPOCH)
    (seen,) = listener.snapshot(0.0, EPOCH).observers
    assert (seen.synchronized, seen.obstacle) == (False, "one replica")


def test_sensors_of_an_observer_are_shown_with_what_is_wrong_with_them() -> None:
    """By the name of their status; its health stays that of the impacts."""
    listener = TopicListener(["observer"])
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    for what, level, message in (("impacts", 0, "fine"), ("sensor encoder", 1, "no sample yet")):
        data = diagnostics("/observer", "two_mass", level, message)
        data.status[0].name = f"/observer: {what}"  # type: ignore[attr-defined]
        listener.receive("/diagnostics", serialized(data, kind), 0.0, EPOCH)
    (seen,) = listener.snapshot(0.0, EPOCH).observers
    assert seen.health == (0, "fine")
    assert seen.sensors == (SensorLine("encoder", 1, "no sample yet"),)
    (panel,) = [*_sensors(seen)]
    assert panel == "sensor  encoder: no sample yet"


def test_topics_of_several_nodes_are_noted_until_one_is_left() -> None:
    """But for the clock and the diagnostics, which all share."""
    listener = TopicListener()
    for topic in ("/observer/state", "/diagnostics", "/clock"):
        listener.note_publishers(topic, 2)
    assert listener.snapshot(0.0, EPOCH).merged == ("/observer/state",)
    listener.note_publishers("/observer/state", 1)
    assert listener.snapshot(0.0, EPOCH).merged == ()


def test_only_wanted_observers_are_received() -> None:
    """With their monitors; the plant always; foreign topics and types never."""
    listener = TopicListener(["observer_a"])
    joint, error = "sensor_msgs/msg/JointState", "impact_observer_msgs/msg/EstimateError"
    wanted = {
        ("/observer_a/joint_states", joint): True,
        ("/observer_b/joint_states", joint): False,
        ("/monitor_a/error", error): True,
        ("/monitor_b/error", error): False,
        ("/plant/joint_states", joint): True,
        ("/plant/joint_states", error): False,
        ("/camera", joint): False,
        ("/viewer/markers", "visualization_msgs/msg/MarkerArray"): False,
    }
    assert {each: listener.wants(*each) for each in wanted} == wanted
    assert TopicListener().wants("/observer_b/joint_states", joint)
    assert [each.name for each in listener.snapshot(0.0, EPOCH).observers] == ["/observer_a"]
    with pytest.raises(UsageError, match="no name of a node"):
        TopicListener(["no name"])


def test_latency_is_by_the_clock_that_stamps_follow() -> None:
    """The system's clock until /clock comes."""
    listener = TopicListener()
    for k in range(30):
        stamp = EPOCH + k * SECOND // 10
        listener.receive("/plant/joint_states", state(stamp), 0.1 * k, stamp + 5_000_000)
    (flow,) = listener.snapshot(2.9, 0).flows
    assert flow.latency == pytest.approx(0.005)
    assert flow.rate == pytest.approx(10.0)
    assert flow.count == 30
    assert flow.silent == pytest.approx(0.0)
    listener.receive("/clock", clock(EPOCH), 3.0, 7)
    seen = listener.snapshot(3.0, 7)
    assert (seen.simulated, seen.clock) == (True, EPOCH)


def test_a_clock_that_jumps_back_restarts() -> None:
    """As of a bag that is played again: nothing of the first pass is left."""
    listener = TopicListener(["observer"])
    for stamp in (EPOCH, EPOCH + 9 * SECOND):
        listener.receive("/clock", clock(stamp), 0.0, 0)
        listener.receive("/plant/joint_states", state(stamp), 0.0, 0)
        listener.receive("/observer/joint_states", state(stamp, q=1.0), 0.0, 0)
    assert listener.snapshot(0.0, 0).observers[0].stamp == EPOCH + 9 * SECOND
    listener.receive("/clock", clock(EPOCH + SECOND), 0.0, 0)
    assert listener.snapshot(0.0, 0).observers[0].lines == ()
    assert not listener.snapshot(0.0, 0).truth


def test_joint_states_alone_are_an_estimate_too() -> None:
    """Of an observer that is not ours: its columns in any order, without a law."""
    listener = TopicListener(system=read_model("two_mass").system)
    listener.receive("/plant/joint_states", state(EPOCH, ("x2", "x1"), q=1.0), 0.0, EPOCH)
    listener.receive("/observer/joint_states", state(EPOCH, q=1.5), 0.0, EPOCH)
    (seen,) = listener.snapshot(0.0, EPOCH).observers
    assert (seen.law, seen.synchronized, seen.source) == ("", None, "here")
    assert [line.truth for line in seen.lines] == [1.0, 1.0, 0.0, 0.0]
    assert seen.distance.now == pytest.approx(0.5 * 0.25 * (20 - 20 + 10))


@pytest.mark.parametrize("names", [("x1",), ("a", "b")])
def test_a_truth_of_other_coordinates_is_none(names: tuple[str, ...]) -> None:
    """The estimate is shown alone."""
    listener = TopicListener(system=read_model("two_mass").system)
    listener.receive("/plant/joint_states", state(EPOCH, names), 0.0, EPOCH)
    listener.receive("/observer/joint_states", state(EPOCH), 0.0, EPOCH)
    (seen,) = listener.snapshot(0.0, EPOCH).observers
    assert [line.truth for line in seen.lines] == [None] * 4
    assert seen.distance.now is None


@pytest.mark.parametrize("topic", ["/impacts", "/plant/joint_states", "/observer/state"])
def test_bytes_that_are_no_message_are_reported_and_ignored(topic: str) -> None:
    """Whatever they are; what comes after is received."""
    listener = TopicListener()
    for data in (b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + bytes([255] * 40)):
        listener.receive(topic, data, 0.0, EPOCH)
    seen = listener.snapshot(0.0, EPOCH)
    assert "/" in seen.trouble
    listener.receive("/observer_x/joint_states", state(EPOCH), 0.0, EPOCH)
    assert listener.snapshot(0.0, EPOCH).observers[-1].lines


def test_a_namespace_keeps_to_itself() -> None:
    """The truth of one rig is not that of another."""
    listener = TopicListener()
    for rig, q in (("/a", 1.0), ("/b", 2.0)):
        listener.receive(f"{rig}/plant/joint_states", state(EPOCH, q=q), 0.0, EPOCH)
        listener.receive(f"{rig}/observer/joint_states", state(EPOCH), 0.0, EPOCH)
    seen = listener.snapshot(0.0, EPOCH).observers
    assert [each.lines[0].truth for each in seen] == [1.0, 2.0]


def test_each_rig_has_its_own_epoch() -> None:
    """So that the times of its events are its own; there is no common one then."""
    listener, kind = TopicListener(), "impact_observer_msgs/msg/ImpactEvent"
    for rig, epoch in (("/a", EPOCH), ("/b", EPOCH + SECOND)):
        event = ImpactEvent(epoch + 5 * SECOND, (Switch("stop", Kind.IMPACT),), epoch=epoch)
        listener.receive(f"{rig}/impacts", serialized(MAKE.event(event), kind), 0.0, EPOCH)
        listener.receive(f"{rig}/observer/joint_states", state(EPOCH), 0.0, EPOCH)
        assert listener.snapshot(0.0, EPOCH).epoch == (EPOCH if rig == "/a" else 0)
    seen = listener.snapshot(0.0, EPOCH).observers
    assert [each.epoch for each in seen] == [EPOCH, EPOCH + SECOND]


def test_a_rate_is_that_of_the_messages_and_not_of_their_bursts() -> None:
    """Of 1 kHz, received 20 times a second, all that wait within a tenth of a millisecond."""
    arrivals = Arrivals()
    for burst in range(200):
        for k in range(50):
            arrivals.add(0.05 * burst + 2e-6 * k, None)
    assert arrivals.rate("t", 10.0).rate == pytest.approx(1000.0, rel=1e-3)


def test_a_snapshot_is_empty_until_a_selected_observer_publishes() -> None:
    """The observer's first message makes it non-empty."""
    listener = TopicListener(["observer"])
    assert listener.snapshot(0.0, EPOCH).is_empty
    listener.receive("/observer/joint_states", state(EPOCH), 0.0, EPOCH)
    assert not listener.snapshot(0.0, EPOCH).is_empty


def test_memory_is_constant() -> None:
    """However long it runs: the newest states, the last bins and arrivals."""
    newest, trace, arrivals = RecentMessages(), HistoryBuffer(1.0), Arrivals()
    for k in range(10_000):
        newest.add(k, b"")
        trace.add(k * SECOND // 100, float(k))
        arrivals.add(0.01 * k, 0.0)
    assert newest.last() == 9999
    assert 8000 in newest
    assert 7999 not in newest
    assert len(trace.history().values) == 240
    assert arrivals.rate("t", 100.0).rate == pytest.approx(100.0)
    held: Any = (newest._data, trace._bins, arrivals._times, arrivals._latencies)
    assert [len(each) for each in held] == [2000, 240, 64, 64]


def test_a_history_holds_a_value_until_the_next() -> None:
    """Bins between two values have the first; a time before those kept empties it."""
    trace = HistoryBuffer(240.0)
    assert trace.history().values == ()
    for second, value in ((1000, 4.0), (1003, 2.0), (1003, 1.0)):
        trace.add(second * SECOND, value)
    history = trace.history()
    assert history.values[-5:] == (None, 4.0, 4.0, 4.0, 1.0)
    assert history.now == 1.0
    trace.add(1500 * SECOND, 0.5)
    assert trace.history().values == (*[1.0] * 239, 0.5)
    trace.add(10 * SECOND, 9.0)
    assert trace.history().values == (*[None] * 239, 9.0)


def test_the_newest_state_that_two_topics_share_is_found() -> None:
    """By stamp, the last that came first; one that is corrected counts as new."""
    ours, theirs = RecentMessages(), RecentMessages()
    for stamp in (1, 2, 3, 4):
        ours.add(stamp, b"o%d" % stamp)
    for stamp in (2, 3, 9):
        theirs.add(stamp, b"t")
    assert ours.last() == 4
    assert ours.last(theirs) == 3
    ours.add(2, b"corrected")
    assert ours.last() == ours.last(theirs) == 2
    assert ours.data(2) == b"corrected"
    assert ours.last(RecentMessages()) is None
