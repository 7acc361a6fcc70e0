# SPDX-License-Identifier: Apache-2.0
"""A robot in a model file: a URDF, its joints and its contacts with fixed planes."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import check_names, vector
from impact_observer.model.files_beside import file_beside
from impact_observer.model.forcing import Forcing
from impact_observer.model.linear_model import smooth_forcing
from impact_observer.model.parameters_in_file import ParameterPlace, Place
from impact_observer.model.rebounds import ReboundLaw, read_rebound
from impact_observer.model.schema import RobotContact, RobotModel, TopicKeys
from impact_observer.model.system import unit_of
from impact_observer.model.urdf_file import FIXED, UNITS_BY_TYPE, Urdf, UrdfJoint
from impact_observer.resources import read_text
from impact_observer.states import Vector, frozen

_UNIT_LENGTH = 1e-6
"""Largest error of the length of a normal, which is then scaled to 1."""
DAMPING, ROTOR_INERTIA, RESTITUTION = "damping", "rotor-inertia", "restitution"
"""Kinds of parameters that may have deviations, as first parts of their names."""

_UNITS = {DAMPING: "Ns/m", ROTOR_INERTIA: "kg"}
"""Units of parameters of joints whose coordinates are in m."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneContact:
    """A frame of a robot and a fixed plane: ``g = normal . p(frame) - offset``.

    Attributes:
        name: name of the contact in events.
        frame: link whose origin ``p`` hits the plane.
        normal: of unit length, into the free side, in the root frame, shape (3,).
        offset: of the plane along the normal, m.
        rebound: how the contact rebounds.
    """

    name: str
    frame: str
    normal: Vector
    offset: float
    rebound: ReboundLaw


