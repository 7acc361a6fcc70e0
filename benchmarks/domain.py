# SPDX-License-Identifier: Apache-2.0
"""ROS domains that no test and no other benchmark on this machine uses."""

import fcntl
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.checkout import FailedError


@contextmanager
def free_domain() -> Iterator[dict[str, str]]:
    """Reserve a domain; yields the environment variables that select it.

    Raises:
        FailedError: all are taken.
    """
    for domain in range(1, 102):
        path = Path(tempfile.gettempdir(), f"impact_observer_domain_{domain}.lock")
        with path.open("w", encoding="utf-8") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            yield {
                "ROS_DOMAIN_ID": str(domain),
                "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            }
            return
    raise FailedError("all ROS domains are taken; remove impact_observer_domain_*.lock")
