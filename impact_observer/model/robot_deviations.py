# SPDX-License-Identifier: Apache-2.0
"""How well the parameters of a robot are known: the key ``uncertainty``, and deviations."""

from collections.abc import Iterator

import numpy as np
from scipy import linalg

from impact_observer.errors import ModelError
from impact_observer.model.declared_deviations import PlainDocument
from impact_observer.model.document import Section
from impact_observer.model.parameter_places import Place, key_of
from impact_observer.model.parameter_uncertainty import (
    KEY,
    ParameterUncertainty,
    declared_uncertainty,
    named_section,
)
from impact_observer.model.robot_description import (
    DAMPING,
    RESTITUTION,
    ROTOR_INERTIA,
    RobotDescription,
)


def read_robot_uncertainty(
    section: Section, plain: PlainDocument, robot: RobotDescription
) -> ParameterUncertainty | None:
    """The uncertainty of a model file of a ``robot``; None where the file says nothing.

    Parameters have names such as ``damping.elbow``, ``rotor-inertia.elbow``, ``restitution.wall``.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    known = None
    if KEY in section:
        names, value = named_section(section)
        for i, name in enumerate(names):
            if name not in robot.parameters:
                wanted = ", ".join(robot.parameters)
                raise ModelError(
                    f"{KEY}.names[{i}]", f"{name!r} is no parameter; expected some of {wanted}"
                )
        known = declared_uncertainty(names, value)
    beside = dict(_beside(plain, robot))
    if not beside:
        return known
    if known is None:
        return ParameterUncertainty((*beside,), np.diag(np.square([*beside.values()])))
    for name in set(beside).intersection(known.names):
        raise ModelError(
            KEY, f"{name} has a deviation beside its value, too; expected one of the two"
        )
    covariance = linalg.block_diag(known.covariance, np.diag(np.square([*beside.values()])))
    return ParameterUncertainty((*known.names, *beside), covariance, known.fitted_to)


def _beside(plain: PlainDocument, robot: RobotDescription) -> Iterator[tuple[str, float]]:
    """Names and deviations of numbers that have a deviation beside them."""
    for place, deviation in plain.deviations.items():
        if (name := _name(place, robot)) not in robot.parameters:
            raise ModelError(
                key_of(place),
                "has a deviation; expected a plain number: of a robot, damping, rotor_inertia and"
                " restitution may have one",
            )
        yield name, deviation


def _name(place: Place, robot: RobotDescription) -> str:
    """The parameter at a place of the model file; empty for no parameter."""
    kinds = {"damping": DAMPING, "rotor_inertia": ROTOR_INERTIA}
    if len(place) == 2 and place[0] in kinds:
        return f"{kinds[str(place[0])]}.{place[1]}"
    in_contact = len(place) > 2 and place[0] == "contacts" and place[2] == RESTITUTION
    if in_contact and place[3:] in {(), ("value",)}:
        return f"{RESTITUTION}.{robot.contact_names[int(place[1])]}"
    return ""
