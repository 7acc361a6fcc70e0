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

"""What every node's process begins with."""

import os

import pytest

pytest.importorskip("rclpy")

from impact_observer.ros.node_process import run_node


@pytest.mark.parametrize(("given", "wanted"), [(None, "1"), ("3", "3")])
def test_small_matrices_have_one_thread_unless_the_environment_has_more(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    given: str | None,
    wanted: str,
) -> None:
    """The variable is set before the node's module, and with it numpy, is imported."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", given or "")
    if given is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    assert run_node("node", "impact_observer.ros.no_such_node", "Node", []) == 1
    assert "unforeseen ModuleNotFoundError" in capsys.readouterr().err
    assert os.environ["OPENBLAS_NUM_THREADS"] == wanted