@dataclass(frozen=True, slots=True, eq=False)
class RobotDescription:
    """The contents of a model file of a robot with n joints and m contacts.

    Attributes:
        name: name of the model.
        joints: names of the n joints, in the order of the state.
        urdf: the URDF; None while it is to come from ``topic``.
        topic: latched topic of the URDF; empty for a file.
        held: positions of movable joints that are no part of the state, by name, rad or m.
        own_damping: damping beside that of the URDF, shape (n,), N m s/rad or N s/m.
        rotor_inertia: reflected inertia of the rotors, shape (n,), kg m^2 or kg.
        contacts: the contacts.
        forces: topic and field of the measured efforts; None if efforts count as zero.
        torque_deviation: of white torques, shape (n,), N m sqrt(s) or N sqrt(s); None for that of
            efforts which are held from sample to sample.
        gravity: in the root frame, shape (3,), m/s^2.
        forcing: torques and forces of the plant's drives, N m or N.

    Raises:
        ModelError: a value is wrong; the error names the key of the model file.
    """

    name: str
    joints: tuple[str, ...]
    urdf: Urdf | None
    topic: str
    held: Mapping[str, float]
    own_damping: Vector
    rotor_inertia: Vector
    contacts: tuple[PlaneContact, ...]
    forces: tuple[str, str] | None
    torque_deviation: Vector | None
    gravity: Vector
    forcing: Forcing

    def __post_init__(self) -> None:
        """Check names, and that the URDF has what they name."""
        check_names("joints", self.joints, "names of joints of the URDF")
        check_names("contacts", self.contact_names)
        if self.urdf is not None:
            self._check_joints(self.urdf)
            for i, each in enumerate(self.contacts):
                if each.frame not in self.urdf.links:
                    known = ", ".join(self.urdf.links)
                    problem = f"{each.frame!r} is no link of {self.origin}; expected one of"
                    raise ModelError(f"contacts[{i}].frame", f"{problem} {known}")

    @property
    def n(self) -> int:
        """Number of joints in the state."""
        return len(self.joints)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates: the joints."""
        return self.joints

    @property
    def depends_on_time(self) -> bool:
        """Whether an observer needs an epoch: the torques that act are measured."""
        return False

    @property
    def m(self) -> int:
        """Number of contacts."""
        return len(self.contacts)

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Names of the contacts."""
        return tuple(each.name for each in self.contacts)

    @property
    def origin(self) -> str:
        """Where the URDF comes from, in words: a file or a topic."""
        return self.urdf.source if self.urdf is not None else f"topic {self.topic}"

    @property
    def known_urdf(self) -> Urdf:
        """The URDF.

        Raises:
            UsageError: the URDF has not come from its topic.
        """
        if self.urdf is None:
            raise UsageError(
                f"{self.name}: the URDF comes from the topic {self.topic}, which only nodes read;"
                " expected urdf: FILE in the model file"
            )
        return self.urdf

    @property
    def held_in_words(self) -> str:
        """A sentence on the joints that are held; empty for none."""
        left, origin = self.known_urdf.movable_beside((*self.joints, *self.held)), self.origin
        shown = [f"{k} at {value:g}" for k, value in self.holds.items() if k not in left]
        words = [f"held, as no joint of the state: {', '.join(shown)}"] if shown else []
        if left:
            words.append(
                f"held at 0, as joints lacks them: {', '.join(left)} of {origin}; expected in"
                " joints what moves, in held what rests elsewhere"
            )
        return "; ".join(words)

    @property
    def torque_remarks(self) -> tuple[tuple[str, str], ...]:
        """Kinds (warning, note) and texts of what an observer does not know of torques."""
        if self.forces is None:
            text = (
                "the model has no forces, so its torques count as zero, and encoders of a driven"
                " robot seem to err: give forces: {topic: /joint_states, field: effort}"
            )
        elif self.torque_deviation is None:
            text = (
                "the model has no torque_deviation: that of changes of efforts from sample to"
                " sample is used, which covers no errors of masses"
            )
            return (("note", text),)
        elif not self.torque_deviation.any():
            text = (
                "the model has a torque_deviation of zero: its torques and efforts count as exact,"
                " so deviations are too small; leave it out for that of efforts between samples"
            )
        else:
            return ()
        return (("warning", text),)

    def with_urdf(self, text: str) -> "RobotDescription":
        """The robot with the ``text`` of the URDF that came from the topic.

        Raises:
            ModelError: the URDF does not fit the model file.
        """
        return replace(self, urdf=Urdf(text, f"topic {self.topic}"))

    @property
    def urdf_joints(self) -> tuple[UrdfJoint, ...]:
        """The joints of the state as the URDF has them."""
        return tuple(self.known_urdf.joints[name] for name in self.joints)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the coordinates, ``rad`` or ``m`` each."""
        return tuple(each.unit for each in self.urdf_joints)

    @property
    def damping(self) -> Vector:
        """Damping with that of the URDF, shape (n,), N m s/rad or N s/m."""
        return frozen(self.own_damping + [each.damping for each in self.urdf_joints])

    @property
    def holds(self) -> dict[str, float]:
        """Positions of all movable joints that are no part of the state, by name, rad or m.

        A joint that mimics a held one is held where that one puts it.
        """
        found: dict[str, float] = {}
        for joint in self.known_urdf.joints.values():
            if joint.name in self.joints or joint.type == FIXED:
                continue
            value = self.held.get(joint.name, 0.0)
            if joint.mimics and joint.name not in self.held:
                value = joint.multiplier * self.held.get(joint.mimics, 0.0) + joint.offset
            found[joint.name] = value
        return found

    @property
    def parameters(self) -> dict[str, float]:
        """Values of the parameters that may have deviations, by name such as ``damping.elbow``."""
        found = dict[str, float]()
        for kind, values in {DAMPING: self.own_damping, ROTOR_INERTIA: self.rotor_inertia}.items():
            names = (f"{kind}.{joint}" for joint in self.joints)
            found |= dict(zip(names, values.tolist(), strict=True))
        for contact in self.contacts:
            for each in contact.rebound.parameters:
                if each.kind == RESTITUTION:
                    found[f"{RESTITUTION}.{contact.name}"] = each.value
        return found

    def unit_of_parameter(self, name: str) -> str:
        """The SI unit of a parameter, by its name such as ``damping.elbow``; empty for a ratio."""
        kind, _, joint = name.partition(".")
        if kind not in _UNITS:
            return ""
        return unit_of(_UNITS[kind], self.units[self.joints.index(joint)])

    def with_parameters(self, values: Mapping[str, float]) -> "RobotDescription":
        """The robot with other values of parameters, by their names.

        Raises:
            ModelError: a value is impossible, such as a restitution above 1.
        """
        known = {**self.parameters, **values}
        for name in values:
            if known[name] < 0:
                raise ModelError(name, f"{known[name]:g} found; expected a number of at least 0")

        contacts = []
        for i, each in enumerate(self.contacts):
            law, eps = each.rebound, known[f"{RESTITUTION}.{each.name}"]
            own = [eps if p.kind == RESTITUTION else p.value for p in law.parameters]
            law = law.with_values(own).checked(f"contacts[{i}]")
            contacts.append(replace(each, rebound=law))
        return replace(
            self,
            own_damping=frozen([known[f"{DAMPING}.{name}"] for name in self.joints]),
            rotor_inertia=frozen([known[f"{ROTOR_INERTIA}.{name}"] for name in self.joints]),
            contacts=tuple(contacts),
        )

    def _check_joints(self, urdf: Urdf) -> None:
        for i, name in enumerate(self.joints):
            if problem := self._problem_of_joint(urdf, name):
                raise ModelError(f"joints[{i}]", f"{name!r} {problem}")
        for name in self.held:
            kind = urdf.joints[name].type if name in urdf.joints else ""
            if kind not in UNITS_BY_TYPE or name in self.joints:
                raise ModelError(
                    f"held.{name}",
                    f"is no joint that can be held in {self.origin}; expected a revolute,"
                    " continuous or prismatic joint that is not in joints",
                )

    def _problem_of_joint(self, urdf: Urdf, name: str) -> str:
        """Why a joint cannot be part of the state; empty where it can."""
        if (joint := urdf.joints.get(name)) is None:
            movable = [k for k, each in urdf.joints.items() if each.type != FIXED] or ["none"]
            return f"is no joint of {self.origin}; expected one of {', '.join(movable)}"
        if joint.type not in UNITS_BY_TYPE:
            wanted = ", ".join(UNITS_BY_TYPE)
            return f"is a {joint.type} joint of {self.origin}; expected {wanted}"
        if joint.mimics:
            return f"mimics {joint.mimics!r}; expected a joint that moves by itself"
        if joint.friction:
            return (
                f"has dry friction of {joint.friction:g} in {self.origin}; expected friction 0,"
                " and damping instead"
            )
        if moved := [each.name for each in urdf.joints.values() if each.mimics == name]:
            return (
                f"moves {moved[0]!r} of {self.origin}, which mimics {name!r}; expected a URDF in"
                f" which {moved[0]!r} is fixed"
            )
        return ""


def read_robot(model: RobotModel, folder: Path | None) -> RobotDescription:
    """The robot in a model file; ``folder`` is where its other files lie.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    joints, urdf = model.joints, _urdf(model.urdf, folder)
    noise = model.torque_deviation
    if isinstance(noise, float):
        noise = dict.fromkeys(joints, noise)
    forcing = smooth_forcing(model.forcing, joints, folder)
    return RobotDescription(
        name=model.name,
        joints=joints,
        urdf=urdf,
        topic=model.urdf.topic if isinstance(model.urdf, TopicKeys) else "",
        held=model.held,
        own_damping=_of_joints("damping", model.damping, joints),
        rotor_inertia=_of_joints("rotor_inertia", model.rotor_inertia, joints),
        contacts=tuple(_read_contact(f"contacts[{i}]", c) for i, c in enumerate(model.contacts)),
        forces=None if model.forces is None else (model.forces.topic, "effort"),
        torque_deviation=None if noise is None else _of_joints("torque_deviation", noise, joints),
        gravity=vector("gravity", model.gravity, 3),
        forcing=forcing.checked(len(joints)),
    )


