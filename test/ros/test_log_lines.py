# SPDX-License-Identifier: Apache-2.0
"""The log lines of events that come again and again."""

import pytest

pytest.importorskip("rclpy")


from impact_observer.ros.log_lines import LogLines


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
    monkeypatch.setattr("impact_observer.ros.log_lines.time.monotonic", lambda: now[0])
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
