# SPDX-License-Identifier: Apache-2.0
"""The robot in a model file."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from msgspec import UnsetType

from impact_observer.errors import ModelError
from impact_observer.model.document import check_names, vector
from impact_observer.model.files_beside import file_beside
from impact_observer.model.linear_model import smooth_forcing
from impact_observer.model.rebounds import read_rebound
from impact_observer.model.robot_description import PlaneContact, RobotDescription, one_of_each
from impact_observer.model.schema import RobotContact, RobotModel, TopicKeys
from impact_observer.model.urdf_file import Urdf
from impact_observer.resources import read_text
from impact_observer.states import Vector


def read_robot(model: RobotModel, folder: Path | None) -> RobotDescription:
    """The robot in a model file; ``folder`` is where its other files lie.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    check_names("joints", model.joints)
    joints, urdf = tuple(model.joints), _urdf(model.urdf, folder)
    forcing = smooth_forcing(model.forcing, joints, folder, one_of_each(joints, urdf))
    return RobotDescription(
        name=model.name,
        joints=joints,
        urdf=urdf,
        topic=model.urdf.topic if isinstance(model.urdf, TopicKeys) else "",
        held=model.held,
        own_damping=_of_joints("damping", model.damping, joints, urdf),
        rotor_inertia=_of_joints("rotor_inertia", model.rotor_inertia, joints, urdf),
        contacts=tuple(_contact(f"contacts[{i}]", c) for i, c in enumerate(model.contacts)),
        forces=None if isinstance(model.forces, UnsetType) else (model.forces.topic, "effort"),
        torque_deviation=_torque_deviation(model.torque_deviation, joints, urdf),
        gravity=vector("gravity", model.gravity, 3),
        forcing=forcing,
    )


def _urdf(given: str | TopicKeys, folder: Path | None) -> Urdf | None:
    """The URDF; None where it comes from a topic."""
    if isinstance(given, TopicKeys):
        return None
    if given.lstrip().startswith("<"):
        return Urdf(given, "the URDF in the model")
    return Urdf(read_text(file_beside("urdf", given, folder)), given)


def _of_joints(
    key: str, given: Mapping[str, float], joints: tuple[str, ...], urdf: Urdf | None
) -> Vector:
    """A number of each joint, zero where a joint has none, shape (n,)."""
    for name in given:
        if name not in joints:
            wanted = ", ".join(joints)
            if urdf is not None and name in urdf.movable_beside(joints):
                wanted += f", or {name} in joints, without which it is held"
            raise ModelError(f"{key}.{name}", f"is none of joints; expected some of {wanted}")
    return np.array([given.get(name, 0.0) for name in joints])


def _torque_deviation(
    given: float | Mapping[str, float] | UnsetType, joints: tuple[str, ...], urdf: Urdf | None
) -> Vector | None:
    if isinstance(given, UnsetType):
        return None
    if isinstance(given, Mapping):
        return _of_joints("torque_deviation", given, joints, urdf)
    return np.full(len(joints), given)


def _contact(key: str, contact: RobotContact) -> PlaneContact:
    return PlaneContact(
        contact.name,
        contact.frame,
        vector(f"{key}.normal", contact.normal, 3),
        contact.offset,
        read_rebound(f"{key}.restitution", contact.restitution),
    )
