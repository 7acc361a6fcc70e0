# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes, and exit codes of their processes."""

import re
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from processes import refusal, ros_arguments, spinning

from impact_observer.io.interfaces import STATES
from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.topics import qos_profile

pytestmark = pytest.mark.ros


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
