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


def _numbers(element: ET.Element | None, attribute: str) -> list[float]:
    """The numbers of an attribute; empty without any, or where a word is no number."""
    text = "" if element is None else element.get(attribute, "")
    try:
        return [float(each) for each in text.split()]
    except ValueError:
        return []  # the library that makes the robot names the word


def _is_direction(numbers: list[float]) -> bool:
    """Whether a vector has a length that can be divided by."""
    return 1 / LARGEST < math.hypot(*numbers) < LARGEST


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
        links = tuple(each.get("name", "") for each in root.iterfind("link"))
        joints = [self._joint(each) for each in root.iterfind("joint")]
        for i, link in enumerate(links):
            if not link or link in links[:i]:
                raise self.wrong(f"link {link!r} found twice or without a name")
        self._check_masses(root)
        found: dict[str, UrdfJoint] = {}
        for joint in joints:
            if not joint.name or joint.name in found:
                raise self.wrong(f"joint {joint.name!r} found twice or without a name")
            for link in (joint.parent, joint.child):
                if link not in links:
                    raise self.wrong(f"joint {joint.name!r} names {link!r}, which is no link")
            found[joint.name] = joint
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
        object.__setattr__(self, "links", links)
        object.__setattr__(self, "joints", found)

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

    def _check_masses(self, root: ET.Element) -> None:
        for each in root.iterfind("link"):
            for mass in _numbers(each.find("inertial/mass"), "value"):
                if mass < 0:
                    problem = f"link {each.get('name')!r} has a mass of {mass:g} kg"
                    raise self.wrong(f"{problem}; expected a number not below zero")

    def _joint(self, element: ET.Element) -> UrdfJoint:
        name, kind = element.get("name", ""), element.get("type", "")
        if kind not in _TYPES:
            wanted = ", ".join(_TYPES)
            raise self.wrong(f"joint {name!r} has the type {kind!r}; expected one of {wanted}")

        axis = element.find("axis")
        numbers = _numbers(axis, "xyz")
        if axis is not None and kind in UNITS_BY_TYPE and numbers and not _is_direction(numbers):
            found = f"joint {name!r} has the axis {axis.get('xyz')!r}"
            raise self.wrong(f"{found}; expected a direction, such as '0 0 1'")

        def number(tag: str, attribute: str, default: float) -> float:
            part = element.find(tag)
            text = None if part is None else part.get(attribute)
            if text is None:
                return default
            try:
                value = float(text)
            except ValueError:
                value = math.nan
            if not abs(value) <= LARGEST:
                raise self.wrong(f"joint {name!r}: {attribute}={text!r}; expected a number")
            return value

        def text(tag: str, attribute: str) -> str:
            part = element.find(tag)
            return "" if part is None else part.get(attribute, "")

        bounded = kind in {"revolute", "prismatic"}
        limits = {"velocity": math.inf, "effort": math.inf} | (
            {"lower": 0.0, "upper": 0.0} if bounded and element.find("limit") is not None else {}
        )
        return UrdfJoint(
            name=name,
            type=kind,
            parent=text("parent", "link"),
            child=text("child", "link"),
            **{key: number("limit", key, default) for key, default in limits.items()},
            damping=number("dynamics", "damping", 0.0),
            friction=number("dynamics", "friction", 0.0),
            mimics=text("mimic", "joint"),
            multiplier=number("mimic", "multiplier", 1.0),
            offset=number("mimic", "offset", 0.0),
        )
