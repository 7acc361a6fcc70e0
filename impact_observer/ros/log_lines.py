"""Lines of a node's log, so many at a time: a flood of messages is no flood of lines."""

from rclpy.impl.rcutils_logger import RcutilsLogger

from impact_observer.plain_text import printable

_MOST = 20
"""Lines between two calls of ``restore``."""


class LogLines:
    """Logs up to a number of lines, and then how many were left out."""

    def __init__(self, logger: RcutilsLogger) -> None:
        """Log to ``logger``."""
        self._logger = logger
        self._count = 0

    def error(self, line: str) -> None:
        """Log an error."""
        if self._has_room():
            self._logger.error(printable(line))

    def warning(self, line: str) -> None:
        """Log a warning."""
        if self._has_room():
            self._logger.warning(printable(line))

    def info(self, line: str) -> None:
        """Log what is usual."""
        if self._has_room():
            self._logger.info(printable(line))

    def restore(self) -> None:
        """Begin to count again, as after a second."""
        if self._count > _MOST:
            self._logger.warning(f"{self._count - _MOST} more lines are left out of this log")
        self._count = 0

    def _has_room(self) -> bool:
        self._count += 1
        return self._count <= _MOST
