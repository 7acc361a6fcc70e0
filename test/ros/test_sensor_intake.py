# SPDX-License-Identifier: Apache-2.0
"""An observer node with sensors beside the impacts: estimates, verdicts, diagnostics."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from impact_observer_msgs.msg import ImpactEvent, MeasurementVerdict
from processes import Spinner, ros_arguments, spinning
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Float64

from impact_observer.io.interfaces import EVENTS, STATES, Quality
from impact_observer.model import read_model
from impact_observer.model.measurement import parse_measurements
from impact_observer.observer import Options, make_observer
from impact_observer.observer.samples import SensorSample
from impact_observer.plant import Plant, Run, simulate
from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.topics import qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S, grid

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_environment")]

EPOCH = 5 * NS_PER_S
SENSORS = """\
measurements:
  - {name: encoder, topic: encoder, joint: x1, quantity: position, deviation: 0.001, timeout: 0.2,
     gate: 1.0e9}
  - {name: laser, topic: laser, field: range, position: {x2: -1}, offset: 2, deviation: 0.01,
     delay: 0.005, gate: 1.0e9}
"""
LAW, INITIAL = "minimum-variance", "0.2,-0.1,0.3,0.2"


@dataclass
class Rig:
    """A running observer node, publishers of its inputs, and what was received from it."""

    spinner: Spinner
    node: ObserverNode
    clock: Publisher
    impacts: Publisher
    encoder: Publisher
    laser: Publisher
    verdicts: list[MeasurementVerdict] = field(default_factory=list)
    diagnostics: list[DiagnosticStatus] = field(default_factory=list)

    def tick(self, stamp: int) -> None:
        """Let simulated time be ``stamp``."""
        self.clock.publish(ros_messages().clock(stamp))
        self.spinner.until(lambda: self.node.get_clock().now().nanoseconds == stamp)

    def counts(self, index: int) -> dict[str, int]:
        """The counts of the samples of a sensor."""
        return self.node.observer.samples.counts[index]

    def send_encoder(self, stamp: int, value: float) -> None:
        """Publish a position of x1."""
        message = JointState(name=["x0", "x1"], position=[0.0, value])
        message.header.stamp = ros_messages().time(stamp)
        self.encoder.publish(message)

    def send_laser(self, stamp: int, value: float) -> None:
        """Publish a range, which is stamped late."""
        message = Range(range=value)
        message.header.stamp = ros_messages().time(stamp + 5_000_000)
        self.laser.publish(message)

    def status(self, name: str) -> DiagnosticStatus:
        """The next status of a sensor."""
        self.diagnostics.clear()
        ending = f": sensor {name}"
        self.spinner.until(lambda: any(s.name.endswith(ending) for s in self.diagnostics))
        return next(s for s in self.diagnostics if s.name.endswith(ending))


@contextmanager
def rig_with(folder: Path, sensors: str = SENSORS, **parameters: object) -> Iterator[Rig]:
    """An observer node of two_mass beside a probe that plays plant and sensors."""
    (folder / "sensors.yaml").write_text(sensors)
    given = {
        "model": "two_mass",
        "use_sim_time": True,
        "epoch": EPOCH,
        "law": LAW,
        "initial_state": f"'{INITIAL}'",
        "measurements": str(folder / "sensors.yaml"),
        **parameters,
    }
    with spinning(ros_arguments(given)) as spinner:
        node, probe, many = ObserverNode(), spinner.probe, qos_profile(Quality(depth=2000))
        spinner.add(node)
        laser = JointState if "x3" in sensors else Range
        offered = qos_profile(Quality(depth=2000, reliable=False))
        rig = Rig(
            spinner,
            node,
            probe.create_publisher(Clock, "/clock", qos_profile(STATES)),
            probe.create_publisher(ImpactEvent, "impacts", qos_profile(EVENTS)),
            probe.create_publisher(JointState, "encoder", offered),
            probe.create_publisher(laser, "laser", offered),
        )
        probe.create_subscription(
            MeasurementVerdict, "observer/measurements", rig.verdicts.append, many
        )
        probe.create_subscription(
            DiagnosticArray, "/diagnostics", lambda a: rig.diagnostics.extend(a.status), many
        )
        publishers = (rig.clock, rig.impacts, rig.encoder)
        spinner.until(lambda: all(each.get_subscription_count() for each in publishers))
        yield rig


def run() -> Run:
    """A run of two_mass over two seconds, with an impact."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    return simulate(plant, grid(EPOCH, EPOCH + 2 * NS_PER_S, 40.0))


def test_live_estimates_are_those_of_the_same_samples_offline(tmp_path: Path) -> None:
    """Samples in another order, late and delayed, give equal bits."""
    whole, draw = run(), np.random.default_rng(1)
    encoder = [(int(s), float(x[0])) for s, x in zip(whole.stamps, whole.states, strict=True)]
    laser = [
        (s, float(np.float32(2 - x[1]))) for (s, _), x in zip(encoder, whole.states, strict=True)
    ]
    declared: dict[str, Any] = {"clock_error": 1e-3}
    with rig_with(tmp_path, **declared) as rig:
        rig.spinner.until(rig.laser.get_subscription_count)
        rig.tick(EPOCH + 2 * NS_PER_S)
        items = [(0, *each) for each in encoder] + [(1, *each) for each in laser]
        order = np.argsort([stamp for _, stamp, _ in items] + draw.uniform(0, 2e8, len(items)))
        for i in order.tolist():
            kind, stamp, value = items[i]
            (rig.send_laser if kind else rig.send_encoder)(stamp, value)
        for each in whole.events:
            rig.impacts.publish(ros_messages().event(each))
        node = rig.node.observer
        rig.spinner.until(lambda: node.samples.counts[0]["samples"] == len(encoder))
        rig.spinner.until(lambda: node.samples.counts[1]["samples"] == len(laser))
        rig.spinner.until(lambda: node.last_event == whole.events[-1].stamp)
        live = [node.estimate(stamp) for stamp in (EPOCH + NS_PER_S, EPOCH + 2 * NS_PER_S)]
    sensors = parse_measurements(SENSORS, "rig")
    options = Options(LAW, INITIAL, epoch=EPOCH, **declared)
    same = make_observer(read_model("two_mass").system, options, measurements=sensors)
    same.measure([SensorSample(0, *each) for each in encoder])
    for each in whole.events:
        same.receive(each)
    same.measure([SensorSample(1, *each) for each in laser])
    for estimate in live:
        wanted = same.estimate(estimate.stamp)
        assert estimate.q.tobytes() == wanted.q.tobytes()
        assert estimate.u.tobytes() == wanted.u.tobytes()


