# SPDX-License-Identifier: Apache-2.0
"""Statuses for ``/diagnostics``."""

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue


def diagnostic_status(
    name: str, level: bytes, message: str, values: Mapping[str, object], *, hardware: str
) -> DiagnosticStatus:
    """A status called ``name`` of some ``hardware``, with the texts of ``values``."""
    return DiagnosticStatus(
        level=level,
        name=name,
        message=message,
        hardware_id=hardware,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )
