# SPDX-License-Identifier: Apache-2.0
"""Memory of an observer node after a million events: ``./dev bench memory``.

    ./dev bench memory --events 20000      # the quick way

The node is in this process and receives the events on its topic, with an estimate for each, as
fast as it can: its clock is set. The memory of the process is printed on the way. After the first
tenth, when all buffers and the history are full, it must not grow any more.
"""

import argparse
import itertools
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import rclpy
from impact_observer_msgs.msg import EventVerdict, ImpactEvent
from rclpy.clock import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.time import Time
from rich.console import Console
from rich.progress import Progress

from benchmarks.topic import take_domain
from impact_observer.events import ImpactEvent as Event
from impact_observer.events import Switch
from impact_observer.io.interfaces import EVENTS
from impact_observer.observer import law_names
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.qos import qos_profile

EPOCH = 1_000_000_000
RATE = 25
PERIOD = 1_000_000_000 // RATE
"""Between events, ns, as between estimates."""
TOGETHER = 5
"""Events between two settings of the clock."""
MOST_GROWTH = 2.0
"""After the first tenth, MB."""
_PAGE = os.sysconf("SC_PAGE_SIZE")


class Rig:
    """An observer node, a publisher of events, and the node's clock."""

    def __init__(self) -> None:
        """Make the node."""
        self._node = ObserverNode()
        self._probe = Node("probe", use_global_arguments=False)
        self._executor = SingleThreadedExecutor()
        for node in (self._node, self._probe):
            self._executor.add_node(node)
        quality = qos_profile(EVENTS)
        self._impacts = self._probe.create_publisher(ImpactEvent, "impacts", quality)
        self._probe.create_subscription(
            EventVerdict, "observer/verdicts", self._count, qos_profile(EVENTS)
        )
        self._sent = self.received = 0
        self._until(self._impacts.get_subscription_count)

    def send(self, count: int) -> None:
        """Publish ``count`` events and wait for a verdict on each."""
        for _ in range(count):
            self._sent += 1
            event = Event(EPOCH + self._sent * PERIOD, (Switch("stop"),), self._sent, epoch=EPOCH)
            self._impacts.publish(ros_messages().event(event))
            if self._sent % TOGETHER == 0:
                now = Time(nanoseconds=event.stamp, clock_type=ClockType.ROS_TIME)
                self._node.get_clock().set_ros_time_override(now)
                self._until(lambda: self.received >= self._sent)

    def close(self) -> None:
        """Destroy the nodes."""
        self._executor.shutdown()
        for node in (self._node, self._probe):
            node.destroy_node()

    def _count(self, _: EventVerdict) -> None:
        self.received += 1

    def _until(self, condition: Callable[[], object]) -> None:
        while not condition():
            self._executor.spin_once(0.1)


@contextmanager
def rig(law: str = "geometric") -> Iterator[Rig]:
    """A rig, with ROS started before and shut down after it."""
    parameters = {"model": "two_mass", "use_sim_time": "true", "law": law, "rate": f"{RATE}.0"}
    given = [
        ("-p", f"{name}:={value}") for name, value in {**parameters, "future": "1.0e6"}.items()
    ]
    quiet = ["--log-level", "observer:=error"]  # this logger alone: levels outlive a context
    rclpy.init(args=["--ros-args", *quiet, *itertools.chain(*given)])
    try:
        made = Rig()
        try:
            yield made
        finally:
            made.close()
    finally:
        rclpy.try_shutdown()


def occupied() -> float:
    """Memory of this process, MB."""
    pages = Path("/proc/self/statm").read_text("utf-8").split()[1]
    return int(pages) * _PAGE / 1e6


def main(args: Sequence[str] | None = None) -> int:
    """Send the events and print the memory of the process.

    Returns:
        0; 1 when it grows.
    """
    parser = argparse.ArgumentParser(prog="./dev bench memory", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--events", type=int, default=1_000_000, metavar="N")
    parser.add_argument("--law", default="geometric")
    given = parser.parse_args(args)
    if given.events < 100:
        parser.error(f"argument --events: {given.events}; expected 100 or more")
    if given.law not in law_names():
        parser.error(f"argument --law: {given.law}; there are {', '.join(law_names())}")
    tenth, found = given.events // 10, list[float]()
    with take_domain(), rig(given.law) as made, Progress(console=Console(stderr=True)) as progress:
        for _ in progress.track(range(10), description="events"):
            made.send(tenth)
            found.append(occupied())
            print(f"{made.received:9} events: {found[-1]:.1f} MB", flush=True)
    growth = found[-1] - found[0]
    print(f"grown by {growth:.2f} MB since the first tenth; allowed: {MOST_GROWTH:g} MB")
    return 0 if growth <= MOST_GROWTH else 1


if __name__ == "__main__":
    sys.exit(main())
