# SPDX-License-Identifier: Apache-2.0
"""How contacts rebound: one file a law, and one line here."""

from impact_observer.model.rebounds.constant_restitution import ConstantRestitution
from impact_observer.model.rebounds.power_law import PowerLaw
from impact_observer.model.rebounds.rebound_law import ReboundLaw

LAWS: tuple[type[ReboundLaw], ...] = (ConstantRestitution, PowerLaw)
"""The laws in the order in which ``read_rebound`` asks them; the last one takes all contacts."""
REBOUND_UNITS = {kind: unit for law in reversed(LAWS) for kind, unit in law.units.items()}
"""Kinds of parameters of rebound laws, and their SI units; empty for a ratio."""


def read_rebound(key: str, restitution: float | dict[str, float]) -> ReboundLaw:
    """The rebound law by the ``restitution`` of a contact in a model file, at the ``key``.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    found = (law.read(key, restitution) for law in LAWS)
    return next(law for law in found if law is not None)


__all__ = ["LAWS", "REBOUND_UNITS", "ReboundLaw", "read_rebound"]
