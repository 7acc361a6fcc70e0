# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes, and exit codes of their processes."""

import re
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from impact_observer_msgs.msg import ContactSwitch, ImpactEvent, ObserverState
from processes import hosted, refusal, ros_arguments, spinning
from sensor_msgs.msg import JointState

from impact_observer.io.interfaces import STATES, Quality
from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.plant_node import PlantNode
from impact_observer.ros.topics import qos_profile

pytestmark = pytest.mark.ros


def test_a_body_at_rest_on_its_stop_is_published_as_closed(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """The plant publishes CLOSE at the epoch, and the observer holds the contact."""
    model = tmp_path / "resting.yaml"
    model.write_text(
        "name: resting\nbodies: [{name: z, mass: 1}]\nforces: [{body: z, constant: -9.81}]\n"
        "stops: [{name: floor, body: z, limit: 0, side: below, restitution: 0.5}]\n"
        "initial_state: {position: [0], velocity: [0]}\n",
        encoding="utf-8",
    )
    assert ros_environment
    events, states, truth = list[ImpactEvent](), list[ObserverState](), list[JointState]()
    given = {
        "model": model,
        "epoch": 3_000_000_000,
        "plant:publish_clock": True,
        "plant:duration": 1.0,
        "observer:use_sim_time": True,
        "observer:initial_state": "'0.3,1.0'",
    }
    with hosted(ObserverNode, given) as (_, spinner):
        probe, seen = spinner.probe, qos_profile(Quality(depth=1000))
        received = qos_profile(Quality(transient_local=True, depth=10))
        probe.create_subscription(ImpactEvent, "impacts", events.append, received)
        probe.create_subscription(JointState, "plant/joint_states", truth.append, seen)
        probe.create_subscription(ObserverState, "observer/state", states.append, seen)
        spinner.add(plant := PlantNode())
        spinner.until(lambda: plant.done)
        spinner.settle()
    assert [[(s.contact, s.kind) for s in event.switches] for event in events] == [
        [("floor", ContactSwitch.CLOSE)]
    ]
    assert (events[0].header.stamp.sec, events[0].header.stamp.nanosec) == (3, 0)
    assert list(states[-1].closed) == ["floor"]
    assert states[-1].position[0] == 0.0
    assert truth[-1].position[0] == 0.0


@pytest.mark.parametrize(
    ("module", "parameters", "expected"),
    [
        ("observer", {}, "parameter model: is not set"),
        ("observer", {}, "a sample: give --ros-args -p model:=FILE"),
        ("observer", {"model": "nothing.yaml"}, "nothing.yaml: no such file"),
        ("observer", {"model": "two_mass", "law": "magic"}, "law 'magic': not installed"),
        ("observer", {"model": "two_mass", "rate": -1.0}, "parameter rate"),
        ("observer", {"model": "two_mass", "rate": "[]"}, "parameter rate: None found"),
        ("observer", {"model": "two_mass", "history": 1e300}, "parameter history"),
        ("observer", {"model": "two_mass", "initial_state": "one"}, "initial state 'one'"),
        ("plant", {"model": "two_mass", "realtime_factor": 2.0}, "needs publish_clock"),
        (
            "plant",
            {"model": "two_mass", "duration": 1e300},
            "parameter duration",
        ),
        ("plant", {"model": "two_mass", "sensor.mislabelled": 0.1}, "sensor mislabelled"),
        ("observer", {"model": "two_mass", "use_sim_time": "banana"}, "use_sim_time"),
        ("observer", {"model": "two_mass", "lag": 3.0, "history": 2.0}, "parameter lag"),
        ("detector", {}, "parameter sources: is not set"),
        ("detector", {"sources": "no.yaml"}, "no.yaml"),
        ("detector", {"sources": "switch", "epoch": -1}, "parameter epoch"),
        ("monitor", {"model": "two_mass", "law": 3}, "parameter law"),
    ],
)
def test_a_wrong_parameter_is_one_line_and_exit_code_2(
    ros_environment: dict[str, str],
    capfd: pytest.CaptureFixture[str],
    module: str,
    parameters: dict[str, object],
    expected: str,
) -> None:
    """The line names the parameter, the value and the values that are expected."""
    assert ros_environment
    arguments = ros_arguments(parameters)
    line = refusal(module, arguments, capfd)
    assert line.startswith(f"{module}: ")
    assert expected in line


def test_misspelt_parameters_give_a_warning_in_log_and_diagnostics(
    ros_environment: dict[str, str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """ROS ignores such parameters, on the command line and in files, also beside an empty list."""
    file = tmp_path / "parameters.yaml"
    text = "/**: {ros__parameters: {estimate_parameters: [], sensor: {jitter: 1.0}}}\n"
    file.write_text(f"{text}plant: {{ros__parameters: {{step: 1.0}}}}\n", encoding="utf-8")
    assert ros_environment
    arguments = ros_arguments({"model": "two_mass", "lwa": "kinematic", "observer:rat": 1.0})
    arguments += ["-p", "monitor:laws:=x", "--params-file", str(file)]
    statuses: dict[str, DiagnosticStatus] = {}
    with spinning(arguments) as spinner:
        spinner.add(ObserverNode())
        spinner.probe.create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda array: statuses.update({each.name: each for each in array.status}),
            qos_profile(STATES),
        )
        spinner.until(lambda: "/observer: node" in statuses)
    errors = "".join(capfd.readouterr())
    status = statuses["/observer: node"]
    assert status.level == DiagnosticStatus.WARN
    assert "parameter lwa does not exist and is ignored; expected " in status.message
    unknown = re.findall(r"parameter (\S+) does not exist", errors)
    assert unknown == ["lwa", "rat", "sensor.jitter"]
