# SPDX-License-Identifier: Apache-2.0
"""The plant node: what it publishes is what a simulation without ROS has."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

import live_rig
from diagnostic_msgs.msg import DiagnosticArray
from impact_observer_msgs.msg import ImpactEvent, ObserverState
from processes import hosted, ros_arguments, spinning
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from systems import EPOCH

from impact_observer.errors import InputTimeoutError
from impact_observer.events import Kind
from impact_observer.io.interfaces import EVENTS, FORCING, LATCHED, SENSORS, STATES, Quality
from impact_observer.io.messages import JointState as State
from impact_observer.io.messages import read, read_event, read_stamp
from impact_observer.io.simulated_samples import SampleSimulation, samples_of_run
from impact_observer.model import parse_model, read_model
from impact_observer.model.measurement import read_measurements
from impact_observer.model.multibody import multibody_of
from impact_observer.plant import Plant, SensorModel, simulate, simulate_sensor
from impact_observer.resources import shared
from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.plant_node import PlantNode
from impact_observer.ros.topics import qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S, grid

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_environment")]

OWN_CLOCK = {"publish_clock": True, "epoch": EPOCH}
TRUTH = "plant/joint_states"


def stamp_of(message: JointState | ImpactEvent) -> int:
    """The stamp in a header, ns."""
    return read_stamp("stamp", message.header.stamp)


def test_events_of_the_simulated_sensor_are_published_on_arrival() -> None:
    """Every event comes in the order of arrival, also after the end of the duration."""
    seconds, last = 10, EPOCH + 10 * NS_PER_S
    faults = {"delay": 0.02, "jitter": 0.002, "missed": 0.1, "spurious": 2.0, "transport": 1.0}
    given = {
        **OWN_CLOCK,
        "model": "three_mass",
        "clock_rate": 1000.0,
        "realtime_factor": 5.0,
        "duration": float(seconds),
        "seed": 5,
        **{f"sensor.{name}": value for name, value in faults.items()},
    }
    with hosted(PlantNode, given) as (node, spinner):
        events = spinner.collect(ImpactEvent, "impacts", EVENTS)
        models = spinner.collect(String, "plant/model", LATCHED)
        truth, clock = spinner.collect(JointState, TRUTH), spinner.collect(Clock, "/clock")
        spinner.until(lambda: node.done)
        spinner.until(lambda: bool(truth) and stamp_of(truth[-1]) == last)
        spinner.settle()
    model = read_model("three_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    run = simulate(plant, grid(EPOCH, last, 1.0))
    sensor = SensorModel(**faults)  # type: ignore[arg-type]
    wanted = simulate_sensor(sensor, model.system, run.switchings, epoch=EPOCH, last=last, seed=5)
    found = [(read_event(each).stamp, each.sequence) for each in events]
    assert found == [(each.event.stamp, each.event.sequence) for each in wanted]
    assert [read_event(each).switches for each in events] == [e.event.switches for e in wanted]
    assert wanted[-1].arrival > last, "a message arrives after the end"
    assert read_stamp("clock", clock[-1].clock) >= last
    assert parse_model(models[0].data, "model").provenance["sensor"] == faults


def test_simulated_sensors_measure_what_they_do_offline() -> None:
    """The samples equal those of ``simulate`` with the same seed."""
    given = {
        **OWN_CLOCK,
        "model": "two_mass",
        "duration": 2.0,
        "seed": 3,
        "measurements": "encoder",
        "measurement_rate": 20.0,
    }
    with hosted(PlantNode, given) as (node, spinner):
        messages = spinner.collect(JointState, "/encoder", SENSORS)
        spinner.until(lambda: node.done)
        spinner.settle()
    found = {stamp_of(each): each.position[0] for each in messages}
    model, last = read_model("two_mass"), EPOCH + 2 * NS_PER_S
    simulation = SampleSimulation(read_measurements("encoder"), model.system, 20.0, 3)
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    run = simulate(plant, simulation.stamps(EPOCH, last))
    wanted = {each.stamp: each.value for each in samples_of_run(simulation, run)}
    assert found.keys() <= wanted.keys()
    assert len(found) >= 0.8 * len(wanted)
    assert {stamp: wanted[stamp] for stamp in found} == pytest.approx(found, abs=1e-12)


def test_a_plant_waits_for_its_inputs_and_ends_without_them(tmp_path: Path) -> None:
    """Impacts and true states equal those offline up to the last sample; then it is the end."""
    position, velocity = (each.tolist() for each in live_rig.START)
    model = tmp_path / "rig.yaml"
    initial = f"initial_state: {{position: {position}, velocity: {velocity}}}\n"
    model.write_text(live_rig.RIG + initial)
    given = {**OWN_CLOCK, "model": model, "duration": 4.0, "future": 3.0, "input_timeout": 2.0}
    end = EPOCH + 2 * NS_PER_S
    with hosted(PlantNode, given) as (_, spinner):
        events = spinner.collect(ImpactEvent, "impacts", EVENTS)
        truth = spinner.collect(JointState, TRUTH, STATES)
        quality = qos_profile(FORCING.quality)
        forces = spinner.probe.create_publisher(JointState, FORCING.name, quality)
        spinner.until(forces.get_subscription_count)
        spinner.settle()
        for stamp, value in live_rig.samples():
            if stamp <= end:
                forces.publish(ros_messages().joints(stamp, ["motor"], effort=[value]))
                spinner.executor.spin_once(timeout_sec=0.0)  # no more wait than the topic keeps
        with pytest.raises(InputTimeoutError, match="no sample of motor for"):
            spinner.until(lambda: False)
    wanted, stamps, states = live_rig.simulated()
    assert [stamp_of(each) for each in events] == [e.stamp for e in wanted if e.stamp < end]
    where = {stamp: k for k, stamp in enumerate(stamps.tolist())}
    assert stamp_of(truth[-1]) == end - NS_PER_S // 100
    for each in truth:
        k = where[stamp_of(each)]
        np.testing.assert_array_equal([*each.position, *each.velocity], states[k])


def test_a_jump_of_the_clock_ahead_begins_a_new_episode() -> None:
    """Nothing is published of the time between, and the diagnostics tell the jump."""
    start, hour = 100 * NS_PER_S, 3600 * NS_PER_S
    with hosted(PlantNode, {"model": "two_mass", "use_sim_time": True}) as (_, spinner):
        clock = spinner.probe.create_publisher(Clock, "/clock", qos_profile(STATES))
        truth = spinner.collect(JointState, TRUTH)
        messages = spinner.collect(ImpactEvent, "impacts", EVENTS)
        spinner.until(clock.get_subscription_count)

        def until_published(stamp: int) -> None:
            """Let the time be ``stamp``, and wait for the true state shortly before."""
            clock.publish(ros_messages().clock(stamp))
            spinner.until(lambda: truth and stamp_of(truth[-1]) > stamp - NS_PER_S // 10)

        for second in (0, 3, 3600, 3603):
            until_published(start + second * NS_PER_S)
        spinner.until(lambda: stamp_of(messages[-1]) > start + hour)
        stamps, events = [*map(stamp_of, truth)], [*map(read_event, messages)]
        assert [each for each in stamps if start + 3 * NS_PER_S < each < start + hour] == []
        assert {each.episode for each in events} == {0, 1}
        assert {each.epoch for each in events} == {start, start + hour}
        found = spinner.collect(DiagnosticArray, "/diagnostics")
        ahead = "3597.000 s ahead"
        spinner.until(lambda: any(ahead in s.message for each in found for s in each.status))


def test_a_body_at_rest_on_its_stop_is_published_as_closed(tmp_path: Path) -> None:
    """The plant publishes CLOSE at the epoch, and the observer holds the contact."""
    model = tmp_path / "resting.yaml"
    model.write_text(
        "name: resting\nbodies: [{name: z, mass: 1}]\nforces: [{body: z, constant: -9.81}]\n"
        "stops: [{name: floor, body: z, limit: 0, side: below, restitution: 0.5}]\n"
        "initial_state: {position: [0], velocity: [0]}\n",
        encoding="utf-8",
    )
    given = {
        "model": model,
        "epoch": EPOCH,
        "plant:publish_clock": True,
        "plant:duration": 1.0,
        "observer:use_sim_time": True,
        "observer:initial_state": "'0.3,1.0'",
    }
    with hosted(ObserverNode, given) as (_, spinner):
        events = spinner.collect(ImpactEvent, "impacts", Quality(transient_local=True))
        truth = spinner.collect(JointState, TRUTH)
        states = spinner.collect(ObserverState, "observer/state")
        spinner.add(plant := PlantNode())
        spinner.until(lambda: plant.done)
        spinner.settle()
    (event,) = map(read_event, events)
    assert (event.stamp, event.switches[0].contact) == (EPOCH, "floor")
    assert event.switches[0].kind is Kind.CLOSE
    assert list(states[-1].closed) == ["floor"]
    assert states[-1].position[0] == truth[-1].position[0] == 0.0


def test_a_robot_is_simulated_live_as_offline(tmp_path: Path) -> None:
    """Impacts, true states and encoders with efforts are those of a run offline."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    sample = read_model("hammer_arm")
    assert sample.robot is not None
    text = shared("config/hammer_arm.yaml").read_text(encoding="utf-8")
    path = tmp_path / "hammer_arm.yaml"
    path.write_text(text.replace("urdf: hammer_arm.urdf", "urdf: {topic: robot_description}"))
    given = {
        **OWN_CLOCK,
        "model": path,
        "realtime_factor": 2.0,
        "duration": 2.5,
        "rate": 100.0,
        "measurements": "hammer_arm",
        "measurement_rate": 50.0,
    }
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with spinning(ros_arguments(given)) as spinner:
        publisher = spinner.probe.create_publisher(String, "robot_description", latched)
        publisher.publish(String(data=sample.robot.known_urdf.text))
        events = spinner.collect(ImpactEvent, "impacts", EVENTS)
        truth = spinner.collect(JointState, TRUTH)
        encoders = spinner.collect(JointState, "/joint_states", SENSORS)
        spinner.add(node := PlantNode())
        spinner.until(lambda: node.done)
        spinner.settle()
    stamps = grid(EPOCH, EPOCH + round(2.5 * NS_PER_S), 100)
    run = simulate(Plant(multibody_of(sample), *sample.initial_state(), epoch=EPOCH), stamps)
    assert [stamp_of(each) for each in events] == [each.stamp for each in run.events] != []
    assert len(truth) >= 50
    for each in (read(State, message) for message in truth):
        k = int(np.searchsorted(stamps, each.stamp))
        np.testing.assert_array_equal([*each.q, *each.u], run.states[k])
    assert len(encoders) >= 20
    assert list(encoders[0].name) == ["shoulder", "elbow"]
    assert len(encoders[0].position) == len(encoders[0].effort) == 2
