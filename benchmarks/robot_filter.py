# SPDX-License-Identifier: Apache-2.0
"""Velocities of robots that hit a wall: ``./dev bench robot_filter``.

Encoders have 1 mrad of noise, efforts are exact, stamps of impacts jitter by 0.2 ms; all of that
is declared, with white torques of 0.05 N m sqrt(s). The plants are

- ``wrong``: hammer_arm with masses, inertias and damping 5 % larger and a restitution 0.05 larger
  than in the model, at 1 kHz and 200 Hz;
- ``three joints``: the same errors of a hammer with three joints;
- ``mujoco``: hammer_arm in MuJoCo, with contacts of 1 ms and of 5 ms, with friction of 0.3 at the
  tip, and with flexible joints whose encoders are on the motors, at 500 Hz.

The velocity error is the root mean square over all joints from 2 ms to 50 ms after each hit, rad/s
(with contacts of 5 ms from 6 ms). The table has the median of the seeds, of

- ``saltation``: the observer;
- ``inflated``: the same filter without contacts, whose covariance of velocities is made larger at
  the stamp of each hit;
- ``no jump``: the same filter without contacts and without hits;
- ``differences``: of the encoder, with a low pass of first order.

The last three are tuned on the truth of the first run, by the best of several numbers. ``z`` is
the median of the largest error of a velocity over its deviation, ``warned`` the hits after which
the observer warned of a misfit (in how many of the runs), ``cost`` the processor time for each
instant of samples of all joints and an estimate, in microseconds.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.mujoco_hammer import Contact, moved
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import Model, parse_model, read_model
from impact_observer.model.measurement import Measurement
from impact_observer.model.measurements_file import parse_measurements
from impact_observer.model.urdf_file import Urdf
from impact_observer.observer import Observer, make_observer
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options
from impact_observer.plant import simulate
from impact_observer.plant.master import make_plant
from impact_observer.robots.robot import Robot
from impact_observer.stamps import NS_PER_S, from_seconds, grid

EPOCH = 5 * NS_PER_S
MODEL = "hammer_arm"
JITTER, NOISE = 0.0002, 0.001
"""Of the stamps of impacts, s; of the encoders, rad."""
TORQUES = 0.05
"""Deviation of white torques that the model declares, N m sqrt(s)."""
AFTER, SECONDS, SEEDS = 0.05, 40.0, 10
"""End of the window after a hit, s; length of a run with some 30 hits, s; runs."""
BEFORE = 0.001
"""From the end of a contact to the begin of the window: five deviations of a stamp, s."""
LOW_PASS = (0.002, 0.005, 0.01, 0.02)
"""Time constants of the differences, s."""
INFLATED = (1.0, 3.0, 10.0, 30.0)
"""Deviations of the velocities after a hit, rad/s."""
FREE = (0.02, 0.2, 1.0, 5.0)
"""Deviations of white torques of the filter without hits, N m sqrt(s)."""
THREE_JOINTS = """
name: three_joints
joints: [shoulder, elbow, wrist]
damping: {shoulder: 0.3, elbow: 0.3, wrist: 0.1}
rotor_inertia: {shoulder: 0.1, elbow: 0.02, wrist: 0.01}
contacts:
  - name: wall
    frame: tip
    normal: [1, 0, 0]
    offset: -0.35
    restitution: {value: 0.4, deviation: 0.05}
forces: {topic: /joint_states, field: effort}
forcing:
  harmonics:
    - {frequency: 5.0, cosine: [0, 0, 0], sine: [4, 1, 0.2]}
    - {frequency: 8.1, cosine: [0, 0.8, 0.1]}
