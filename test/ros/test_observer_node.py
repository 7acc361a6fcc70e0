# SPDX-License-Identifier: Apache-2.0
"""The observer node: estimates on topics, verdicts, services, diagnostics."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from impact_observer_msgs.msg import EventVerdict, ImpactEstimate, ImpactEvent, ObserverState
from impact_observer_msgs.srv import SetState
from processes import Spinner, hosted, ros_arguments, spinning
from rclpy.logging import LoggingSeverity
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from impact_observer.cli.main import main
from impact_observer.errors import DynamicsError
from impact_observer.events import ImpactEstimate as Estimated
from impact_observer.events import ImpactEvent as Event
from impact_observer.events import Kind, Remark, Ruling, Switch
from impact_observer.io.interfaces import EVENTS, STATES, Quality
from impact_observer.io.messages import read, read_estimate
from impact_observer.io.reader import BagReader
from impact_observer.model import read_model
from impact_observer.observer import Observer, Options, initial_state, law_named, make_observer
from impact_observer.plant import Plant, simulate
from impact_observer.resources import shared
from impact_observer.ros.observer_node import MOST_DUE, ObserverNode, due_stamps
from impact_observer.ros.topics import qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_environment")]

EPOCH = 5_000_000_000
SYSTEM = read_model("two_mass").system
PARAMETERS = {"model": "two_mass", "use_sim_time": True, "initial_state": "'random:1'"}


def event(stamp: int, sequence: int, contact: str = "stop", **more: int) -> Event:
    """An impact of two_mass."""
    return Event(
        stamp,
        (Switch(contact),),
        sequence,
        epoch=more.get("epoch", EPOCH),
        **{key: value for key, value in more.items() if key != "epoch"},
    )


@dataclass
class Rig:
    """A running observer node, publishers of its inputs, and what was received from it."""

    spinner: Spinner
    node: ObserverNode
    impacts: Publisher
    clock: Publisher
    states: list[ObserverState] = field(default_factory=list)
    verdicts: list[EventVerdict] = field(default_factory=list)
    hits: list[ImpactEstimate] = field(default_factory=list)
    diagnostics: list[DiagnosticStatus] = field(default_factory=list)

    def send(self, what: Event) -> None:
        """Publish an event and wait for its verdict."""
        before = len(self.verdicts)
        self.impacts.publish(ros_messages().event(what))
        self.spinner.until(lambda: len(self.verdicts) > before)

    def tick(self, stamp: int) -> None:
        """Let simulated time be ``stamp``, and the node act on it."""
        self.clock.publish(ros_messages().clock(stamp))
        self.spinner.until(lambda: self.node.get_clock().now().nanoseconds == stamp)
        self.spinner.settle(0.1)

    def values(self) -> dict[str, str]:
        """The values of the diagnostics as they would be now."""
        self.diagnostics.append(self.node.statuses()[0])
        return {each.key: each.value for each in self.diagnostics[-1].values}

    def until_value(self, key: str, value: str) -> None:
        """Spin until the diagnostics have a value."""
        self.spinner.until(lambda: self.values()[key] == value)

    def estimates(self) -> list[Estimate]:
        """The estimates received so far."""
        return [read_estimate(message)[1] for message in self.states]


def make_rig(spinner: Spinner, quality: Quality = EVENTS) -> Rig:
    """An observer node beside a probe that plays the plant's part."""
    node, probe = ObserverNode(), spinner.probe
    spinner.add(node)
    rig = Rig(
        spinner,
        node,
        probe.create_publisher(ImpactEvent, "impacts", qos_profile(quality)),
        probe.create_publisher(Clock, "/clock", qos_profile(STATES)),
    )
    many = qos_profile(Quality(depth=1000))
    probe.create_subscription(ObserverState, "observer/state", rig.states.append, many)
    probe.create_subscription(EventVerdict, "observer/verdicts", rig.verdicts.append, many)
    probe.create_subscription(ImpactEstimate, "observer/impacts", rig.hits.append, many)
    probe.create_subscription(
        DiagnosticArray,
        "/diagnostics",
        lambda array: rig.diagnostics.append(array.status[0]),
        many,
    )
    spinner.until(lambda: rig.clock.get_subscription_count() == 1)
    return rig


@pytest.fixture
def rig(ros_environment: dict[str, str]) -> Iterator[Rig]:
    """A rig that knows the epoch from the start."""
    assert ros_environment
    with rig_with() as made:
        yield made


