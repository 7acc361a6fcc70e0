# SPDX-License-Identifier: Apache-2.0
"""The module that starts the nodes."""

import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from rclpy.node import Node

from impact_observer.ros import entry
from impact_observer.ros.parameters import TABLES

SETUP = Path(__file__).parents[2] / "setup.py"


def test_every_executable_is_a_node_of_the_table() -> None:
    """setup.py installs a function of that name, and the class exists."""
    installed = re.findall(r"(\w+) = impact_observer\.ros\.entry:(\w+)", SETUP.read_text("utf-8"))
    assert installed == [(name, name) for name in entry.NODES]
    for name, node_class in entry.NODES.items():
        assert callable(getattr(entry, name))
        module = import_module(f"impact_observer.ros.{name}_node")
        assert issubclass(getattr(module, node_class), Node)


@pytest.mark.parametrize("name", entry.NODES)
@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_help_of_a_node_has_its_parameters(
    name: str, flag: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each with its type and meaning; no node starts."""
    assert getattr(entry, name)([flag]) == 0
    shown, errors = capsys.readouterr()
    assert shown.startswith(f"usage: {name} --ros-args -p PARAMETER:=VALUE ")
    assert errors == ""
    for each in TABLES[name]:
        assert f"\n  {each.name} ({each.type})\n      {each.meaning[:30]}" in shown
    assert max(map(len, shown.splitlines())) < 100


def test_the_installed_executables_give_help() -> None:
    """The same, without ROS arguments, as a user types it."""
    command = [str(Path(sys.executable).parent / "observer"), "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("usage: observer --ros-args")


def test_an_unknown_node_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """The error has the names of the known nodes."""
    with pytest.raises(SystemExit):
        entry.main(["planet"])
    assert "invalid choice: 'planet'" in capsys.readouterr().err