initial_state: {position: [0.3, 0.6, 0.3], velocity: [0, 0, 0]}
urdf: |
"""
LINKS = {"shoulder": (1.2, 0.4), "elbow": (0.6, 0.25), "wrist": (0.3, 0.15)}
"""Mass, kg, and length, m, of the rods of the hammer with three joints."""

Array = NDArray[np.float64]


def three_joints() -> Model:
    """A hammer of three rods that swings in the plane y = 0."""
    links, before, end = '<link name="base"/>', "base", 0.0
    for name, (mass, length) in LINKS.items():
        inertia = mass * length**2 / 12
        links += (
            f'<link name="{name}_link"><inertial><origin xyz="0 0 {-length / 2}"/><mass'
            f' value="{mass}"/><inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia / 30}"'
            f' ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="{name}" type="continuous">'
            f'<origin xyz="0 0 {end}"/><parent link="{before}"/><child link="{name}_link"/>'
            '<axis xyz="0 -1 0"/></joint>'
        )
        before, end = f"{name}_link", -length
    tip = (
        f'<link name="tip"/><joint name="head" type="fixed"><origin xyz="0 0 {end}"/>'
        f'<parent link="{before}"/><child link="tip"/></joint>'
    )
    return parse_model(f'{THREE_JOINTS}  <robot name="hammer">{links}{tip}</robot>\n', "three")


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
        run = simulate(make_plant(robot, *start, epoch=EPOCH), stamps)
        return cls(stamps, run.states, run.events, efforts_of(robot, stamps))

    @property
    def hits(self) -> list[int]:
        """Stamps of the onsets of contact, ns."""
        kinds = (Kind.IMPACT, Kind.CLOSE)
        return [each.stamp for each in self.events if each.switches[0].kind in kinds]

    def recorded(self, seed: int, contact_time: float = 0.0) -> "Recording":
        """What encoders and the sensor of impacts record; hits last for ``contact_time``, s."""
        rng, after = np.random.default_rng([51, seed]), np.zeros(self.stamps.size, dtype=np.bool_)
        begin, end = from_seconds(contact_time + BEFORE), from_seconds(AFTER)
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


@dataclass(frozen=True, slots=True)
class Case:
    """A plant and the model that its observers know.

    Attributes:
        rate: of the encoders, 1/s.
        contact: of hammer_arm in MuJoCo; None for our plant with parameters 5 percent wrong.
        joints: how many joints the hammer has.
    """

    rate: float
    contact: Contact | None = None
    joints: int = 2

    @property
    def model(self) -> Model:
        """The model that the observers know."""
        model = read_model(MODEL) if self.joints < len(LINKS) else three_joints()
        assert model.robot is not None, "a robot"
        robot = replace(model.robot, torque_deviation=np.full(model.robot.n, TORQUES))
        return replace(model, robot=robot)

    @property
    def contact_time(self) -> float:
        """How long a hit lasts, s."""
        return 0.0 if self.contact is None else self.contact.seconds

    def truth(self, seconds: float) -> Truth:
        """The motion of the plant."""
        q, u = self.model.initial_state()
        if self.contact is None:
            return Truth.of_plant(wrong_plant(self.model), (q, u), self.rate, seconds)
        robot = Robot(self.model)
        motion = moved(self.contact, q, robot.torques, self.rate, seconds)
        stamps = grid(EPOCH, EPOCH + from_seconds(seconds), self.rate)
        events = [
            ImpactEvent(EPOCH + from_seconds(hit), (Switch("wall"),), k + 1, 0, EPOCH)
            for k, hit in enumerate(motion.hits)
        ]
        return Truth(stamps, motion.states, events, efforts_of(robot, stamps))


CASES = {
    "wrong, 1 kHz": Case(1000.0),
    "wrong, 200 Hz": Case(200.0),
    "three joints, 1 kHz": Case(1000.0, joints=3),
    "mujoco, 1 ms, 500 Hz": Case(500.0, Contact(1e-3)),
    "mujoco, 5 ms, 500 Hz": Case(500.0, Contact(5e-3)),
    "friction 0.3, 500 Hz": Case(500.0, Contact(friction=0.3)),
    "flexible joints, 500 Hz": Case(500.0, Contact(flexible=True)),
}


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


class Found(NamedTuple):
    """Velocity errors of one run, rad/s, and what else the table shows."""

    saltation: float
    inflated: float
    no_jump: float
    differences: float
    z: float
    warned: int
    cost: float


class Tuned(NamedTuple):
    """The numbers of the filters beside the observer.

    Attributes:
        inflated: deviation of the velocities after a hit, rad/s.
        free: deviation of the white torques of the filter without hits, N m sqrt(s).
        low_pass: time constant of the differences, s.
    """

    inflated: float
    free: float
    low_pass: float

    def errors(self, case: Case, recording: Recording) -> tuple[float, float, float]:
        """Their velocity errors after hits, rad/s."""
        widened = observer_of(without_contacts(case.model, TORQUES), recording)
        free = observer_of(without_contacts(case.model, self.free), recording)
        return (
            recording.error(filtered(widened, recording, inflated=self.inflated).speeds),
            recording.error(filtered(free, recording, hits=False).speeds),
            recording.error(differences(recording, self.low_pass)),
        )


def tuned(case: Case, truth: Truth) -> Tuned:
    """The best numbers for the first run."""
    recording = truth.recorded(0, case.contact_time)
    each = delayed(Tuned.errors)
    tried = [Tuned(*numbers) for numbers in zip(INFLATED, FREE, LOW_PASS, strict=True)]
    errors = np.array(Parallel(n_jobs=-1)(each(some, case, recording) for some in tried))
    best = errors.argmin(axis=0).tolist()
    return Tuned(*(tried[i][k] for k, i in enumerate(best)))


def found_by(case: Case, truth: Truth, others: Tuned, seed: int) -> Found:
    """The errors of one run, beside the ``others``."""
    recording, model = truth.recorded(seed, case.contact_time), case.model
    observer, began = observer_of(model, recording), time.process_time()
    own = filtered(observer, recording)
    cost = (time.process_time() - began) / truth.stamps.size * 1e6
    z = np.abs(own.speeds - truth.states[:, case.joints :]) / own.deviations
    return Found(
        recording.error(own.speeds),
        *others.errors(case, recording),
        float(np.median(z.max(axis=1))),
        own.warned,
        cost,
    )


def row_of(name: str, truth: Truth, found: Sequence[Found]) -> list[str]:
    """The row of a case in the table."""
    *errors, z, _, cost = np.median(found, axis=0).tolist()
    warned = [each.warned for each in found if each.warned >= 0]
    when = f"{np.median(warned):.0f} ({len(warned)})" if warned else "-"
    cells = [f"{each:.3f}" for each in errors]
    return [name, str(len(truth.hits)), *cells, f"{z:.2f}", when, f"{cost:.0f}"]


def main(args: Sequence[str] | None = None) -> int:
    """Print a table."""
    parser = argparse.ArgumentParser(prog="./dev bench robot_filter", description=__doc__)
    parser.add_argument("cases", nargs="*", choices=[*CASES, []], metavar="CASE")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each run")
    chosen = parser.parse_args(args)
    table = Table("plant", "hits", *(each.replace("_", " ") for each in Found._fields))
    for name in chosen.cases or CASES:
        case = CASES[name]
        truth = case.truth(chosen.seconds)
        one = delayed(partial(found_by, case, truth, tuned(case, truth)))
        row = row_of(name, truth, Parallel(n_jobs=-1)(one(seed) for seed in range(chosen.seeds)))
        table.add_row(*row)
        print(*row, sep="  ", file=sys.stderr)
    Console(width=120).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
