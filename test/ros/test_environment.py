# SPDX-License-Identifier: Apache-2.0
"""The environment variables of ROS, with processes: what ROS would ignore is one line."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from processes import PATIENCE, interrupt, ros_arguments, running_node

from impact_observer.ros.environment import security_warning

pytestmark = pytest.mark.ros

NODE = [sys.executable, "-m", "impact_observer.ros.entry", "monitor", "--ros-args"]
RECORD = [sys.executable, "-m", "impact_observer", "record", "-o", "bag"]
ENABLE, STRATEGY = "ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY"
KEYSTORE = "ROS_SECURITY_KEYSTORE"
MODEL = ["-p", "model:=two_mass"]
REFUSED = [
    ({ENABLE: "TRUE"}, f"{ENABLE}: TRUE found; expected true, false or empty"),
    ({ENABLE: "1", STRATEGY: "Enforce"}, f"{ENABLE}: 1 found; expected true"),
    ({ENABLE: "true"}, f"{STRATEGY}: nothing found with {ENABLE}=true; expected Enforce"),
    ({ENABLE: "true", STRATEGY: "enforce"}, f"{STRATEGY}: enforce found with"),
    ({ENABLE: "true", STRATEGY: "Enforce"}, f"{KEYSTORE}: nothing found; expected the folder"),
    (
        {ENABLE: "true", STRATEGY: "Enforce", KEYSTORE: "keys"},
        f"{KEYSTORE}: keys has no enclave /rig; expected one (--enclave NAME)",
    ),
    ({"RMW_IMPLEMENTATION": "rmw_none_cpp"}, "RMW_IMPLEMENTATION: rmw_none_cpp found; expected"),
    ({"RCL_ASSERT_RMW_ID_MATCHES": "none"}, "RCL_ASSERT_RMW_ID_MATCHES: none found; expected"),
    ({"ROS_LOG_DIR": "/proc/none"}, "the log of ROS: Failed to create log directory '/proc/none'"),
]


def test_what_ros_would_ignore_is_one_line_and_exit_code_2(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """Of a node and, in two cases, of a command; all processes run at the same time."""
    started = [
        (
            line.replace("/rig", "/rig" if command is NODE else "/"),
            subprocess.Popen(
                [*command, *(["--enclave", "/rig", *MODEL] if command is NODE else [])],
                env=ros_environment | given,
                cwd=tmp_path,
                stderr=subprocess.PIPE,
                text=True,
            ),
        )
        for command, refused in ((NODE, REFUSED), (RECORD, REFUSED[-4::3]))
        for given, line in refused
    ]
    for line, process in started:
        _, errors = process.communicate(timeout=PATIENCE)
        assert (process.returncode, errors.count("\n")) == (2, 1), errors
        assert line in errors
    assert not (tmp_path / "bag").exists()


def test_a_node_without_enforced_security_runs_and_says_so(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """A warning says that no enclave was found; warnings of libraries end no process."""
    given = {ENABLE: "true", STRATEGY: "Permissive", KEYSTORE: str(tmp_path)}
    environment = ros_environment | given | {"PYTHONWARNINGS": "error"}
    with running_node("monitor", ros_arguments({"model": "two_mass"}), environment) as process:
        assert process.stderr is not None
        said = next(line for line in process.stderr if STRATEGY in line)
        assert interrupt(process)[0] == 0
    found = f"{KEYSTORE}: {tmp_path} has no enclave /; expected one"
    assert f"Permissive enforces no security; this node runs without: {found}" in said


def test_an_enclave_is_found_by_the_rules_of_ros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the last ``--enclave``, or the variable that overrides the argument."""
    (tmp_path / "enclaves" / "rig" / "one").mkdir(parents=True)
    for name, value in {ENABLE: "true", STRATEGY: "Permissive", KEYSTORE: str(tmp_path)}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("ROS_SECURITY_ENCLAVE_OVERRIDE", raising=False)
    args = ["--ros-args", "--enclave", "/other", "-e", "/rig/one"]
    assert "has found its enclave" in security_warning(args)
    assert "runs without" in security_warning(args[:3])
    monkeypatch.setenv("ROS_SECURITY_ENCLAVE_OVERRIDE", "/rig/one")
    assert "has found its enclave" in security_warning(args[:3])
    monkeypatch.setenv(STRATEGY, "Enforce")
    assert not security_warning(args[:3])
    for off in ("", "false"):
        monkeypatch.setenv(ENABLE, off)
        assert not security_warning([])
