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

"""What a thousand live inputs a second cost an observer node, against a bare node.

The processor time of the node's process while they arrive, less that of the same process without
them, over the samples. The bare node, which this module is when it is run, subscribes to the same
topic and does nothing with them. The observer publishes estimates at its usual rate meanwhile.
"""

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from benchmarks.harness import Benchmark, Contest, DisagreementError, Goal, Metrics, SkippedError
from benchmarks.topic import running, take_domain
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io.interfaces import EVENTS, FORCING
from impact_observer.stamps import NS_PER_S

RATE = 1000.0
IDLE, BUSY = 4.0, 10.0
"""Without and with inputs, s."""
PATIENCE = 20.0
"""For discovery, s."""
BARE = "bare rclpy node"
MODEL = """\
name: driven
bodies: [{name: x1, mass: 1}, {name: x2, mass: 1}]
springs:
  - {between: [ground, x1], stiffness: 10, damping: 0.1}
  - {between: [x1, x2], stiffness: 10, damping: 0.1}
forces: [{body: x2, input: motor}]
stops: [{name: stop, body: x2, limit: 0.5, side: above, restitution: 0.7}]
"""
_BARE = ("benchmarks.live_inputs",)


def prepare(folder: Path) -> Contest:
    """Check that ROS is installed, and write the model."""
    for package in ("rclpy", "impact_observer_msgs"):
        if find_spec(package) is None:
            raise SkippedError(f"no {package} here: source Jazzy, or ./dev setup")
    model = folder / "driven.yaml"
    model.write_text(MODEL, encoding="utf-8")
    observer = ("impact_observer.ros.entry", "observer", "--ros-args", "-p", f"model:={model}")

    def measured(_: Path, command: tuple[str, ...]) -> Metrics:
        with take_domain(), running(command) as process, _publishing() as publish:
            return {"sample": _cost(process, publish)}

    return Contest(
        f"an input at {RATE:g} Hz, {BUSY:g} s, law geometric; each round in a new process",
        partial(measured, command=observer),
        {BARE: partial(measured, command=_BARE)},
        units={"sample": "s"},
    )


class _Publisher:
    """Publishes an event, and samples of the input."""

    def __init__(self) -> None:
        from impact_observer_msgs.msg import ImpactEvent as Message  # noqa: PLC0415 (ROS only)
        from rclpy.context import Context  # noqa: PLC0415
        from rclpy.node import Node  # noqa: PLC0415
        from sensor_msgs.msg import JointState  # noqa: PLC0415

        from impact_observer.ros.message_classes import ros_messages  # noqa: PLC0415
        from impact_observer.ros.qos import qos_profile  # noqa: PLC0415

        self._context = Context()
        self._context.init(args=[])
        self._node = Node("driver", context=self._context)
        self._events = self._node.create_publisher(Message, "impacts", qos_profile(EVENTS))
        quality = qos_profile(FORCING.quality)
        self._inputs = self._node.create_publisher(JointState, FORCING.name, quality)
        self._sample = JointState(name=["motor"], effort=[0.0])
        self._make = ros_messages()

    def meet(self) -> None:
        """Wait for the node, and say where time begins."""
        end = time.monotonic() + PATIENCE
        while not self._inputs.get_subscription_count():
            if time.monotonic() > end:
                raise DisagreementError(f"no subscription within {PATIENCE:g} s")
            time.sleep(0.05)
        now = time.time_ns()
        event = ImpactEvent(now, (Switch("stop"),), 1, epoch=now - NS_PER_S)
        self._events.publish(self._make.event(event))

    def samples(self, seconds: float) -> int:
        """Publish samples at their rate; how many."""
        begin, count = time.monotonic(), round(seconds * RATE)
        for k in range(count):
            time.sleep(max(begin + k / RATE - time.monotonic(), 0.0))
            stamp = self._sample.header.stamp
            stamp.sec, stamp.nanosec = divmod(time.time_ns(), NS_PER_S)
            self._sample.effort[0] = k % 7 - 3.0
            self._inputs.publish(self._sample)
        return count

    def close(self) -> None:
        """Leave the domain."""
        self._node.destroy_node()
        self._context.try_shutdown()


@contextmanager
def _publishing() -> Iterator[_Publisher]:
    publisher = _Publisher()
    try:
        publisher.meet()
        yield publisher
    finally:
        publisher.close()


def _cost(process: "subprocess.Popen[bytes]", publisher: _Publisher) -> float:
    """Processor time of the process by a sample, s."""
    publisher.samples(1.0)
    before = _used(process.pid)
    time.sleep(IDLE)
    idle = (_used(process.pid) - before) / IDLE
    before, begin = _used(process.pid), time.monotonic()
    count = publisher.samples(BUSY)
    time.sleep(0.2)  # the last ones
    busy = _used(process.pid) - before
    return (busy - idle * (time.monotonic() - begin)) / count


def _used(pid: int) -> float:
    """Processor time of a process so far, s."""
    text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    user, system = text.rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """The bare node."""
    import rclpy  # noqa: PLC0415 (ROS only)
    from rclpy.signals import SignalHandlerOptions  # noqa: PLC0415
    from sensor_msgs.msg import JointState  # noqa: PLC0415

    from impact_observer.ros.qos import qos_profile  # noqa: PLC0415

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # a signal ends it
    node = rclpy.create_node("bare")
    node.create_subscription(
        JointState, FORCING.name, lambda _: None, qos_profile(FORCING.quality)
    )
    rclpy.spin(node)


BENCHMARK = Benchmark(
    "live",
    "what do a thousand live inputs a second cost a node?",
    prepare,
    (Goal(1.3, BARE, "sample"),),
    rounds=5,
)


if __name__ == "__main__":
    main()
