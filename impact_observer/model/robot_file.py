# SPDX-License-Identifier: Apache-2.0
"""The keys of a model file of a robot."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from impact_observer.errors import ModelError
from impact_observer.model import forcing_keys
from impact_observer.model.document import Section, check_names, file_beside, number
from impact_observer.model.forcing import Forcing
from impact_observer.model.rebounds import REBOUND_KEYS, read_rebound
from impact_observer.model.robot_description import PlaneContact, RobotDescription, one_of_each
from impact_observer.model.urdf_file import Urdf
from impact_observer.resources import read_text
from impact_observer.states import Vector

ROBOT_KEYS = (
    *("urdf", "joints", "held", "damping", "rotor_inertia", "contacts", "forces"),
    *("torque_deviation", "gravity", "forcing"),
)
_URDF = "urdf"
_CONTACT_KEYS = ("name", "frame", "normal", "offset", *REBOUND_KEYS)


def read_robot(name: str, section: Section, folder: Path | None) -> RobotDescription:
    """The robot in a model file; ``folder`` is that of the URDF.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    joints = tuple(_names(section, "joints"))
    urdf, topic = _urdf(section, folder)
    contacts = [Section(*item, _CONTACT_KEYS) for item in section.items("contacts")]
    forcing = _forcing(section, joints, urdf, folder)
    document = {key: section.value(key) for key in ROBOT_KEYS if key in section}
    if urdf is not None:
        document[_URDF] = urdf.text
    if forcing.sampled is not None:
        document["forcing"] = forcing_keys.written_forcing(forcing, joints)
    return RobotDescription(
        name=name,
        joints=joints,
        urdf=urdf,
        topic=topic,
        held=_by_name(section, "held"),
        own_damping=_of_joints(section, "damping", joints, urdf),
        rotor_inertia=_of_joints(section, "rotor_inertia", joints, urdf),
        contacts=tuple(map(_contact, contacts)),
        forces=_forces(section),
        torque_deviation=_torque_deviation(section, joints, urdf),
        gravity=section.vector("gravity", 3) if "gravity" in section else np.array(_GRAVITY),
        forcing=forcing,
        document=document,
    )


_GRAVITY = (0.0, 0.0, -9.81)


def _names(section: Section, key: str) -> list[str]:
    section.value(key)
    names = [value for _, value in section.items(key)]
    check_names(key, names)
    return list(map(str, names))


def _urdf(section: Section, folder: Path | None) -> tuple[Urdf | None, str]:
    """The URDF, or None and its topic."""
    value = section.value(_URDF)
    if isinstance(value, Mapping):
        return None, Section(_URDF, value, ("topic",)).text("topic")
    if isinstance(value, str) and value.lstrip().startswith("<"):
        return Urdf(value, "the URDF in the model"), ""
    if not isinstance(value, str) or not value:
        wanted = "expected a file beside the model file, or {topic: robot_description}"
        raise ModelError(_URDF, f"{value!r:.40} found; {wanted}")
    return Urdf(read_text(file_beside(_URDF, value, folder)), value), ""


def _by_name(section: Section, key: str) -> dict[str, float]:
    """Numbers by name; empty where the key is absent."""
    if key not in section:
        return {}
    value = section.value(key)
    if not isinstance(value, Mapping):
        raise ModelError(key, f"{value!r:.40} found; expected numbers by joint, {{elbow: 0.1}}")
    return {str(k): number(f"{key}.{k}", each) for k, each in value.items()}


def _of_joints(section: Section, key: str, joints: tuple[str, ...], urdf: Urdf | None) -> Vector:
    """A number of each joint, zero where a joint has none, shape (n,)."""
    given = _by_name(section, key)
    for name in given:
        if name not in joints:
            wanted = ", ".join(joints)
            if urdf is not None and name in urdf.movable_beside(joints):
                wanted += f", or {name} in joints, without which it is held"
            raise ModelError(f"{key}.{name}", f"is none of joints; expected some of {wanted}")
    return np.array([given.get(name, 0.0) for name in joints])


def _torque_deviation(
    section: Section, joints: tuple[str, ...], urdf: Urdf | None
) -> Vector | None:
    key = "torque_deviation"
    if key not in section:
        return None
    value = section.value(key)
    if isinstance(value, list):
        raise ModelError(
            key, f"{value} found; expected a number, or numbers by joint: {{{joints[0]}: 0.02}}"
        )
    if not isinstance(value, Mapping):
        return np.full(len(joints), section.number(key))
    return _of_joints(section, key, joints, urdf)


def _contact(contact: Section) -> PlaneContact:
    return PlaneContact(
        contact.text("name"),
        contact.text("frame"),
        contact.vector("normal", 3),
        contact.number("offset"),
        read_rebound(contact),
    )


def _forces(section: Section) -> tuple[str, str] | None:
    """Topic and field of measured efforts."""
    if "forces" not in section:
        return None
    forces = Section("forces", section.value("forces"), ("topic", "field"))
    name = forces.text("field")
    if name != "effort":
        raise ModelError(forces.key("field"), f"{name!r} found; expected effort, of a JointState")
    return forces.text("topic"), name


def _forcing(
    section: Section, joints: tuple[str, ...], urdf: Urdf | None, folder: Path | None
) -> Forcing:
    """Torques and forces of the drives of a plant."""
    if "forcing" not in section:
        return Forcing.none(len(joints))
    forcing = Section("forcing", section.value("forcing"), forcing_keys.KEYS)
    return forcing_keys.read_forcing(forcing, joints, folder, one_of_each(joints, urdf))
