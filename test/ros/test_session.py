# SPDX-License-Identifier: Apache-2.0
"""The checks of a process that uses ROS, and the errors that do not end the process."""

import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

pytest.importorskip("rclpy")

from processes import refusal, spinning
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from impact_observer.errors import DynamicsError, UsageError
from impact_observer.options import Option
from impact_observer.ros import parameters
from impact_observer.ros.base_node import BaseNode, spin_once
from impact_observer.ros.session import require_ros

ALONE = (Option("autostart", False, "nothing begins by itself"),)


class IdleNode(BaseNode):
    """A node that does nothing."""

    def configure(self) -> None:
        """Make nothing."""


@pytest.mark.parametrize(
    ("enable", "strategy", "line"),
    [
        ("TRUE", "Enforce", "ROS_SECURITY_ENABLE: TRUE found"),
        ("1", "", "ROS_SECURITY_ENABLE: 1 found"),
        ("true", "", "ROS_SECURITY_STRATEGY: nothing found with ROS_SECURITY_ENABLE=true"),
        ("true", "enforce", "ROS_SECURITY_STRATEGY: enforce found"),
        ("true", "Permissive", "ROS_SECURITY_STRATEGY: Permissive found"),
    ],
)
def test_security_that_ros_would_not_enforce_is_refused(
    monkeypatch: pytest.MonkeyPatch, enable: str, strategy: str, line: str
) -> None:
    """ROS would run without security, and without a message."""
    monkeypatch.setenv("ROS_SECURITY_ENABLE", enable)
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", strategy)
    with pytest.raises(UsageError, match=line):
        require_ros()


@pytest.mark.parametrize("enable", ["", "false", "true"])
def test_security_is_not_asked_for_or_enforced(
    monkeypatch: pytest.MonkeyPatch, enable: str
) -> None:
    """Nothing is refused here; ROS refuses a node without an enclave."""
    monkeypatch.setenv("ROS_SECURITY_ENABLE", enable)
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    require_ros()
    assert "rclpy" in sys.modules


@pytest.mark.ros
def test_an_error_is_noted_unless_the_node_ends_by_it(
    ros_environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as of rclpy, for a time on ``/clock`` that is none."""
    assert ros_environment
    noted: list[Exception] = []
    with spinning():
        executor = SingleThreadedExecutor()
        for error in (ValueError("must not be negative"), DynamicsError("no motion")):
            monkeypatch.setattr(executor, "spin_once", Mock(side_effect=error))
            spin_once(executor, noted.append, ())
            assert noted.pop() is error
        with pytest.raises(DynamicsError):
            spin_once(executor, noted.append, (DynamicsError,))
        executor.shutdown()


@pytest.mark.ros
def test_a_whole_number_is_a_double_and_a_list_is_not(ros_environment: dict[str, str]) -> None:
    """``-p rate:=100`` is meant as 100.0; ``[]`` is refused in one line."""
    assert ros_environment
    table = (Option("rate", 1.0, "a rate", "Hz", low=0.1, high=1000.0),)
    with spinning(["--ros-args", "-p", "one:rate:=100", "-p", "two:rate:=[]"]) as spinner:
        one, two = Node("one"), Node("two")
        spinner.add(one)
        spinner.add(two)
        value = parameters.declare(one, table)["rate"]
        assert (value, type(value)) == (100.0, float)
        with pytest.raises(UsageError, match="parameter rate: "):
            parameters.declare(two, table)


@pytest.mark.ros
def test_a_node_that_cannot_be_secure_says_so_and_ends(
    ros_environment: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    """The middleware has no security libraries, as in the wheels, or the node has no key."""
    assert ros_environment
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", str(tmp_path))
    (tmp_path / "enclaves").mkdir()
    line = refusal("monitor", ["--ros-args", "-p", "model:=two_mass"], capfd)
    assert line.startswith("monitor: ROS: ")


@pytest.mark.ros
def test_a_node_that_has_the_name_of_another_one_says_so(
    ros_environment: dict[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    """Messages of two nodes of one name would be merged unnoticed."""
    assert ros_environment
    with spinning() as spinner:
        node = IdleNode("observer", ALONE)
        spinner.add(node)
        node.warn_of_surroundings()
        assert "are called" not in "".join(capfd.readouterr())
        spinner.add(IdleNode("observer", ALONE))
        names = spinner.probe.get_node_names
        spinner.until(lambda: names().count("observer") == 2)
        node.warn_of_surroundings()
        assert "2 nodes are called /observer: their messages" in "".join(capfd.readouterr())