@contextmanager
def rig_with(**parameters: object) -> Iterator[Rig]:
    """A rig that knows the epoch, with other parameters of the observer."""
    with spinning(ros_arguments({**PARAMETERS, "epoch": EPOCH, **parameters})) as spinner:
        made = make_rig(spinner)
        spinner.until(lambda: made.impacts.get_subscription_count() == 1)
        yield made


def test_a_model_that_does_not_fit_is_said_at_the_start(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The verdict is in the provenance of its file."""
    model = tmp_path / "worn.yaml"
    text = shared("config/two_mass.yaml").read_text("utf-8")
    model.write_text(f"{text}\nprovenance: {{fits: false}}\n", "utf-8")
    with rig_with(model=str(model)):
        assert "worn.yaml does not fit the impacts" in "".join(capfd.readouterr())


def replica(*events: Event) -> Observer:
    """The same observer without ROS."""
    law = law_named("geometric")(SYSTEM)
    observer = Observer(SYSTEM, law, *initial_state("random:1", SYSTEM), epoch=EPOCH)
    for each in events:
        observer.receive(each)
    return observer


def assert_same(estimate: Estimate, wanted: Estimate) -> None:
    """Assert that states are equal bit for bit."""
    assert estimate.stamp == wanted.stamp
    assert estimate.q.tobytes() == wanted.q.tobytes()
    assert estimate.u.tobytes() == wanted.u.tobytes()
    assert estimate.last_sequence == wanted.last_sequence
    assert estimate.last_event == wanted.last_event


def test_stamps_of_estimates_lie_on_the_grid_of_the_epoch(rig: Rig) -> None:
    """Stamps are epoch + k / rate; each state is that of the same observer without ROS."""
    rig.tick(EPOCH + 35_000_000)
    received = rig.estimates()
    assert [each.stamp - EPOCH for each in received] == [0, 10_000_000, 20_000_000, 30_000_000]
    for each in received:
        assert_same(each, replica().estimate(each.stamp))


def test_estimated_parameters_of_the_model_are_published() -> None:
    """Names, values and deviations stand in every state, and in the diagnostics with units."""
    wanted = {
        "law": "minimum-variance",
        "estimate_parameters": "[gap=0.01, restitution]",
        "spurious": 0.0,
    }
    with rig_with(**wanted) as rig:
        rig.tick(EPOCH + 30_000_000)
        rig.send(event(EPOCH + 25_000_000, 1))
        rig.spinner.until(lambda: rig.states[-1].last_sequence == 1)
        first, last = rig.states[0], rig.states[-1]
        values = rig.values()
    assert list(first.parameter_name[:2]) == ["gap.stop", "restitution.stop"]
    np.testing.assert_allclose(first.parameter[:2], [0.5, 0.7])
    np.testing.assert_allclose(first.parameter_deviation[:2], [0.01, 0.1])
    options = Options(
        "minimum-variance",
        "random:1",
        estimate_parameters=("gap=0.01", "restitution"),
        spurious=0.0,
    )
    same = make_observer(SYSTEM, options)
    same.receive(event(EPOCH + 25_000_000, 1))
    learned = same.estimate(EPOCH + 30_000_000).parameters
    assert list(last.parameter) == [value for _, value, _ in learned]
    assert list(last.parameter_deviation) == [deviation for _, _, deviation in learned]
    assert values["gap.stop [m]"].startswith("0.5")
    assert "+-" in values["restitution.stop"]


def test_a_late_event_corrects_the_last_estimate_at_once(rig: Rig) -> None:
    """The estimate that should have contained the event is published again with it."""
    rig.tick(EPOCH + 30_000_000)
    late = event(EPOCH + 25_000_000, 1)
    rig.send(late)
    rig.spinner.until(lambda: rig.states[-1].last_sequence == 1)
    stamps = [each.stamp for each in rig.estimates()]
    assert stamps == sorted(stamps), "stamps never go back"
    assert stamps[-1] == stamps[-2] == EPOCH + 30_000_000
    assert_same(rig.estimates()[-1], replica(late).estimate(EPOCH + 30_000_000))


def test_every_switch_gets_a_verdict_with_its_latency(rig: Rig) -> None:
    """The rulings are applied, duplicate, unknown contact and too late."""
    rig.tick(EPOCH + 50_000_000)
    rig.send(event(EPOCH + 20_000_000, 1))
    rig.send(event(EPOCH + 20_000_000, 1))
    rig.send(event(EPOCH + 21_000_000, 2, "anvil"))
    rig.send(event(EPOCH - 1, 3))
    rulings = [Ruling(verdict.verdict) for verdict in rig.verdicts]
    assert rulings == [Ruling.APPLIED, Ruling.DUPLICATE, Ruling.UNKNOWN_CONTACT, Ruling.TOO_LATE]
    assert rig.verdicts[0].latency == pytest.approx(0.03)
    assert rig.verdicts[2].contact == "anvil"
    assert "stop" in rig.verdicts[2].reason


def test_a_clock_that_jumps_back_resets_the_observer(rig: Rig) -> None:
    """After a bag loop the estimates are those of a new observer."""
    rig.tick(EPOCH + 10_000_000)
    rig.send(event(EPOCH + 5_000_000, 1))
    rig.tick(EPOCH + 20_000_000)
    rig.states.clear()
    rig.tick(EPOCH + 1)
    rig.tick(EPOCH + 12_000_000)
    received = rig.estimates()
    assert [each.stamp - EPOCH for each in received] == [0, 10_000_000]
    for each in received:
        assert_same(each, replica().estimate(each.stamp))


def test_a_new_episode_resets_the_observer_to_its_epoch(rig: Rig) -> None:
    """A reset of the plant moves the epoch."""
    rig.tick(EPOCH + 10_000_000)
    moved = EPOCH + 500_000_000
    again = [event(moved + k * 3_000_000, k, episode=1, epoch=moved) for k in (1, 2)]
    for each in again:
        rig.send(each)
    rig.states.clear()
    rig.tick(moved + 10_000_000)
    last = rig.estimates()[-1]
    assert last.stamp == moved + 10_000_000
    assert_same(last, replica(*again).estimate(last.stamp))


def test_the_observer_follows_a_restarted_plant_and_rejects_its_earlier_events(rig: Rig) -> None:
    """The later epoch counts, though episodes count from 0 again."""
    rig.tick(EPOCH + 10_000_000)
    rig.send(event(EPOCH + 5_000_000, 1, episode=3))
    moved = EPOCH + 100_000_000
    rig.tick(moved + 1_000_000)
    restarted = [event(moved + k * 500_000, k, episode=0, epoch=moved) for k in (1, 2)]
    for each in restarted:
        rig.send(each)
    rig.spinner.until(lambda: len(rig.verdicts) == 3)
    rig.send(event(EPOCH + 6_000_000, 2, episode=3))
    rulings = [(verdict.sequence, Ruling(verdict.verdict)) for verdict in rig.verdicts]
    yes, no = Ruling.APPLIED, Ruling.REJECTED
    assert rulings == [(1, yes), (1, yes), (2, yes), (2, no)]
    rig.tick(moved + 10_000_000)
    last = rig.estimates()[-1]
    assert_same(last, replica(*restarted).estimate(last.stamp))


@pytest.mark.parametrize("law", ["geometric", "minimum-variance"])
def test_live_estimates_of_impacts_are_those_of_observe(tmp_path: Path, law: str) -> None:
    """The last on each event equals that of the bag in every bit; so does an inserted one."""
    bag, output = shared("bags/missed_and_spurious"), tmp_path / "out"
    given = ["--law", law, "--initial-state", "random:1", "--clock-error", "0.001"]
    assert main(["observe", str(bag), *given, "-o", str(output)]) == 0
    with BagReader(output) as reader:
        wanted = [*reader.impact_estimates("/observer/impacts")]
        events = sorted(reader.events(), key=lambda each: each.stamp)
    with rig_with(law=law, clock_error=0.001, epoch=events[0].epoch) as rig:
        for each in events:
            rig.tick(each.stamp + 1_000_000)
            rig.send(each)
        rig.spinner.settle()
    live = [read(Estimated, each) for each in rig.hits]
    final = {(each.sequence, each.contact): each for each in live if each.sequence}
    inserted = {each for each in live if each.ruling is Ruling.INSERTED}
    withdrawn = [each for each in live if each.ruling is Ruling.REJECTED and not each.sequence]
    assert {each for each in wanted if each.sequence} == {*final.values()}
    missed = {each for each in wanted if not each.sequence}
    assert missed <= inserted
    assert len(inserted - missed) == len(withdrawn)
    if law == "geometric":
        assert {each[8:] for each in live} == {(-1.0,) * 4}
    else:
        assert len({each.ruling for each in live}) == 3


def test_an_estimate_of_an_impact_that_fails_leaves_the_verdicts(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next impacts have estimates again."""
    rig.tick(EPOCH + 50_000_000)
    with monkeypatch.context() as patch:
        patch.setattr(rig.node.observer, "impact", lambda _: 1 / 0)
        rig.send(event(EPOCH + 20_000_000, 1))
    rig.send(event(EPOCH + 30_000_000, 2))
    rig.spinner.until(lambda: rig.hits)
    assert [each.sequence for each in rig.verdicts] == [1, 2]
    assert [each.sequence for each in rig.hits] == [2]


def test_an_event_ahead_of_the_clock_is_rejected_until_the_clock_is_near() -> None:
    """The estimates are as if the event had come in time, also for one before any clock.

    Applied at once such an event would make every true event too late, or of an earlier episode.
    """
    before, near = event(EPOCH + 1_000_000, 1), event(EPOCH + 95_000_000, 2)
    ahead, hour = event(EPOCH + 100_000_001, 3), 3_600_000_000_000
    with rig_with(future=0.05) as rig:
        last = rig.verdicts

        def ruling() -> Ruling:
            return Ruling(last[-1].verdict)

        rig.send(before)
        assert last[-1].reason.startswith("no /clock has come")
        rig.tick(EPOCH + 50_000_000)
        rig.spinner.until(lambda: ruling() is Ruling.APPLIED)
        for wrong, reason in (
            (event(EPOCH + hour, 4), "stamped 3599.950 s after the clock"),
            (event(EPOCH + 10_000_000, 5, epoch=EPOCH + hour), "its epoch is 3599.950 s after"),
            (ahead, "stamped 0.050 s after the clock; future allows 0.05 s, and it waits"),
        ):
            rig.send(wrong)
            assert ruling() is Ruling.REJECTED
            assert reason in last[-1].reason
        rig.send(near)
        assert ruling() is Ruling.APPLIED
        assert rig.values()["from the future"] == "4"
        rig.tick(EPOCH + 60_000_000)
        rig.spinner.until(lambda: last[-1].reason == "revised: as reported")
        assert ruling() is Ruling.APPLIED
        rig.tick(EPOCH + 110_000_000)
        wanted = replica(before, near, ahead).estimate(EPOCH + 110_000_000)
        assert_same(rig.estimates()[-1], wanted)


def test_some_parameters_may_be_set_while_the_node_runs(rig: Rig) -> None:
    """Values are checked as at the start; stamps of estimates ascend on the new grid."""
    rig.tick(EPOCH + 30_000_000)
    rig.send(event(EPOCH + 5_000_000, 1))

    def answer(name: str, value: object) -> str:
        (result,) = rig.node.set_parameters([Parameter(name, value=value)])
        return "" if result.successful else result.reason

    assert "-1.0" in answer("rate", -1.0)
    assert "nan" in answer("rate", float("nan"))
    assert "rate" in answer("rate", "fast")
    assert "lag" in answer("lag", 99.0)
    assert "read-only" in answer("history", 5.0)
    assert [answer(*each) for each in (("rate", 50), ("lag", 0.01))] == [""] * 2
    before = len(rig.states)
    rig.tick(EPOCH + 95_000_000)
    rig.spinner.until(lambda: len(rig.states) >= before + 3)
    later = [each.stamp - EPOCH for each in rig.estimates()[before:]]
    assert later == [40_000_000, 60_000_000, 80_000_000]


def test_what_is_no_event_is_counted_and_named(rig: Rig) -> None:
    """The status is an ERROR while no event was applied; the next event is."""
    rig.tick(EPOCH + 50_000_000)
    whole = serialize_message(ros_messages().event(event(EPOCH + 10_000_000, 1)))
    for data in (whole[:4], whole[:-20] + b"\xff" * 20):  # a header, and no switches
        rig.impacts.publish(data)
    changes: list[tuple[Callable[[ImpactEvent], None], str]] = [
        (lambda message: setattr(message.header.stamp, "nanosec", 0), "header.stamp is"),
        (lambda message: setattr(message.header.stamp, "nanosec", 10**9), "is 1000000000"),
        (lambda message: setattr(message.epoch, "sec", -1), "epoch is"),
        (lambda message: setattr(message.switches[0], "kind", 7), "kind is 7"),
        (lambda message: setattr(message.switches[0], "contact", "s" * 257), "at most 256"),
    ]
    for k, (change, what) in enumerate(changes, start=1):
        message = ros_messages().event(event(NS_PER_S // 2, 1))
        change(message)
        rig.impacts.publish(message)
        rig.until_value("invalid messages", str(k))
        assert what in rig.diagnostics[-1].message
        assert rig.diagnostics[-1].level == DiagnosticStatus.ERROR
    rig.send(event(EPOCH + 20_000_000, 2))
    assert [each.sequence for each in rig.verdicts] == [2]
    assert Ruling(rig.verdicts[-1].verdict) is Ruling.APPLIED
    rig.values()
    assert rig.diagnostics[-1].level == DiagnosticStatus.WARN


def test_an_estimate_that_is_not_finite_is_not_published(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The log says so, and the node goes on."""
    rig.node.get_logger().set_level(LoggingSeverity.INFO)  # another test may have changed it
    estimate = rig.node.observer.estimate
    with monkeypatch.context() as patch:
        wrong = np.array([0.0, np.nan])
        patch.setattr(rig.node.observer, "estimate", lambda t: replace(estimate(t), q=wrong))
        rig.tick(EPOCH + 15_000_000)
    assert not rig.states
    error = "/observer/state: not published: ObserverState.position[1] is nan"
    assert error in "".join(capfd.readouterr())
    rig.tick(EPOCH + 30_000_000)
    assert [each.stamp - EPOCH for each in rig.estimates()] == [20_000_000, 30_000_000]


def test_a_node_without_a_motion_says_so_and_goes_on(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The motion since an epoch of decades ago takes too many steps."""

    def fail(_: int) -> Estimate:
        raise DynamicsError("the motion takes too many steps")

    with monkeypatch.context() as patch:
        patch.setattr(rig.node.observer, "estimate", fail)
        rig.tick(EPOCH + 15_000_000)
        said = "no estimate: the motion takes too many steps"
        rig.spinner.until(lambda: rig.diagnostics and rig.diagnostics[-1].message == said)
        assert rig.diagnostics[-1].level == DiagnosticStatus.ERROR
        assert not rig.states
    rig.tick(EPOCH + 30_000_000)
    assert [each.stamp - EPOCH for each in rig.estimates()] == [20_000_000, 30_000_000]
    rig.spinner.until(lambda: rig.diagnostics[-1].message != said)


def test_services_do_not_wait_for_a_queue_of_events(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Slow events are applied for some milliseconds at a time, not until none is left."""
    rig.tick(EPOCH + 950_000_000)
    receive = rig.node.observer.receive

    def slow(what: Event) -> object:
        time.sleep(0.05)
        return receive(what)

    monkeypatch.setattr(rig.node.observer, "receive", slow)
    client = rig.spinner.probe.create_client(Trigger, "/observer/reset")
    rig.spinner.until(client.service_is_ready)
    for k in range(40):
        rig.impacts.publish(ros_messages().event(event(EPOCH + (k + 1) * 20_000_000, k + 1)))
    answer = client.call_async(Trigger.Request())
    rig.spinner.until(answer.done)
    assert len(rig.verdicts) < 20
    rig.spinner.until(lambda: len(rig.verdicts) >= 40)


def test_each_estimate_before_the_epoch_is_published_once(rig: Rig) -> None:
    """Estimates may begin before the epoch, by as much as a clock may be ahead."""
    rig.tick(EPOCH - 500_000_000)
    rig.send(event(EPOCH - 600_000_000, 3))
    for k in range(1, 4):
        rig.tick(EPOCH - 500_000_000 + k * 100_000_000)
    stamps = [each.stamp for each in rig.estimates()]
    assert stamps[0] == EPOCH - 600_000_000
    assert stamps == sorted({*stamps})
    assert stamps[-1] == EPOCH - 200_000_000


def test_estimates_behind_a_lag_contain_the_events_of_their_instant() -> None:
    """A later event corrects the last estimate, is named in the verdict and counted."""
    with rig_with(lag=0.03) as rig:
        rig.tick(EPOCH + 29_000_000)
        assert not rig.states
        rig.tick(EPOCH + 50_000_000)
        intime, late = event(EPOCH + 25_000_000, 1), event(EPOCH + 35_000_000, 2)
        rig.send(intime)
        assert rig.verdicts[-1].reason == ""
        rig.tick(EPOCH + 70_000_000)
        received = rig.estimates()
        stamps = [0, 10_000_000, 20_000_000, 30_000_000, 40_000_000]
        assert [each.stamp - EPOCH for each in received] == stamps, "each once"
        for each in received:
            assert_same(each, replica(intime).estimate(each.stamp))
        rig.send(late)
        rig.spinner.until(lambda: len(rig.states) > len(received))
        last = rig.estimates()[-1]
        assert_same(last, replica(intime, late).estimate(EPOCH + 40_000_000))
        rig.until_value("estimates corrected", "1")


def test_events_received_before_a_state_was_set_behind_a_lag_act_on_it() -> None:
    """The state holds from the last estimate on; the event has a later stamp."""
    with rig_with(lag=0.03) as rig:
        rig.tick(EPOCH + 50_000_000)
        later = event(EPOCH + 45_000_000, 1)
        rig.send(later)
        probe, spinner = rig.spinner.probe, rig.spinner
        client = probe.create_client(SetState, "observer/set_state")
        spinner.until(client.service_is_ready)
        future = client.call_async(SetState.Request(position=[0.1, 0.2], velocity=[0.3, 0.4]))
        spinner.until(future.done)
        assert future.result().message == f"holds at {EPOCH + 20_000_000} ns"
        rig.tick(EPOCH + 90_000_000)
        wanted = replica()
        wanted.set_state(EPOCH + 20_000_000, [0.1, 0.2], [0.3, 0.4])
        wanted.receive(later)
        received = rig.estimates()
        assert [each.stamp - EPOCH for each in received] == [k * 10_000_000 for k in range(7)]
        for each in received[3:]:
            assert_same(each, wanted.estimate(each.stamp))
        assert received[-1].last_sequence == 1


def test_every_fault_of_the_events_is_reported_and_counted(rig: Rig) -> None:
    """A fault is the reason of a verdict, and is counted in the diagnostics."""
    rig.tick(EPOCH + 90_000_000)
    closing = Event(EPOCH + 10_000_000, (Switch("stop", Kind.CLOSE),), 5, epoch=EPOCH)
    for each in (
        event(EPOCH + 10_000_000, 1),
        event(EPOCH + 30_000_000, 4),
        event(EPOCH + 20_000_000, 3),
        closing,
        closing,
    ):
        rig.send(each)
    late = ["", "", "late: 1 event run again", "late: 2 events run again"]
    assert [verdict.reason for verdict in rig.verdicts[:4]] == late
    assert Ruling(rig.verdicts[4].verdict) is Ruling.DUPLICATE
    assert rig.values()["missing sequence numbers"] == "1"
    rig.tick(EPOCH + 1)
    rig.tick(EPOCH + 50_000_000)
    rig.send(event(EPOCH + 10_000_000, 1))
    assert rig.verdicts[-1].reason == "the clock jumped back: the observer is reset"
    values = rig.values()
    assert {remark.value for remark in Remark} <= set(values)
    counted = {name: int(values[name]) for name in ("late events", "duplicates")}
    assert counted == {"late events": 2, "duplicates": 1}
    assert values["clock jumps back"] == "1"


def test_services_set_and_reset_the_state(rig: Rig) -> None:
    """set_state holds from the last estimate on; reset brings the initial state back."""
    probe, spinner = rig.spinner.probe, rig.spinner
    rig.tick(EPOCH + 20_000_000)
    client = probe.create_client(SetState, "observer/set_state")
    spinner.until(client.service_is_ready)
    wanted = [0.1, 0.2, 0.3, 0.4]
    future = client.call_async(SetState.Request(position=wanted[:2], velocity=wanted[2:]))
    spinner.until(future.done)
    assert future.result().success, future.result().message
    estimate = rig.node.observer.estimate(EPOCH + 20_000_000)
    np.testing.assert_allclose(np.r_[estimate.q, estimate.u], wanted, rtol=1e-14)

    future = client.call_async(SetState.Request(position=[1.0], velocity=[0.0, 0.0]))
    spinner.until(future.done)
    assert not future.result().success
    assert "1 values found; expected 2" in future.result().message

    covariance = np.diag([1e-6, 1e-6, 1e-4, 1e-4]).ravel()
    request = SetState.Request(position=wanted[:2], velocity=wanted[2:], covariance=covariance)
    future = client.call_async(request)
    spinner.until(future.done)
    assert future.result().success, future.result().message
    narrow = rig.node.observer.estimate(EPOCH + 20_000_000).convergence
    assert 0 < narrow < 1e-2 * estimate.convergence

    request = SetState.Request(position=wanted[:2], velocity=wanted[2:], covariance=[1.0] * 4)
    future = client.call_async(request)
    spinner.until(future.done)
    assert not future.result().success
    assert "covariance" in future.result().message

    reset = probe.create_client(Trigger, "observer/reset")
    spinner.until(reset.service_is_ready)
    future = reset.call_async(Trigger.Request())
    spinner.until(future.done)
    assert future.result().success
    estimate = rig.node.observer.estimate(EPOCH + 20_000_000)
    np.testing.assert_allclose(
        np.r_[estimate.q, estimate.u],
        np.concatenate(initial_state("random:1", SYSTEM)),
        rtol=1e-14,
    )


def test_past_events_are_received_where_all_publishers_keep_them() -> None:
    """A volatile publisher that comes later is received too; one that is best effort is told."""
    with spinning(ros_arguments({**PARAMETERS, "epoch": EPOCH})) as spinner:
        first = spinner.probe.create_publisher(ImpactEvent, "impacts", qos_profile(EVENTS))
        first.publish(ros_messages().event(event(EPOCH + 10_000_000, 1)))
        rig = make_rig(spinner)
        rig.tick(EPOCH + 50_000_000)
        spinner.until(lambda: len(rig.verdicts) == 1)
        volatile, lossy = (
            spinner.probe.create_publisher(ImpactEvent, "impacts", qos_profile(each))
            for each in (Quality(depth=10), Quality(reliable=False, depth=10))
        )
        spinner.until(volatile.get_subscription_count)
        volatile.publish(ros_messages().event(event(EPOCH + 20_000_000, 2)))
        spinner.until(lambda: len(rig.verdicts) == 2)
        spinner.until(lambda: any("best effort" in each.message for each in rig.diagnostics))
        assert rig.diagnostics[-1].level == DiagnosticStatus.ERROR
        spinner.probe.destroy_publisher(lossy)
        spinner.until(lambda: rig.diagnostics[-1].level == DiagnosticStatus.OK)


def test_the_epoch_is_that_of_the_first_event() -> None:
    """Without an epoch no estimate is published; then the replica starts at the epoch."""
    with spinning(ros_arguments(PARAMETERS)) as spinner:
        rig = make_rig(spinner)
        spinner.until(lambda: rig.impacts.get_subscription_count() == 1)
        rig.tick(EPOCH + 40_000_000)
        assert not rig.states
        first = event(EPOCH + 45_000_000, 1)
        rig.send(first)
        rig.tick(EPOCH + 60_000_000)
        assert_same(rig.estimates()[-1], replica(first).estimate(EPOCH + 60_000_000))


def test_persistent_contact_is_in_the_estimates_until_it_opens(rig: Rig) -> None:
    """CLOSE and OPEN travel as events; the estimates are the replica's to the last bit."""
    closing = Event(EPOCH + 15_000_000, (Switch("stop", Kind.CLOSE),), 1, epoch=EPOCH)
    opening = Event(EPOCH + 45_000_000, (Switch("stop", Kind.OPEN),), 2, epoch=EPOCH)
    rig.tick(EPOCH + 20_000_000)
    rig.send(closing)
    rig.tick(EPOCH + 30_000_000)
    assert rig.states[-1].closed == ["stop"]
    rig.tick(EPOCH + 50_000_000)
    rig.send(opening)
    rig.tick(EPOCH + 60_000_000)
    assert rig.states[-1].closed == []
    assert_same(rig.estimates()[-1], replica(closing, opening).estimate(EPOCH + 60_000_000))


def test_an_observer_subscribes_to_impacts_and_pulses_only() -> None:
    """The ROS graph shows impacts and pulses only: no ground truth goes into the observer."""
    with hosted(ObserverNode, PARAMETERS) as (_, spinner):
        find = spinner.probe.get_subscriber_names_and_types_by_node
        spinner.until(lambda: "/impacts" in dict(find("observer", "/")))
        spinner.settle(0.5)
        received = {name for name, _ in find("observer", "/")}
    assert received <= {"/impacts", "/phase_reference", "/clock", "/parameter_events"}


def test_events_that_contradict_what_was_declared_are_a_warning() -> None:
    """The initial state is wrong and has a declared deviation of 0."""
    with rig_with(initial_deviation="'0'") as rig:
        rig.tick(EPOCH + 900_000_000)
        rig.send(event(EPOCH + 500_000_000, 1))
        rig.tick(EPOCH + 1_000_000_000)
        values = rig.values()
    assert "contradict" in rig.diagnostics[-1].message
    assert rig.diagnostics[-1].level == DiagnosticStatus.WARN
    assert values["certified bound of V [J]"] == "refuted"
    assert values["synchronized"] == "False"


def test_model_that_does_not_explain_the_impacts_is_a_warning() -> None:
    """The plant is 5 % stiffer than its model: diagnostics warn, and nothing is synchronized."""
    stiffer = replace(SYSTEM, K=1.05 * SYSTEM.K)
    start, end = [np.array([0.4, -0.3]), np.array([0.5, 0.2])], EPOCH + 30_000_000_000
    plant = simulate(Plant(stiffer, *start, epoch=EPOCH), np.array([end]))
    with rig_with(law="minimum-variance", rate=1.0) as rig:
        rig.tick(end)
        for each in plant.events:
            rig.send(each)
        rig.tick(end + 2_000_000_000)
        rig.spinner.until(lambda: rig.values() and "does not exp" in rig.diagnostics[-1].message)
        values = rig.values()
    assert rig.diagnostics[-1].level == DiagnosticStatus.WARN
    assert values["synchronized"] == "False"
    assert int(values[Remark.MISFIT.value]) > 0
    assert "relative model error" in values


def test_events_that_wait_are_a_warning_until_the_node_has_caught_up(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The warning comes long before events are refused."""
    with monkeypatch.context() as patch:
        patch.setattr(rig.node.intake, "backlog", lambda: (7, 24.1))
        behind = "7 events wait, the oldest for 24.1 s: the observer cannot keep up"
        assert rig.values()["waiting"] == "7"
        assert rig.diagnostics[-1].message == behind
        assert rig.diagnostics[-1].level == DiagnosticStatus.WARN
    assert rig.values()["waiting"] == "0"
    assert rig.diagnostics[-1].message != behind


def test_slow_estimates_leave_half_of_the_time_to_what_waits(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Estimates of 0.05 s at 100 Hz would take all of it."""
    estimate, spent = rig.node.observer.estimate, [0.0]

    def slow(stamp: int) -> Estimate:
        begin, end = time.monotonic(), time.thread_time() + 0.05
        found = estimate(stamp)
        while time.thread_time() < end:
            pass
        spent[0] += time.monotonic() - begin
        return found

    monkeypatch.setattr(rig.node.observer, "estimate", slow)
    begin = time.monotonic()
    while (taken := time.monotonic() - begin) < 1.0:
        rig.clock.publish(ros_messages().clock(EPOCH + round(taken * 1e9)))
        rig.spinner.executor.spin_once(timeout_sec=0.01)
    assert 0.1 < spent[0] / taken < 0.7


def test_a_node_that_falls_behind_skips_estimates_but_not_the_first(rig: Rig) -> None:
    """Estimates older than the backlog are skipped and counted."""
    rig.tick(EPOCH + 3_000_000_000)
    rig.spinner.until(lambda: len(rig.states) >= 21)
    stamps = [each.stamp for each in rig.estimates()]
    assert stamps[0] == EPOCH
    assert stamps[1] == EPOCH + 2_810_000_000
    assert stamps[-1] == EPOCH + 3_000_000_000
    assert rig.values()["estimates passed over"] == "280"


@pytest.mark.parametrize("rate", [0.7, 100.0, 1000.0, 1e5 / 3])
def test_every_stamp_of_the_grid_is_due_once(rate: float) -> None:
    """The stamps do not depend on the instants of the calls."""
    stamps, now = list[int](), EPOCH
    while len(stamps) < 500:
        now += int(0.9 * NS_PER_S / rate)
        due, skipped = due_stamps(rate, EPOCH, EPOCH, stamps[-1] if stamps else None, now)
        assert skipped == 0
        assert all(stamp <= now for stamp in due)
        stamps += due
    assert stamps == [EPOCH + round(k * NS_PER_S / rate) for k in range(len(stamps))]


def test_old_estimates_are_skipped_and_counted_but_never_the_first() -> None:
    """Old estimates occur after a jump of the clock."""
    due, skipped = due_stamps(100.0, EPOCH, EPOCH, None, EPOCH + 3 * NS_PER_S)
    assert due[0] == EPOCH
    assert due[1] == EPOCH + 2_810_000_000
    assert due[-1] == EPOCH + 3 * NS_PER_S
    assert (len(due), skipped) == (MOST_DUE + 1, 280)
    assert due_stamps(100.0, EPOCH, EPOCH, due[-1], EPOCH + 3_005_000_000) == ([], 0)
    due, skipped = due_stamps(100.0, EPOCH, EPOCH, due[-1], EPOCH + 4 * NS_PER_S)
    assert (len(due), skipped) == (MOST_DUE, 80)


def test_estimates_may_begin_before_the_epoch_and_another_rate_goes_on_ascending() -> None:
    """Estimates begin at the first stamp of the grid that is not before the start."""
    start = EPOCH - 250_000_000
    due, _ = due_stamps(10.0, EPOCH, start, None, EPOCH)
    assert [stamp - EPOCH for stamp in due] == [-200_000_000, -100_000_000, 0]
    due, _ = due_stamps(4.0, EPOCH, start, due[-1], EPOCH + 600_000_000)
    assert [stamp - EPOCH for stamp in due] == [250_000_000, 500_000_000]
    assert due_stamps(4.0, EPOCH, EPOCH, None, EPOCH) == ([EPOCH], 0)
