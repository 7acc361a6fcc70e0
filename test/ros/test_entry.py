# SPDX-License-Identifier: Apache-2.0
"""The module that starts the nodes."""

import re
from importlib import import_module
from pathlib import Path

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from rclpy.node import Node

from impact_observer.ros import entry

SETUP = Path(__file__).parents[2] / "setup.py"


def test_every_executable_is_a_node_of_the_table() -> None:
    """setup.py installs a function of that name, and the class exists."""
    installed = re.findall(r"(\w+) = impact_observer\.ros\.entry:(\w+)", SETUP.read_text("utf-8"))
    assert installed == [(name, name) for name in entry.NODES]
    for name, node_class in entry.NODES.items():
        assert callable(getattr(entry, name))
        module = import_module(f"impact_observer.ros.{name}_node")
        assert issubclass(getattr(module, node_class), Node)


def test_an_unknown_node_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """The error has the names of the known nodes."""
    with pytest.raises(SystemExit):
        entry.main(["planet"])
    assert "invalid choice: 'planet'" in capsys.readouterr().err
