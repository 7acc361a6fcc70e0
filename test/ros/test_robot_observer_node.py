# SPDX-License-Identifier: Apache-2.0
"""The observer node of a robot: velocities through hits from encoders and efforts on topics."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")
pytest.importorskip("pinocchio", reason="not installed: extra robots")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from impact_observer_msgs.msg import EventVerdict, ObserverState
from impact_observer_msgs.srv import SetState
from processes import Spinner, refusal, ros_arguments, spinning
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from systems import EPOCH

from impact_observer.errors import UsageError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface, Quality
from impact_observer.io.messages import read_estimate
from impact_observer.model import read_model
from impact_observer.model.measurement import read_measurements
from impact_observer.observer import Options, make_observer
from impact_observer.observer.samples import SensorSample
from impact_observer.resources import shared
from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.topics import qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_environment")]

MANY = qos_profile(Quality(depth=2000))
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ENCODERS = Interface("/joint_states", interfaces.JOINT_STATE, interfaces.SENSORS)
OBSERVED = {
    "model": "hammer_arm",
    "law": "minimum-variance",
    "measurements": "hammer_arm",
    "clock_error": 0.0002,
    "use_sim_time": True,
}


@dataclass
class Rig:
    """A running observer node of a robot, publishers of its inputs, and what it publishes."""

    spinner: Spinner
    node: ObserverNode
    clock: Publisher
    encoders: Publisher
    states: list[ObserverState] = field(default_factory=list)
    verdicts: list[EventVerdict] = field(default_factory=list)
    diagnostics: list[DiagnosticStatus] = field(default_factory=list)

    def go_to(self, stamp: int, *position: float) -> None:
        """Let encoders measure ``position`` at ``stamp``, ns; then set the clock."""
        if position:
            self.measure(stamp, *position)
            self.spinner.settle()
        self.clock.publish(ros_messages().clock(stamp))
        self.spinner.until(lambda: self.node.stamp_now() == stamp)
        self.spinner.settle()

    def measure(self, stamp: int, *position: float) -> None:
        """Publish what encoders measure at ``stamp``, ns, without torque."""
        message = JointState(name=["shoulder", "elbow"], position=position, effort=[0.0, 0.0])
        message.header.stamp = ros_messages().time(stamp)
        self.encoders.publish(message)

    @property
    def last(self) -> Estimate:
        """The estimate published last."""
        return read_estimate(self.states[-1])[1]

    def status(self) -> str:
        """The message of the next diagnostics of the events."""
        self.diagnostics.clear()
        self.spinner.until(lambda: any(each.name.endswith("impacts") for each in self.diagnostics))
        messages = (e.message for e in self.diagnostics if e.name.endswith("impacts"))
        return str(next(messages))


@pytest.fixture
def rig(
    ros_environment: dict[str, str], tmp_path: Path, request: pytest.FixtureRequest
) -> Iterator[Rig]:
    """A rig whose URDF comes from a topic; a test may give further parameters of its node."""
    assert ros_environment
    sample = read_model("hammer_arm")
    assert sample.robot is not None
    text = shared("config/hammer_arm.yaml").read_text(encoding="utf-8")
    path = tmp_path / "hammer_arm.yaml"
    path.write_text(text.replace("urdf: hammer_arm.urdf", "urdf: {topic: robot_description}"))
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    given = {**OBSERVED, "model": path, "rate": 10.0, **getattr(request, "param", {})}
    with spinning(ros_arguments(given)) as spinner:
        probe = spinner.probe
        urdf = probe.create_publisher(String, "robot_description", latched)
        urdf.publish(String(data=sample.robot.known_urdf.text))
        encoders = probe.create_publisher(
            JointState, ENCODERS.topic, qos_profile(ENCODERS.quality)
        )
        clock = probe.create_publisher(Clock, "/clock", MANY)
        node = ObserverNode()
        spinner.add(node)
        made = Rig(spinner, node, clock, encoders)
        probe.create_subscription(ObserverState, "observer/state", made.states.append, MANY)
        probe.create_subscription(EventVerdict, "observer/verdicts", made.verdicts.append, MANY)
        probe.create_subscription(
            DiagnosticArray, "/diagnostics", lambda a: made.diagnostics.extend(a.status), MANY
        )
        spinner.until(lambda: encoders.get_subscription_count() == 2)
        spinner.until(lambda: clock.get_subscription_count() == 1)
        yield made


def test_a_robot_starts_and_is_reset_where_its_encoders_are(rig: Rig) -> None:
    """The state is at rest at the first samples, whatever the epoch; diagnostics wait for them."""
    rig.go_to(EPOCH)
    assert rig.status() == "no sample of an encoder of shoulder, elbow has come yet"
    assert not rig.states
    rig.go_to(EPOCH + NS_PER_S, 0.25, 0.5)
    assert rig.last.stamp == EPOCH + NS_PER_S
    np.testing.assert_allclose([*rig.last.q, *rig.last.u], [0.25, 0.5, 0.0, 0.0], atol=1e-9)
    assert rig.status() == "0 impacts applied"
    answer = rig.spinner.call(Trigger, "observer/reset")
    assert (answer.success, answer.message) == (True, "holds at the next samples of the encoders")
    rig.go_to(EPOCH + 2 * NS_PER_S, 0.75, 1.0)
    np.testing.assert_allclose([*rig.last.q, *rig.last.u], [0.75, 1.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("rig", [{"law": "measured-position"}], indirect=True)
def test_a_node_estimates_a_robot_without_a_covariance(rig: Rig) -> None:
    """The estimate is where the encoders are, and its velocities follow them."""
    rig.go_to(EPOCH + NS_PER_S, 0.25, 0.5)
    rig.go_to(EPOCH + NS_PER_S + 10**8, 0.3, 0.45)
    assert rig.last.law == "measured-position"
    np.testing.assert_allclose(rig.last.q, [0.3, 0.45], atol=1e-9)
    assert np.all(np.abs(rig.last.u) > 0.05)
    assert rig.last.covariance.size == 0
    assert rig.status() == "0 impacts applied"


def test_a_state_of_a_robot_can_be_set(rig: Rig) -> None:
    """Before the encoders have said where it is, and while it is estimated."""
    rig.go_to(EPOCH)
    given = [0.1, 0.2], [0.3, -0.4]
    answer = rig.spinner.call(SetState, "observer/set_state", position=given[0], velocity=given[1])
    assert (answer.success, answer.message) == (True, "holds at the start")
    rig.go_to(EPOCH + NS_PER_S, 0.1, 0.2)
    np.testing.assert_allclose(rig.last.u, given[1], atol=1e-9)
    deviations = np.sqrt(np.diag(rig.last.covariance))
    np.testing.assert_allclose(deviations[2:], [2.0, 2.5], rtol=0.02)


def test_an_inactive_node_goes_on_and_a_cleanup_forgets_the_robot(rig: Rig) -> None:
    """Samples in a pause count; a node that is configured again starts at its encoders again."""
    rig.go_to(EPOCH + NS_PER_S, 0.25, 0.5)
    rig.node.trigger_deactivate()
    count = len(rig.states)
    rig.go_to(EPOCH + NS_PER_S + 10**7, 0.25, 0.5)
    assert len(rig.states) == count
    rig.node.trigger_activate()
    assert rig.node.observer.samples.counts[0]["accepted"] == 2
    rig.node.trigger_deactivate()
    rig.node.trigger_cleanup()
    rig.spinner.until(lambda: rig.encoders.get_subscription_count() == 0)
    rig.node.trigger_configure()
    rig.node.trigger_activate()
    rig.spinner.until(lambda: rig.encoders.get_subscription_count() == 2)
    rig.go_to(EPOCH + 2 * NS_PER_S, 0.75, 1.0)
    np.testing.assert_allclose([*rig.last.q, *rig.last.u], [0.75, 1.0, 0.0, 0.0], atol=1e-9)


def test_samples_that_come_too_fast_are_shed_so_that_the_newest_count(rig: Rig) -> None:
    """An observer that takes 20 ms of processor time for a sample uses few of a hundred."""
    observer, use = rig.node.observer, rig.node.observer.measure

    def used_slowly(samples: Sequence[SensorSample]) -> object:
        end = time.thread_time() + 0.02 * len(samples)
        while time.thread_time() < end:
            pass
        return use(samples)

    rig.go_to(EPOCH + NS_PER_S, 0.1, 0.2)
    observer.measure = used_slowly  # type: ignore[method-assign,assignment]
    last = EPOCH + NS_PER_S + 10**8
    for stamp in range(EPOCH + NS_PER_S + 10**6, last + 1, 10**6):
        rig.measure(stamp, 0.1, 0.2)
    rig.spinner.until(lambda: observer.samples.newest[0] == last)
    counts = observer.samples.counts[0]
    assert counts["shed"] > 50
    assert counts["shed"] + counts["samples"] == 101
    shed = "samples were shed: the observer cannot keep up"
    rig.spinner.until(lambda: any(shed in each.message for each in rig.diagnostics))


@pytest.mark.parametrize(
    "given",
    [
        {"law": "geometric"},
        {"model_error": 0.1},
        {"estimate_parameters": ("restitution",)},
        {"measurements": ""},
        {"measurements": "shoulder"},
        {"law": "measured-position", "measurements": "shoulder"},
    ],
)
def test_a_node_refuses_what_the_command_refuses(
    given: dict[str, str | float | tuple[str, ...]],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """In the same line, with exit code 2."""
    only = tmp_path / "shoulder.yaml"
    lines = shared("config/measurements/hammer_arm.yaml").read_text("utf-8").splitlines()
    only.write_text("\n".join(lines[:-1]), encoding="utf-8")
    options = dict(given)
    sensors = options.pop("measurements", "hammer_arm")
    sensors = str(only) if sensors == "shoulder" else str(sensors)
    law = {"law": "minimum-variance", "clock_error": 0.0002}
    with pytest.raises(UsageError) as error:
        make_observer(
            "hammer_arm",
            Options(**{**law, **options}),  # type: ignore[arg-type]
            measurements=read_measurements(sensors),
        )
    shown = {
        key: f"[{', '.join(value)}]" if isinstance(value, tuple) else value
        for key, value in options.items()
    }
    parameters = {**OBSERVED, **shown, "measurements": sensors or "''"}
    assert refusal("observer", ros_arguments(parameters), capfd).endswith(str(error.value))
