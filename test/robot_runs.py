# SPDX-License-Identifier: Apache-2.0
"""Recorded motions of hammer_arm: encoders with 1 mrad of noise, exact efforts, late stamps."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from impact_observer.events import ImpactEvent, Kind
from impact_observer.model import Model, read_model
from impact_observer.model.measurement import Measurement, parse_measurements
from impact_observer.model.urdf_file import Urdf
from impact_observer.observer import Observer, make_observer
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options
from impact_observer.plant import Plant, simulate
from impact_observer.robots.robot import Robot
from impact_observer.stamps import NS_PER_S, from_seconds, grid

EPOCH = 5 * NS_PER_S
JITTER, NOISE = 0.0002, 0.001
"""Of the stamps of impacts, s; of the encoders, rad."""
TORQUES = 0.05
"""Deviation of white torques that the model declares, N m sqrt(s)."""
AFTER = 0.05
"""End of the window after a hit, s."""
BEFORE = 0.001
"""From a hit to the begin of the window: five deviations of a stamp, s."""
RATE = 200.0
"""Of the encoders, Hz."""

Array = NDArray[np.float64]


def known_model() -> Model:
    """hammer_arm as the observers know it."""
    model = read_model("hammer_arm")
    assert model.robot is not None, "a robot"
    robot = replace(model.robot, torque_deviation=np.full(model.robot.n, TORQUES))
    return replace(model, robot=robot)


def efforts_of(robot: Robot, stamps: NDArray[np.int64]) -> Array:
    """Torques of a ``robot`` at ``stamps``, shape (samples, n), N m."""
    times = (stamps - EPOCH) / NS_PER_S
    return np.array([robot.torques(t) for t in times.tolist()])


class Truth(NamedTuple):
    """How a plant moved.

    Attributes:
        stamps: of the encoders, shape (samples,), ns.
        states: at these stamps, shape (samples, 2n), rad and rad/s.
        events: impacts, as an exact sensor reports them.
        efforts: at these stamps, shape (samples, n), N m.
    """

    stamps: NDArray[np.int64]
    states: Array
    events: Sequence[ImpactEvent]
    efforts: Array

    @classmethod
    def of_plant(
        cls, robot: Robot, start: tuple[Array, Array], rate: float, seconds: float
    ) -> "Truth":
        """The motion of a ``robot`` from ``start``, its positions and velocities."""
        stamps = grid(EPOCH, EPOCH + from_seconds(seconds), rate)
        run = simulate(Plant(robot, *start, epoch=EPOCH), stamps)
        return cls(stamps, run.states, run.events, efforts_of(robot, stamps))

    @property
    def hits(self) -> list[int]:
        """Stamps of the onsets of contact, ns."""
        kinds = (Kind.IMPACT, Kind.CLOSE)
        return [each.stamp for each in self.events if each.switches[0].kind in kinds]

    def recorded(self, seed: int) -> "Recording":
        """What encoders and the sensor of impacts record."""
        rng, after = np.random.default_rng([51, seed]), np.zeros(self.stamps.size, dtype=np.bool_)
        begin, end = from_seconds(BEFORE), from_seconds(AFTER)
        for hit in self.hits:
            after |= (self.stamps >= hit + begin) & (self.stamps < hit + end)
        late = JITTER * rng.normal(size=len(self.events))
        events = [
            replace(event, stamp=event.stamp + from_seconds(each))
            for event, each in zip(self.events, late.tolist(), strict=True)
        ]
        values = self.states[:, : self.efforts.shape[1]]
        values = values + NOISE * rng.normal(size=values.shape)
        samples = [
            SensorSample(i, stamp, value)
            for stamp, row in zip(self.stamps.tolist(), values.tolist(), strict=True)
            for i, value in enumerate(row)
        ]
        return Recording(self, after, sorted(events, key=lambda event: event.stamp), samples)


class Recording(NamedTuple):
    """What is recorded of one run.

    Attributes:
        truth: the motion of the plant.
        after_hits: which states are in the window after a hit, shape (samples,).
        events: impacts as they are stamped.
        samples: of the encoders.
    """

    truth: Truth
    after_hits: NDArray[np.bool_]
    events: list[ImpactEvent]
    samples: list[SensorSample]

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.truth.efforts[0])

    def error(self, speeds: Array) -> float:
        """The root mean square error of ``speeds``, shape (samples, n), after hits, rad/s."""
        errors = (speeds - self.truth.states[:, self.n :])[self.after_hits]
        return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def wrong_plant(model: Model) -> Robot:
    """The robot of a ``model`` with other masses, damping and restitution."""
    assert model.robot is not None, "a robot"
    root = ET.fromstring(model.robot.known_urdf.text)
    for part in (*root.iter("mass"), *root.iter("inertia")):
        part.attrib.update({k: repr(1.05 * float(v)) for k, v in part.attrib.items()})
    known = model.robot.parameters
    other = {k: 1.05 * v for k, v in known.items() if k.startswith("damping")}
    other |= {k: v + 0.05 for k, v in known.items() if k.startswith("restitution")}
    urdf = Urdf(ET.tostring(root, encoding="unicode"), model.robot.known_urdf.source)
    return Robot(replace(model.robot.with_parameters(other), urdf=urdf))


def encoders(model: Model) -> Sequence[Measurement]:
    """An encoder of 1 mrad on each joint of a ``model``."""
    assert model.robot is not None, "a robot"
    each = (
        "  - {{name: {0}, topic: /joint_states, joint: {0}, quantity: position, deviation: {1}}}"
    )
    rows = [each.format(name, NOISE) for name in model.robot.joints]
    return parse_measurements("\n".join(["measurements:", *rows]), "encoders")


def observer_of(model: Model, recording: Recording) -> Observer:
    """An observer of a ``model`` that knows the efforts of a ``recording``."""
    assert model.robot is not None, "a robot"
    options = Options(law="minimum-variance", clock_error=JITTER, epoch=EPOCH)
    observer = make_observer(model, options, measurements=encoders(model))
    assert observer.live is not None, "efforts are measured"
    stamps, efforts = recording.truth.stamps.tolist(), recording.truth.efforts.tolist()
    for stamp, row in zip(stamps, efforts, strict=True):
        for name, value in zip(model.robot.joints, row, strict=True):
            observer.live.add_force(name, stamp, value)
    return observer


def without_contacts(model: Model, deviation: float) -> Model:
    """The ``model`` without contacts, with white torques of this ``deviation``."""
    assert model.robot is not None, "a robot"
    torques = np.full(model.robot.n, deviation)
    robot = replace(model.robot, contacts=(), torque_deviation=torques)
    return replace(model, robot=robot, uncertainty=None)


class Filtered(NamedTuple):
    """What an observer estimated.

    Attributes:
        speeds: just after each sample, shape (samples, n), rad/s.
        deviations: their standard deviations, shape (samples, n), rad/s.
        warned: hits after which a misfit was warned of; -1 for no warning.
    """

    speeds: Array
    deviations: Array
    warned: int


def filtered(
    observer: Observer, recording: Recording, *, inflated: float = 0.0, hits: bool = True
) -> Filtered:
    """Velocities that an observer estimates.

    Where ``inflated`` is given, hits only make the deviations of velocities as large, rad/s.
    """
    n, warned = recording.n, -1
    events = list(recording.events) if hits else []
    speeds, deviations = list[Array](), list[Array]()
    samples = iter(recording.samples)
    for stamp in recording.truth.stamps.tolist():
        while events and events[0].stamp <= stamp:
            event = events.pop(0)
            if not inflated:
                observer.receive(event)
                continue
            now = observer.estimate(event.stamp)
            wider = now.covariance.copy()
            wider[n:, n:] += inflated**2 * np.eye(n)
            observer.set_state(event.stamp, now.q, now.u, wider)
        observer.measure([next(samples) for _ in range(n)])
        found = observer.estimate(stamp)
        if found.misfit and warned < 0:
            warned = len(recording.events) - len(events)
        speeds.append(found.u)
        deviations.append(np.sqrt(np.diag(found.covariance)[n:]))
    return Filtered(np.array(speeds), np.array(deviations), warned)


def differences(recording: Recording, time_constant: float) -> Array:
    """Differences of the encoders with a low pass of first order, shape (samples, n)."""
    q = np.array([each.value for each in recording.samples]).reshape(-1, recording.n)
    steps = np.diff(recording.truth.stamps) / NS_PER_S
    found, now = [np.zeros(recording.n)], np.zeros(recording.n)
    for change, step in zip(np.diff(q, axis=0), steps.tolist(), strict=True):
        now = now + (1 - np.exp(-step / time_constant)) * (change / step - now)
        found.append(now)
    return np.array(found)
