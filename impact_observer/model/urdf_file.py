# SPDX-License-Identifier: Apache-2.0
"""What a URDF says of its links and joints; geometry is not read."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from xml.etree import ElementTree as ET

from impact_observer.errors import ModelError
from impact_observer.model.document import LARGEST

UNITS_BY_TYPE = {"revolute": "rad", "continuous": "rad", "prismatic": "m"}
"""Units of the coordinates of joints that may be part of a state, by the type of the joint."""
FIXED = "fixed"
_TYPES = (*UNITS_BY_TYPE, FIXED, "floating", "planar")


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """A joint of a URDF.

    Attributes:
        name: name of the joint.
        type: such as ``revolute``.
        parent: name of the link nearer to the root.
        child: name of the other link.
        lower: least position, rad or m; minus infinity without a limit.
        upper: largest position, rad or m; infinity without a limit.
        velocity: largest speed, rad/s or m/s; infinity without a limit.
        effort: largest torque or force, N m or N; infinity without a limit.
        damping: viscous, N m s/rad or N s/m.
        friction: dry, N m or N.
        mimics: name of the joint that this one follows; empty for none.
        multiplier: positions of that joint count so often.
        offset: position where that joint is at zero, rad or m.
    """

    name: str
    type: str
    parent: str
    child: str
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf
    damping: float = 0.0
    friction: float = 0.0
    mimics: str = ""
    multiplier: float = 1.0
    offset: float = 0.0

    @property
    def unit(self) -> str:
        """The unit of the coordinate, ``rad`` or ``m``."""
        return UNITS_BY_TYPE[self.type]


def _attribute(element: ET.Element, path: str, name: str) -> str:
    """An attribute of the part of an ``element`` at a ``path``; empty without any."""
    part = element.find(path)
    return "" if part is None else part.get(name, "")


@dataclass(frozen=True, slots=True)
class Urdf:
    """The links and joints of a URDF.

    Attributes:
        text: the XML.
        source: the file, for errors.
        links: names of the links. Derived.
        joints: the joints by name, in the order of the file. Derived.

    Raises:
        ModelError: the text is no URDF; the error has the key ``urdf``.
    """

    text: str
    source: str
    links: tuple[str, ...] = field(init=False)
    joints: Mapping[str, UrdfJoint] = field(init=False)

    def __post_init__(self) -> None:
        """Read links and joints."""
        root = self.root()
        links = [each.get("name", "") for each in root.iterfind("link")]
        joints = [self._joint(each) for each in root.iterfind("joint")]
        self._check_names("link", links)
        self._check_names("joint", [each.name for each in joints])
        for each in root.iterfind("link"):
            if (mass := self._number(each, "inertial/mass", "value", 0.0)) < 0:
                problem = f"link {each.get('name')!r} has a mass of {mass:g} kg"
                raise self.wrong(f"{problem}; expected a number not below zero")
        for joint in joints:
            for link in {joint.parent, joint.child} - {*links}:
                raise self.wrong(f"joint {joint.name!r} names {link!r}, which is no link")
        children = [each.child for each in joints]
        roots = [link for link in links if link not in children]
        if len(roots) != 1 or len(set(children)) != len(children):
            shown = ", ".join(roots[:5]) or "no link"
            raise self.wrong(f"is no tree: the root is {shown}; expected one root")
        tree = {*roots}
        while branches := {j.child for j in joints if j.parent in tree} - tree:
            tree |= branches
        if apart := [link for link in links if link not in tree]:
            raise self.wrong(f"is no tree: link {apart[0]!r} is part of a cycle; expected a tree")
        object.__setattr__(self, "links", tuple(links))
        object.__setattr__(self, "joints", {each.name: each for each in joints})

    @property
    def root_link(self) -> str:
        """Name of the link that is the child of no joint."""
        children = {each.child for each in self.joints.values()}
        return next(link for link in self.links if link not in children)

    def root(self) -> ET.Element:
        """The element ``robot``, read anew.

        Raises:
            ModelError: the text is no URDF.
        """
        try:
            root = ET.fromstring(self.text)
        except ET.ParseError as error:
            raise self.wrong(f"is not XML: {error}") from None
        if root.tag != "robot":
            raise self.wrong(f"begins with <{root.tag}>; expected <robot>")
        if any(each.tag.startswith("{http://www.ros.org/wiki/xacro}") for each in root.iter()):
            raise self.wrong("is xacro; expected a URDF: xacro FILE > robot.urdf makes one")
        return root

    def movable_beside(self, joints: Collection[str]) -> list[str]:
        """Names of the joints that may be part of a state, but are none of ``joints``."""
        return [
            each.name
            for each in self.joints.values()
            if each.type in UNITS_BY_TYPE and not each.mimics and each.name not in joints
        ]

    def wrong(self, problem: str) -> ModelError:
        """The error that names the file and the ``problem``."""
        return ModelError("urdf", f"{self.source}: {problem}")

    def _check_names(self, what: str, names: list[str]) -> None:
        for i, name in enumerate(names):
            if not name or name in names[:i]:
                raise self.wrong(f"{what} {name!r} found twice or without a name")

    def _number(self, element: ET.Element, path: str, name: str, default: float) -> float:
        """The number of an attribute, or the ``default`` where there is none."""
        if not (text := _attribute(element, path, name)):
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not abs(value) <= LARGEST:
            owner = f"{element.tag} {element.get('name')!r}"
            raise self.wrong(f"{owner}: {name}={text!r}; expected a number")
        return value

    def _joint(self, element: ET.Element) -> UrdfJoint:
        name, kind = element.get("name", ""), element.get("type", "")
        if kind not in _TYPES:
            wanted = ", ".join(_TYPES)
            raise self.wrong(f"joint {name!r} has the type {kind!r}; expected one of {wanted}")
        axis = _attribute(element, "axis", "xyz")
        try:
            length = math.hypot(*map(float, axis.split())) if axis else 1.0
        except ValueError:
            length = 1.0  # the library that makes the robot names the word
        if kind in UNITS_BY_TYPE and not 1 / LARGEST < length < LARGEST:
            found = f"joint {name!r} has the axis {axis!r}"
            raise self.wrong(f"{found}; expected a direction, such as '0 0 1'")
        is_bounded = kind in {"revolute", "prismatic"} and element.find("limit") is not None
        defaults = {"velocity": math.inf, "effort": math.inf}
        if is_bounded:
            defaults |= {"lower": 0.0, "upper": 0.0}
        return UrdfJoint(
            name=name,
            type=kind,
            parent=_attribute(element, "parent", "link"),
            child=_attribute(element, "child", "link"),
            **{key: self._number(element, "limit", key, each) for key, each in defaults.items()},
            damping=self._number(element, "dynamics", "damping", 0.0),
            friction=self._number(element, "dynamics", "friction", 0.0),
            mimics=_attribute(element, "mimic", "joint"),
            multiplier=self._number(element, "mimic", "multiplier", 1.0),
            offset=self._number(element, "mimic", "offset", 0.0),
        )
