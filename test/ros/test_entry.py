# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

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
    """With the names of those there are."""
    with pytest.raises(SystemExit):
        entry.main(["planet"])
    assert "invalid choice: 'planet'" in capsys.readouterr().err
