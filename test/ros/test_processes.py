# SPDX-License-Identifier: Apache-2.0
"""The nodes as processes: parameters, signals, exit codes, and the estimate on the topic."""

import re
import signal
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from impact_observer_msgs.msg import ContactSwitch, EstimateError, ImpactEvent, ObserverState
from processes import interrupt, refusal, ros_arguments, running_node, spinning
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from impact_observer.io.interfaces import EVENTS, STATES, Quality
from impact_observer.ros.topics import qos_profile

pytestmark = pytest.mark.ros


def test_plant_and_observer_processes_converge_on_the_topic(
    ros_environment: dict[str, str],
) -> None:
    """Three processes over DDS; the monitor's error falls by a factor of a hundred."""
    simulated = {"model": "two_mass", "use_sim_time": True}
    rate, epoch = 20.0, 7_000_000_000  # a hundred a second are kept by a busy machine too
    observer = ros_arguments(
        {**simulated, "rate": rate, "epoch": epoch, "initial_state": "'random:1'"}
    )
    plant = ros_arguments(
        {
            "model": "two_mass",
            "rate": rate,
            "publish_clock": True,
            "epoch": epoch,
            "realtime_factor": 5.0,
            "duration": 15.0,
            "wait_for_subscribers": 2,  # the second is the probe's
        }
    )
    errors: list[EstimateError] = []
    times: list[int] = []
    with (
        running_node("observer", observer, ros_environment) as first,
        running_node("monitor", ros_arguments(simulated), ros_environment) as second,
        spinning() as spinner,
    ):
        spinner.probe.create_subscription(
            EstimateError, "monitor/error", errors.append, qos_profile(Quality(depth=1000))
        )
        spinner.probe.create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda array: times.append(array.header.stamp.sec),
            qos_profile(STATES),
        )
        spinner.until(lambda: spinner.probe.count_publishers("monitor/error") == 1)
        with running_node("plant", plant, ros_environment) as third:
            # Until the observer has received the clock it skips estimates.
            spinner.until(lambda: times and times[-1] > 0)
            spinner.probe.create_subscription(
                ImpactEvent, "impacts", lambda _: None, qos_profile(EVENTS)
            )
            spinner.probe.create_subscription(
                JointState, "plant/joint_states", lambda _: None, qos_profile(STATES)
            )
            spinner.until(lambda: third.poll() is not None)
            assert third.returncode == 0, third.communicate()
        spinner.settle()
        assert interrupt(first)[0] == 0
        assert interrupt(second)[0] == 0
    assert len(errors) > 200, "of 301"
    assert 3.5 < errors[0].v < 4.18, "at the epoch it is 4.176 J, and it falls"
    assert errors[-1].v < 1e-2 * errors[0].v
    last = errors[-1]
    assert list(last.name) == ["x1", "x2"]
    assert np.abs(last.position_error).max() < 0.05


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
    arguments = {"model": str(model), "epoch": 3_000_000_000}
    simulated = {"publish_clock": True, "duration": 2.0, "wait_for_subscribers": 1}
    options = {"use_sim_time": True, "initial_state": "'0.3,1.0'"}
    events: list[ImpactEvent] = []
    states: list[ObserverState] = []
    truth: list[JointState] = []
    observer = ros_arguments({**arguments, **options})
    with (
        running_node("observer", observer, ros_environment),
        spinning() as spinner,
    ):
        probe = spinner.probe
        received = qos_profile(Quality(transient_local=True, depth=10))
        probe.create_subscription(ImpactEvent, "impacts", events.append, received)
        seen = qos_profile(Quality(depth=1000))
        probe.create_subscription(JointState, "plant/joint_states", truth.append, seen)
        probe.create_subscription(ObserverState, "observer/state", states.append, seen)
        spinner.until(lambda: probe.count_publishers("observer/state") == 1)
        spinner.settle()
        plant = ros_arguments({**arguments, **simulated})
        with running_node("plant", plant, ros_environment) as process:
            spinner.until(lambda: process.poll() is not None)
            assert process.returncode == 0, process.communicate()
        spinner.settle()
    assert [[(s.contact, s.kind) for s in event.switches] for event in events] == [
        [("floor", ContactSwitch.CLOSE)]
    ]
    assert (events[0].header.stamp.sec, events[0].header.stamp.nanosec) == (3, 0)
    assert list(states[-1].closed) == ["floor"]
    assert states[-1].position[0] == 0.0
    assert truth[-1].position[0] == 0.0


def test_a_reset_of_the_plant_is_a_new_episode(ros_environment: dict[str, str]) -> None:
    """The service answers with the episode and the new epoch."""
    arguments = ros_arguments({"model": "three_mass"})
    with running_node("plant", arguments, ros_environment), spinning() as spinner:
        truth: list[JointState] = []
        seen = qos_profile(Quality(depth=1000))
        spinner.probe.create_subscription(JointState, "plant/joint_states", truth.append, seen)
        spinner.until(lambda: truth)
        response = spinner.call(Trigger, "plant/reset")
        assert response.success
        assert response.message.startswith("episode 1, epoch ")


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("plant", signal.SIGINT),
        ("observer", signal.SIGINT),
        ("observer", signal.SIGTERM),
        ("monitor", signal.SIGINT),
    ],
)
def test_a_signal_ends_a_node_with_exit_code_0(
    ros_environment: dict[str, str], name: str, how: signal.Signals
) -> None:
    """Ctrl-C prints no traceback."""
    arguments = ros_arguments({"model": "two_mass"})
    with (
        running_node(name, arguments, ros_environment) as process,
        spinning() as spinner,
    ):
        spinner.until(lambda: name in spinner.probe.get_node_names())
        spinner.settle()
        code, errors = interrupt(process, how)
    assert code == 0
    assert "Traceback" not in errors


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
        ("observer", {"model": "two_mass", "use_sim_time": "banana"}, "use_sim_time"),
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
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """ROS ignores such parameters, on the command line and in files, also beside an empty list."""
    file = tmp_path / "parameters.yaml"
    text = "/**: {ros__parameters: {estimate_parameters: [], sensor: {jitter: 1.0}}}\n"
    file.write_text(f"{text}plant: {{ros__parameters: {{step: 1.0}}}}\n", encoding="utf-8")
    arguments = ros_arguments({"model": "two_mass", "lwa": "kinematic", "observer:rat": 1.0})
    arguments += ["-p", "monitor:laws:=x", "--params-file", str(file)]
    with (
        running_node("observer", arguments, ros_environment) as process,
        spinning() as spinner,
    ):
        statuses: dict[str, DiagnosticStatus] = {}
        spinner.probe.create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda array: statuses.update({each.name: each for each in array.status}),
            qos_profile(STATES),
        )
        name = "/observer: node"
        spinner.until(lambda: name in statuses)
        code, errors = interrupt(process)
    assert code == 0
    status = statuses[name]
    assert status.level == DiagnosticStatus.WARN
    assert "parameter lwa does not exist and is ignored; expected " in status.message
    unknown = re.findall(r"parameter (\S+) does not exist", errors)
    assert unknown == ["lwa", "rat", "sensor.jitter"]
