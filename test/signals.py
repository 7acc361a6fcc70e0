# SPDX-License-Identifier: Apache-2.0
"""Signals of sensors for tests, and the events that a detector finds in them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from impact_observer.detector import Detection, Detector, Source
from impact_observer.events import Kind
from impact_observer.states import Stamps, Vector

MS = 1_000_000
START = 1_000_000_000
FLOAT, BOOL = "std_msgs/msg/Float64", "std_msgs/msg/Bool"


@dataclass
class Scalar:
    """A message like ``std_msgs/Bool`` or ``std_msgs/Float64``."""

    data: float


@dataclass
class Time:
    """``builtin_interfaces/Time``."""

    sec: int
    nanosec: int


@dataclass
class Header:
    """``std_msgs/Header``."""

    stamp: Time
    frame_id: str = ""


@dataclass
class Vector3:
    """``geometry_msgs/Vector3``."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass
class Stamped:
    """A message with a header, a vector and an array."""

    header: Header
    force: Vector3 = field(default_factory=Vector3)
    data: "Sequence[float] | Vector" = ()
    label: str = "x"


def header(stamp: int) -> Header:
    """A header of a stamp, ns."""
    return Header(Time(*divmod(stamp, 1_000_000_000)))


def switch(**given: object) -> Source:
    """A switch at its defaults but for what is given."""
    return Source("stop", "/switch", **given).complete(BOOL)  # type: ignore[arg-type]


def peak(threshold: float, **given: object) -> Source:
    """A peak detector at its defaults but for what is given."""
    source = Source("stop", "/force", threshold=threshold, **given)  # type: ignore[arg-type]
    return source.complete(FLOAT)


def detections(
    source: Source, samples: Iterable[tuple[int, float]], end: int | None = None
) -> list[Detection]:
    """Detections from samples (stamp, value), with time advanced to ``end``, ns, at last."""
    detector = Detector([source])
    found = [d for stamp, value in samples for d in detector.feed(0, Scalar(value), stamp)]
    return found + ([] if end is None else detector.advance(end))


def events(found: Iterable[Detection]) -> list[tuple[int, Kind]]:
    """Stamps and kinds."""
    return [(d.event.stamp, d.event.switches[0].kind) for d in found]


def sampled(stamps: Stamps, values: Vector) -> list[tuple[int, float]]:
    """A signal as stamps and values."""
    return list(zip(stamps.tolist(), values.tolist(), strict=True))


def every(period: int, count: int, start: int = START) -> Stamps:
    """``count`` stamps with the ``period``, ns."""
    return start + period * np.arange(count, dtype=np.int64)
