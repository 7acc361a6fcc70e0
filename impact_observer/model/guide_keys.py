# SPDX-License-Identifier: Apache-2.0
"""The key ``friction`` of a model file: guides with dry friction. Coulomb friction is refused."""

from collections.abc import Mapping

from impact_observer.errors import ModelError
from impact_observer.model.document import Section, Value

_COULOMB = (
    "is Coulomb friction at a contact, which is refused: it grows with the contact's load, so"
    " an impact can raise the distance of two replicas and no law is proved; expected friction of"
    " a force that is given, {name, between, force}"
)


def guide_section(key: str, value: Value, allowed: tuple[str, ...]) -> Section:
    """The guide in a member of ``friction``.

    Raises:
        ModelError: ``value`` is Coulomb friction, or no mapping of ``allowed`` keys.
    """
    if isinstance(value, Mapping):
        for name in ("coefficient", "contact", "stop"):
            if name in value:
                raise ModelError(f"{key}.{name}", _COULOMB)
    return Section(key, value, allowed)


def refuse_coulomb(key: str, value: Value) -> None:
    """Refuse Coulomb friction in a stop or contact.

    Raises:
        ModelError: ``value`` has the key ``friction``.
    """
    if isinstance(value, Mapping) and "friction" in value:
        raise ModelError(f"{key}.friction", _COULOMB)
