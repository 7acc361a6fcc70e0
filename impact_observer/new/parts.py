# SPDX-License-Identifier: Apache-2.0
"""Parts of a rig, each written in one line on the command line or as an answer."""

import re
from collections.abc import Callable
from dataclasses import dataclass

from impact_observer.errors import UsageError
from impact_observer.model.system import unit_of

Item = dict[str, str | float | list[str]]
"""A member of a list in a file: its keys and values, in order."""
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_TOPIC = re.compile(r"[/~]?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
_UNITS = {"mass": "kg", "force": "N", "stiffness": "N/m", "damping": "Ns/m"}
"""Units of quantities, where coordinates are in m."""
_WORDS = {"null", "true", "false"}
"""Words that YAML does not take for text."""


@dataclass(frozen=True, slots=True)
class PartKind:
    """A kind of part.

    Attributes:
        name: the option ``--NAME`` of the command line, and the word in questions.
        forms: the ways to write a part; examples have the first one.
        example: of the first form.
        meaning: in a few words, with names of units in braces; see :meth:`words`.
        read: makes an item from the fields between commas.
    """

    name: str
    forms: tuple[str, ...]
    example: str
    meaning: str
    read: Callable[[list[str]], Item]

    def words(self, unit: str) -> str:
        """The meaning, for coordinates in this unit."""
        is_angle = unit != "m"
        of = {name: unit_of(one, "rad" if is_angle else "m") for name, one in _UNITS.items()}
        of["length"] = unit
        return self.meaning.format(moves="turns" if is_angle else "moves along a line", **of)

    def parse(self, text: str) -> Item:
        """Returns the item that ``text`` describes.

        Raises:
            UsageError: ``text`` has none of the forms.
        """
        try:
            return self.read([field.strip() for field in text.split(",")])
        except ValueError as error:
            forms = " or ".join(self.forms)
            raise UsageError(
                f"--{self.name} {text}: {error}; expected {forms}, such as {self.example}"
            ) from None


def _name(text: str) -> str:
    if not _NAME.fullmatch(text) or text.lower() in _WORDS:
        raise ValueError(f"{text!r} is no name of letters, digits and _")
    return text


def _topic(text: str) -> str:
    if not _TOPIC.fullmatch(text) or text.lower() in _WORDS:
        raise ValueError(f"{text!r} is no name of a topic")
    return text


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{text!r} is no number") from None


def _fields(given: list[str], least: int, most: int) -> list[str]:
    if not least <= len(given) <= most:
        raise ValueError(f"{len(given)} values found between commas")
    return given


def _mass(given: list[str]) -> Item:
    name, mass = _fields(given, 2, 2)
    return {"name": _name(name), "mass": _number(mass)}


def _ground(given: list[str]) -> Item:
    name, *values = _fields(given, 3, 4)
    keys = ("amplitude", "frequency", "phase")
    harmonic = ", ".join(f"{k}: {_number(v)!r}" for k, v in zip(keys, values, strict=False))
    return {"name": _name(name), "motion": f"{{harmonics: [{{{harmonic}}}]}}"}


def _spring(given: list[str]) -> Item:
    a, b, *values = _fields(given, 3, 4)
    keys = ("stiffness", "damping")
    return {"between": [_name(a), _name(b)], **dict(zip(keys, map(_number, values), strict=False))}


def _force(given: list[str]) -> Item:
    body, *values = _fields(given, 2, 5)
    keys = ("constant",) if len(values) == 1 else ("amplitude", "frequency", "phase", "order")
    return {"body": _name(body), **dict(zip(keys, map(_number, values), strict=False))}


def _stop(given: list[str]) -> Item:
    name, a, b, distance, restitution = _fields(given, 5, 5)
    item: Item = {"name": _name(name)}
    if b in {"above", "below"}:
        item |= {"body": _name(a), "limit": _number(distance), "side": b}
    else:
        item |= {"between": [_name(a), _name(b)], "gap": _number(distance)}
    return item | {"restitution": _number(restitution)}


def _sensor(given: list[str]) -> Item:
    contact, topic, *threshold = _fields(given, 2, 3)
    item: Item = {"contact": _name(contact), "topic": _topic(topic)}
    if threshold:
        return item | {"kind": "peak", "threshold": _number(threshold[0])}
    return item | {"kind": "switch"}


MASS = PartKind("mass", ("NAME,MASS",), "x1,1.5", "a body that {moves}, {mass}", _mass)
GROUND = PartKind(
    "ground",
    ("NAME,AMPLITUDE,FREQUENCY[,PHASE]",),
    "table,0.003,75",
    "what moves by itself, by AMPLITUDE cos(FREQUENCY t + PHASE), {length}, rad/s (6.283 times"
    " Hz), rad, such as a shaker",
    _ground,
)
SPRING = PartKind(
    "spring",
    ("A,B,STIFFNESS[,DAMPING]",),
    "ground,x1,100,0.5",
    "between two bodies, or a body and ground or a ground that moves; {stiffness}, {damping}",
    _spring,
)
FORCE = PartKind(
    "force",
    ("BODY,AMPLITUDE,FREQUENCY[,PHASE[,ORDER]]", "BODY,CONSTANT"),
    "x1,4,2.5",
    "AMPLITUDE cos(FREQUENCY t + PHASE), {force}, rad/s (6.283 times Hz), rad; with ORDER it turns"
    " so often in a revolution of a drive with index pulses; or a constant, {force}",
    _force,
)
STOP = PartKind(
    "stop",
    ("NAME,BODY,above|below,LIMIT,RESTITUTION", "NAME,A,B,GAP,RESTITUTION"),
    "anvil,x1,above,0.5,0.7",
    "the BODY reaches it at LIMIT, {length}; above or below says where it is. Or of two bodies,"
    " which touch when B has moved by GAP towards A, {length}; one may be a ground that moves",
    _stop,
)
SENSOR = PartKind(
    "sensor",
    ("STOP,TOPIC[,THRESHOLD]",),
    "anvil,/switch",
    "of a stop: a switch on a topic, or with a threshold what has peaks, such as an accelerometer,"
    " m/s^2",
    _sensor,
)
MODEL_KINDS = (MASS, GROUND, SPRING, FORCE, STOP)
