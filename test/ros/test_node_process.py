# SPDX-License-Identifier: Apache-2.0
"""The environment of the process of every node."""

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
