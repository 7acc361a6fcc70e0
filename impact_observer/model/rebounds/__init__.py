# SPDX-License-Identifier: Apache-2.0
"""How contacts rebound: one file a law, and one line here."""

from impact_observer.model.document import Section
from impact_observer.model.rebounds.constant_restitution import ConstantRestitution
from impact_observer.model.rebounds.power_law import PowerLaw
from impact_observer.model.rebounds.rebound_law import ReboundLaw

LAWS: tuple[type[ReboundLaw], ...] = (
    PowerLaw,
    ConstantRestitution,
)
"""The laws in the order in which ``read_rebound`` asks them; the last one takes all contacts."""
REBOUND_KEYS = ("restitution", *(key for law in LAWS for key in law.keys))
"""Keys of a contact in a model file that tell how the contact rebounds."""
REBOUND_UNITS = {kind: unit for law in reversed(LAWS) for kind, unit in law.units.items()}
"""Kinds of parameters of rebound laws, and their SI units; empty for a ratio."""


def read_rebound(contact: Section) -> ReboundLaw:
    """The rebound law of a ``contact`` of a model file.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    found = (law.read(contact) for law in LAWS)
    return next(law for law in found if law is not None)


__all__ = ["LAWS", "REBOUND_KEYS", "REBOUND_UNITS", "ReboundLaw", "read_rebound"]
