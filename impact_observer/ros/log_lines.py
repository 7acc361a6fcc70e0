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
