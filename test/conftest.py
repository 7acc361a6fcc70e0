# SPDX-License-Identifier: Apache-2.0
"""What tests of several rooms need."""

import gc
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from systems import examples

from benchmarks.domain import free_domain
from impact_observer.events import ImpactEvent, Switch
from impact_observer.resources import shared
from impact_observer.states import Estimate


def pytest_configure() -> None:
    """Forget the shell's width, and that it ignores signals for what it runs in the background.

    Tests that hypothesis draws examples for have no deadline, on a busy machine neither.
    """
    gc.disable()  # until all tests are collected
    settings.register_profile("test", parent=examples(100))
    settings.load_profile("test")
    os.environ.pop("COLUMNS", None)  # pytest-xdist sets it
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGQUIT, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What is long is slow."""
    for item in items:
        if item.get_closest_marker("long"):
            item.add_marker("slow")


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over all that is there already: a twentieth of the time."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture
def in_tmp_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make ``tmp_path`` the working folder, so that messages name files in it briefly."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def ros_environment(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, str]]:
    """An environment with a ROS domain of its own, which this process gets too."""
    pytest.importorskip("rclpy")
    pytest.importorskip("impact_observer_msgs")
    with free_domain() as environment:
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        yield dict(os.environ)


@pytest.fixture(scope="session")
def first_sample_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``sample_bag`` is a copy of."""
    # Not at the top: the tests of the core run without rosbags.
    from impact_observer.io import BagWriter, JointState
    from impact_observer.io.messages import bag_messages

    make, names = bag_messages(), ("x1", "x2")
    provenance = "\nprovenance: {package: impact_observer, version: 1.2.3, seed: 7}\n"
    text = shared("config/two_mass.yaml").read_text("utf-8") + provenance
    path = tmp_path_factory.mktemp("first") / "sample"
    with BagWriter(path) as writer:
        writer.write("/plant/model", 1_000_000_000, make.model(text))
        for k in range(51):
            stamp = 1_000_000_000 + k * 10_000_000
            q, u = np.array([k, -k]) * 0.5, np.array([1.0, k])
            state, estimate = JointState(stamp, names, q, u), Estimate(stamp, "geometric", q, u)
            if k % 5 == 0:
                event = ImpactEvent(stamp, (Switch("stop"),), k // 5 + 1, 1, 1_000_000_000)
                writer.write("/impacts", stamp, make.event(event))
            writer.write("/plant/joint_states", stamp, make.joint_state(state))
            writer.write("/observer_geometric/state", stamp, make.estimate(estimate, names))
    return path


@pytest.fixture
def sample_bag(first_sample_bag: Path, tmp_path: Path) -> Path:
    """Half a second of truth, impacts, model and an estimate, from 1 s on."""
    return Path(shutil.copytree(first_sample_bag, tmp_path / "sample"))
