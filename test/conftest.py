"""What tests of several rooms need."""

import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture
def ros_environment(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, str]]:
    """An environment with a ROS domain of its own, which this process gets too."""
    pytest.importorskip("rclpy")
    pytest.importorskip("impact_observer_msgs")
    for domain in range(1, 102):
        lock = Path(tempfile.gettempdir(), f"impact_observer_domain_{domain}.lock")
        with lock.open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
            monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            yield dict(os.environ)
            return
    pytest.fail("all ROS domains are taken; remove impact_observer_domain_*.lock")
