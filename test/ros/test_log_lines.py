# SPDX-License-Identifier: Apache-2.0
"""What a node logs of events that come again and again."""

import pytest

pytest.importorskip("rclpy")


from impact_observer.ros.log_lines import LogLines


class Logger:
    """Keeps what is logged."""

    def __init__(self) -> None:
        """Nothing so far."""
        self.lines: list[str] = []

    def warning(self, line: str) -> None:
        """Keep it."""
        self.lines.append(line)

    info = error = warning


def test_lines_of_one_kind_are_logged_once_and_then_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As of chatter; other kinds, and lines of none, are logged meanwhile."""
    logger, now = Logger(), [100.0]
    monkeypatch.setattr("impact_observer.ros.log_lines.time.monotonic", lambda: now[0])
    lines = LogLines(logger)
    for k in range(5):
        lines.warning(f"event {k}: rejected, spurious", "rejected, spurious")
        lines.restore()
        now[0] += 1.0
    lines.warning("event 9: inserted", "inserted")
    lines.error("a fault")
    assert logger.lines == ["event 0: rejected, spurious", "event 9: inserted", "a fault"]
    now[0] += 10.0
    lines.restore()
    assert logger.lines[3:] == ["rejected, spurious: 4 more in 10 s"]
    lines.warning("event 11: rejected, spurious", "rejected, spurious")
    assert logger.lines[4:] == ["event 11: rejected, spurious"]


def test_strangers_cannot_make_a_log_of_many_kinds() -> None:
    """Whatever contacts they name: beyond a hundred all are one kind."""
    logger = Logger()
    lines = LogLines(logger)
    for k in range(1000):
        lines.warning(f"unknown contact {k}", f"contact {k}")
        lines.restore()
    assert logger.lines == [f"unknown contact {k}" for k in range(101)]