def places_in_robot(model: RobotModel, robot: RobotDescription) -> Iterator[ParameterPlace]:
    """Where the numbers of the parameters of a ``robot`` stand in its file."""
    of_joints = {
        "damping": (DAMPING, model.damping),
        "rotor_inertia": (ROTOR_INERTIA, model.rotor_inertia),
    }
    for key, (kind, joints) in of_joints.items():
        yield from (ParameterPlace(f"{kind}.{joint}", (key, joint)) for joint in joints)
    for i, contact in enumerate(robot.contacts):
        for each in contact.rebound.parameters:
            if each.kind == RESTITUTION:
                path: Place = ("contacts", i, *each.place)
                yield ParameterPlace(f"{RESTITUTION}.{contact.name}", path)


def _urdf(given: str | TopicKeys, folder: Path | None) -> Urdf | None:
    """The URDF; None where it comes from a topic."""
    if isinstance(given, TopicKeys):
        return None
    if given.lstrip().startswith("<"):
        return Urdf(given, "the URDF in the model")
    return Urdf(read_text(file_beside("urdf", given, folder)), given)


def _of_joints(key: str, given: Mapping[str, float], joints: tuple[str, ...]) -> Vector:
    """A number of each joint, zero where a joint has none, shape (n,)."""
    for name in given:
        if name not in joints:
            wanted = ", ".join(joints)
            raise ModelError(f"{key}.{name}", f"is none of joints; expected some of {wanted}")
    return frozen([given.get(name, 0.0) for name in joints])


def _read_contact(key: str, contact: RobotContact) -> PlaneContact:
    normal = vector(f"{key}.normal", contact.normal, 3)
    length = math.sqrt(normal.dot(normal))
    if abs(length - 1.0) > _UNIT_LENGTH:
        raise ModelError(f"{key}.normal", f"has the length {length:g}; expected 1")
    law = read_rebound(f"{key}.restitution", contact.restitution)
    normal = frozen(normal / length)
    return PlaneContact(contact.name, contact.frame, normal, contact.offset, law)
