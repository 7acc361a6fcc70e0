# SPDX-License-Identifier: Apache-2.0
"""The log lines of every node, and items that are stamped ahead of the clock."""

import pytest

pytest.importorskip("rclpy")


from impact_observer.ros.base_node import LogLines
from impact_observer.ros.intake import ClockGate
from impact_observer.stamps import NS_PER_S


class Logger:
    """Keeps the lines that are logged."""

    def __init__(self) -> None:
        """Begin without a line."""
        self.lines: list[str] = []

    def warning(self, line: str) -> None:
        """Keep a line."""
        self.lines.append(line)

    info = error = warning


def test_lines_of_one_kind_are_logged_once_and_then_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Lines that differ in numbers only are of one kind; other kinds are logged meanwhile."""
    logger, now = Logger(), [100.0]
    monkeypatch.setattr("impact_observer.ros.base_node.time.monotonic", lambda: now[0])
    lines = LogLines(logger)
    for k in range(5):
        lines.warning(f"event {k}: rejected, spurious", "rejected, spurious")
        lines.error(f"fault {k / 7} of 9")
        lines.end_second()
        now[0] += 1.0
    lines.info("event 9: inserted", "inserted")
    assert logger.lines == ["event 0: rejected, spurious", "fault 0.0 of 9", "event 9: inserted"]
    now[0] += 10.0
    lines.end_second()
    assert logger.lines[3:] == [
        "rejected, spurious: 4 more in 10 s",
        "fault N of N: 4 more in 10 s",
    ]
    lines.warning("event 11: rejected, spurious", "rejected, spurious")
    assert logger.lines[5:] == ["event 11: rejected, spurious"]


def test_strangers_cannot_make_a_log_of_many_kinds() -> None:
    """Contacts may have any name: beyond twenty kinds all lines are of one kind."""
    logger = Logger()
    lines = LogLines(logger)
    for k in range(1000):
        lines.warning(f"unknown contact {k}", f"contact {k}")
        lines.end_second()
    assert logger.lines == [f"unknown contact {k}" for k in range(21)]


def test_items_wait_for_the_clock_in_order_and_the_farthest_has_no_room() -> None:
    """Items of one stamp come in the order in which they were kept; without a clock none."""
    now = [0]
    gate = ClockGate[str](lambda: now[0], 1.0, 3)
    given = [(5, "e"), (3, "c"), (5, "f"), (9, "i"), (4, "d")]
    assert all(gate.reason(stamp * NS_PER_S) for stamp, _ in given)
    kept = [gate.keep(stamp * NS_PER_S, item) for stamp, item in given]
    assert kept == [None, None, None, "i", "f"]
    found = list[list[str]]()
    for second in (0, 1, 2, 8):
        now[0] = second * NS_PER_S
        found.append([*gate.near()])
    assert found == [[], [], ["c"], ["d", "e"]]
    gate.keep(NS_PER_S, "a")
    gate.clear()
    assert not [*gate.near()]