def test_silence_and_what_is_wrong_with_a_sensor_are_its_diagnostics(tmp_path: Path) -> None:
    """Silence, a timeout, a clock off by an hour and NaN are reported; other samples are used."""
    with rig_with(tmp_path) as rig:
        rig.tick(EPOCH + NS_PER_S)
        assert rig.status("laser").message == "no sample yet; timeout is 1 s"
        rig.send_encoder(EPOCH + NS_PER_S // 2, 0.1)
        rig.spinner.until(lambda: rig.counts(0)["accepted"] == 1)
        status = rig.status("encoder")
        assert status.level == DiagnosticStatus.WARN
        assert status.message == "no sample for 0.5 s; timeout is 0.2 s"
        rig.send_encoder(EPOCH + 3601 * NS_PER_S, 0.1)
        expected = "stamped 3600.000 s after the clock; future allows 1 s, and it waits"
        rig.spinner.until(lambda: rig.status("encoder").message == expected)
        rig.send_encoder(EPOCH + NS_PER_S, float("nan"))
        rig.spinner.until(lambda: rig.counts(0)["invalid"] == 1)
        rig.send_encoder(EPOCH + NS_PER_S - 1, 0.1)
        rig.spinner.until(lambda: rig.counts(0)["accepted"] == 2)
        values = {each.key: each.value for each in rig.status("encoder").values}
        assert (values["samples"], values["accepted"], values["invalid"]) == ("3", "2", "1")


def test_a_sample_ahead_of_a_late_clock_is_used_when_that_has_come(tmp_path: Path) -> None:
    """The sample takes its place among others, and none counts as invalid."""
    stamps = [EPOCH + k * NS_PER_S // 2 for k in range(1, 8)]
    with rig_with(tmp_path, history=10.0) as rig:
        rig.tick(EPOCH + NS_PER_S)
        for k, stamp in enumerate(stamps):  # the last three are ahead by more than 1 s
            rig.send_encoder(stamp, 0.1 * k)
        rig.spinner.until(lambda: rig.counts(0)["accepted"] == 4)
        rig.spinner.settle()
        assert rig.counts(0)["accepted"] == 4
        rig.tick(EPOCH + 3 * NS_PER_S)
        rig.spinner.until(lambda: rig.counts(0)["accepted"] == 7)
        assert rig.counts(0)["invalid"] == 0
        assert rig.status("encoder").message == "7 samples accepted"


def test_verdicts_on_samples_of_fast_sensors_are_not_published(tmp_path: Path) -> None:
    """Those on samples at 10 Hz are, those on samples at 100 Hz are not."""
    with rig_with(tmp_path, history=10.0) as rig:
        rig.spinner.until(rig.laser.get_subscription_count)
        rig.tick(EPOCH + 4 * NS_PER_S)
        for k in range(1, 61):
            rig.send_encoder(EPOCH + k * NS_PER_S // 100, 0.1)
        for k in range(1, 31):
            rig.send_laser(EPOCH + k * NS_PER_S // 10, 2.0)
        rig.spinner.until(lambda: rig.counts(0)["accepted"] >= 30)
        rig.spinner.until(lambda: rig.counts(1)["accepted"] >= 22)
        rig.send_laser(EPOCH + 31 * NS_PER_S // 10, 2.0)
        rig.spinner.until(lambda: rig.verdicts)
        rig.spinner.settle()
        assert {each.name for each in rig.verdicts} == {"laser"}


def test_a_topic_of_another_type_is_a_diagnostic_until_its_type_changes(tmp_path: Path) -> None:
    """The other sensor goes on; no message without a stamp makes a sensor deaf."""
    wrong = SENSORS.replace("topic: laser, field: range, position", "topic: floats, joint: x2,"
                            " quantity: position, stamp: header, position")  # fmt: skip
    with rig_with(tmp_path, wrong) as rig:
        probe = rig.spinner.probe
        floats = probe.create_publisher(Float64, "floats", 10)
        rig.tick(EPOCH + NS_PER_S)
        rig.spinner.until(lambda: "no joints" in rig.status("laser").message, 10.0)
        rig.send_encoder(EPOCH + NS_PER_S, 0.1)
        rig.spinner.until(lambda: rig.counts(0)["accepted"] == 1)
        probe.destroy_publisher(floats)
        joints = probe.create_publisher(JointState, "floats", 10)
        rig.spinner.until(joints.get_subscription_count)
        message = JointState(name=["x2"], position=[0.1])
        joints.publish(message)
        message.header.stamp = ros_messages().time(EPOCH + NS_PER_S)
        joints.publish(message)
        rig.spinner.until(lambda: rig.counts(1)["accepted"] == 1)
        assert rig.counts(1)["invalid"] == 2, "of the type, and of the stamp"
