# SPDX-License-Identifier: Apache-2.0
"""The plant node's sensor: the same events as offline, published when they arrive."""

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from impact_observer_msgs.msg import ImpactEvent
from processes import hosted
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from impact_observer.io import interfaces
from impact_observer.io.simulated_samples import SampleSimulation, samples_of_run
from impact_observer.model import parse_model, read_model
from impact_observer.model.measurement import read_measurements
from impact_observer.plant import Plant, SensorModel, simulate, simulate_sensor
from impact_observer.ros.plant_node import PlantNode
from impact_observer.ros.topics import message_class, qos_profile
from impact_observer.stamps import NS_PER_S, grid

pytestmark = pytest.mark.ros

EPOCH = 7 * NS_PER_S
SECONDS = 10
FAULTS = {"delay": 0.02, "jitter": 0.002, "missed": 0.1, "spurious": 2.0, "transport": 1.0}


def stamp_of(time: object) -> int:
    """A message's time, ns."""
    return time.sec * NS_PER_S + time.nanosec  # type: ignore[attr-defined, no-any-return]


def test_plant_node_publishes_the_events_of_the_simulated_sensor_on_arrival(
    ros_environment: dict[str, str],
) -> None:
    """Every event comes in the order of arrival, also after the end of the duration."""
    assert ros_environment
    parameters = {
        "model": "three_mass",
        "publish_clock": True,
        "clock_rate": 1000.0,
        "epoch": EPOCH,
        "realtime_factor": 5.0,
        "duration": float(SECONDS),
        "seed": 5,
        **{f"sensor.{name}": value for name, value in FAULTS.items()},
    }
    events: list[ImpactEvent] = []
    models: list[String] = []
    shown: list[int] = []
    truth: list[int] = []
    with hosted(PlantNode, parameters) as (node, spinner):
        for interface, hear in (
            (interfaces.IMPACTS, events.append),
            (interfaces.PLANT_MODEL, models.append),
            (interfaces.PLANT_JOINT_STATES, lambda m: truth.append(stamp_of(m.header.stamp))),
        ):
            spinner.probe.create_subscription(
                message_class(interface.type),
                interface.name,
                hear,
                qos_profile(interface.quality),
            )
        spinner.probe.create_subscription(
            Clock, "/clock", lambda m: shown.append(stamp_of(m.clock)), 10
        )
        spinner.until(lambda: node.done)
        spinner.settle()
    model, last = read_model("three_mass"), EPOCH + SECONDS * NS_PER_S
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    run = simulate(plant, grid(EPOCH, last, 1.0))
    sensor = SensorModel(**FAULTS)  # type: ignore[arg-type]
    wanted = simulate_sensor(sensor, model.system, run.switchings, epoch=EPOCH, last=last, seed=5)
    assert [(stamp_of(e.header.stamp), e.sequence) for e in events] == [
        (each.event.stamp, each.event.sequence) for each in wanted
    ]
    assert [[s.contact for s in e.switches] for e in events] == [
        [s.contact for s in each.event.switches] for each in wanted
    ]
    assert wanted[-1].arrival > last, "a message arrives after the end"
    assert max(truth) == last
    assert max(shown) >= last
    assert parse_model(models[0].data, "model").provenance["sensor"] == FAULTS


def test_plant_node_publishes_what_simulated_sensors_measure(
    ros_environment: dict[str, str],
) -> None:
    """The samples equal those of ``simulate`` with the same seed."""
    assert ros_environment
    parameters = {
        "model": "two_mass",
        "publish_clock": True,
        "epoch": EPOCH,
        "duration": 2.0,
        "seed": 3,
        "measurements": "encoder",
        "measurement_rate": 20.0,
    }
    found: dict[int, float] = {}
    with hosted(PlantNode, parameters) as (node, spinner):
        for interface in (interfaces.IMPACTS, interfaces.PLANT_JOINT_STATES):
            spinner.probe.create_subscription(
                message_class(interface.type),
                interface.name,
                lambda _: None,
                qos_profile(interface.quality),
            )
        spinner.probe.create_subscription(
            JointState,
            "/encoder",
            lambda m: found.update({stamp_of(m.header.stamp): m.position[0]}),
            qos_profile(interfaces.SENSORS),
        )
        spinner.until(lambda: node.done)
        spinner.settle()
    model, last = read_model("two_mass"), EPOCH + 2 * NS_PER_S
    simulation = SampleSimulation(read_measurements("encoder"), model.system, 20.0, 3)
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    run = simulate(plant, simulation.stamps(EPOCH, last))
    wanted = {each.stamp: each.value for each in samples_of_run(simulation, run)}
    assert found.keys() <= wanted.keys()
    assert len(found) >= 0.8 * len(wanted)
    assert {stamp: wanted[stamp] for stamp in found} == pytest.approx(found, abs=1e-12)
