# SPDX-License-Identifier: Apache-2.0
"""A contact switch at a microcontroller on a serial line, with the stamps of the microcontroller.

The microcontroller writes a line at every edge of its switch, and ten times a second one without
a level ::

    12345678 1        its own time in microseconds, and whether the contact is closed
    12400000          its own time

This node turns them into messages on ``/switch``, stamped with the instant of the edge: the way of
the line through the operating system takes a varying time, and is taken out by ``Clock``.

    export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST  # unless detector or screen are elsewhere
    python examples/serial_switch.py /dev/ttyACM0

The entry of the detector: ``{contact: anvil, topic: /switch, kind: switch, field: range}``.
"""

import os
import sys
import time
import tty
from collections import deque
from collections.abc import Iterator

US = 1000
"""Nanoseconds in a microsecond."""
WRAP = 2**32
"""At which a 32-bit count of microseconds begins again, after 71 minutes."""
WINDOW = 10_000_000_000
"""For how long the least latency is that of the line, ns: clocks drift in longer ones."""


class Clock:
    """From a microcontroller's microseconds to stamps, by the least latency of late lines.

    A line arrives after its instant, by a latency that varies. So ``arrival - own time`` is the
    difference of the clocks and that latency, and the least of the last ten seconds has the least
    latency of these. What is left is that latency, which is nearly constant (the key ``latency``
    of the detector), and the drift of the clocks in ten seconds: 0.5 ms for 50 ppm.
    """

    def __init__(self) -> None:
        """Nothing has arrived yet."""
        self._turns, self._last = 0, 0
        self._least: deque[tuple[int, int]] = deque()  # arrivals and differences, both ascending

    def stamp(self, micros: int, arrival: int) -> int:
        """The stamp (ns) of the microcontroller's time, which arrived at ``arrival`` (ns)."""
        if micros < self._last - WRAP // 2:
            self._turns += 1
        self._last = micros
        own = (micros + self._turns * WRAP) * US
        while self._least and self._least[-1][1] >= arrival - own:
            self._least.pop()
        self._least.append((arrival, arrival - own))
        while self._least[0][0] < arrival - WINDOW:
            self._least.popleft()
        return own + self._least[0][1]


def edges(lines: Iterator[tuple[bytes, int]]) -> Iterator[tuple[int, bool]]:
    """Stamps (ns) and levels of lines with their arrival (ns); others are left out."""
    clock = Clock()
    for line, arrival in lines:
        words = line.split()
        if not 1 <= len(words) <= 2 or not all(each.isdigit() for each in words):
            continue
        stamp = clock.stamp(int(words[0]) % WRAP, arrival)
        if len(words) == 2:
            yield stamp, words[1] != b"0"


def lines_of(path: str) -> Iterator[tuple[bytes, int]]:
    """Lines of a serial device, with the time at which their end was read, ns since 1970."""
    device = os.open(path, os.O_RDONLY | os.O_NOCTTY)
    tty.setraw(device)  # the speed stays as it is: stty -F DEVICE 115200
    kept = b""
    while read := os.read(device, 256):
        now = time.time_ns()
        *whole, kept = (kept + read).split(b"\n")
        for line in whole:
            yield line, now
        kept = kept[-100:]


def main() -> None:
    """Publish until the device is gone or Ctrl-C."""
    import rclpy
    from sensor_msgs.msg import Range

    rclpy.init()
    node = rclpy.create_node("serial_switch")
    publisher = node.create_publisher(Range, "/switch", 100)
    try:
        for stamp, closed in edges(lines_of(sys.argv[1])):
            message = Range(range=float(closed))
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
            publisher.publish(message)
    except (KeyboardInterrupt, OSError) as error:
        print(f"serial_switch: {error or 'interrupted'}", file=sys.stderr)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
