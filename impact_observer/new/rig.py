# SPDX-License-Identifier: Apache-2.0
"""A new rig: its parts, and the texts of its three files."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from impact_observer.detector import parse_sources
from impact_observer.errors import UsageError
from impact_observer.filter.uncertainty import suggested_deviation
from impact_observer.model import Model, System, parse_model
from impact_observer.model.degrees import DEGREES
from impact_observer.model.system import UNITS, unit_of
from impact_observer.new.parts import FORCE, GROUND, MASS, SENSOR, SPRING, STOP, Item, PartKind
from impact_observer.output_files import unwritable
from impact_observer.states import Vector

COORDINATE_UNITS = (*UNITS, DEGREES)
"""Units of coordinates in model files."""
_CLEAR = 0.01
"""Gap of a start outside its stops, relative to the penetration at zero."""
_NONE = 1e-9
"""Residual below which no positions are outside all stops."""
_FILE_NAME = re.compile(r"[A-Za-z_][\w-]*", re.ASCII)
_MODEL = """\
# {name}: a model of a rig, made by `impact-observer new`. Units: {units}.
# After each change: impact-observer check-model {name}.yaml. All keys are in docs/model.md.
name: {name}
{unit}
# Bodies {move}. Positions are displacements from where the springs have no load.
bodies:
{mass}
# What moves by itself: amplitude cos(frequency t + phase), in {length}, rad/s and rad, t from the
# epoch.
grounds:{ground}
# Stiffness in {stiffness}, damping in {damping}. `ground` does not move.
springs:{spring}
# amplitude cos(frequency t + phase), in {of_force}, rad/s and rad, t from the epoch; or constant.
# With an order it turns with a drive, whose index pulses arrive on phase_reference.
forces:{force}
# side: where the stop is, so that a body stays below a stop `above`. Between two bodies a and b
# the gap is q_b - q_a + gap.
# Restitution lies between 0 and 1; for what you do not know see docs/identify.md.
stops:{stop}
# Where a simulation begins, {length} and {length}/s. No observer reads it.
{start}
"""
_SENSORS = """\
# The sensors of {name}, one for each stop, made by `impact-observer new`.
# All keys are in docs/detector.md.
#   impact-observer detect BAG --sources {name}_sensors.yaml --model {name}.yaml -o OUT
# A switch is a std_msgs/Bool, true while the contact is closed. A peak is in any message, such as
# sensor_msgs/Imu; its threshold is in that message's unit.
# Worth measuring: `latency: 0.002`, by how much its stamps are late, s.

sources:
{sensor}
"""
_LAUNCH = '''\
"""Detector and observer of {name}, made by `impact-observer new`, for ROS 2 Jazzy.

    ros2 launch {name}.launch.py{epoch}
{remark}
What these nodes take (rate, use_sim_time, namespace, local, ...) may be given in the same way:
    ros2 launch {name}.launch.py --show-args
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

from impact_observer.resources import shared

FOLDER = Path(__file__).resolve().parent
NODES = {{
    "detector": {{"sources": str(FOLDER / "{name}_sensors.yaml")}},
    "observer": {{
        "model": str(FOLDER / "{name}.yaml"),
        "law": "minimum-variance",{deviation}
    }},
}}


def generate_launch_description() -> LaunchDescription:
    """The launch files of the package, with the files of this rig."""
    return LaunchDescription([included(node, given) for node, given in NODES.items()])


def included(node: str, given: dict[str, str]) -> IncludeLaunchDescription:
    """The launch file of a node."""
    source = PythonLaunchDescriptionSource(str(shared(f"launch/{{node}}.launch.py")))
    return IncludeLaunchDescription(source, launch_arguments=given.items())
'''
_EPOCH = """
Something is a function of time: epoch is the stamp of its t = 0, in nanoseconds. Leave it out
where a drive publishes its index pulses on phase_reference.
"""


@dataclass(frozen=True, slots=True)
class NewRig:
    """The parts of a rig.

    Attributes:
        name: of the model and of its files.
        parts: items of the lists in its files, by their kind.
        unit: of the coordinates, one of ``COORDINATE_UNITS``.

    Raises:
        UsageError: the name cannot be that of a file, or the unit is none.
    """

    name: str
    parts: Mapping[PartKind, tuple[Item, ...]] = field(default_factory=dict)
    unit: str = UNITS[0]

    def __post_init__(self) -> None:
        """Check name and unit."""
        if self.unit not in COORDINATE_UNITS:
            raise UsageError(f"unit: {self.unit!r} found; expected {', '.join(COORDINATE_UNITS)}")
        if not _FILE_NAME.fullmatch(self.name):
            raise UsageError(
                f"NAME: {self.name!r} found; expected letters, digits, - and _, such as my_rig"
            )

    def with_part(self, kind: PartKind, text: str) -> "NewRig":
        """Returns the rig with one more part, which is checked.

        Raises:
            UsageError: the part has none of its forms, or its stop does not exist.
            ModelError: the part makes no valid model.
        """
        items = (*self.items(kind), kind.parse(text))
        grown = replace(self, parts={**self.parts, kind: items})
        if kind is SENSOR:
            grown.check_sensors()
        else:
            grown.model()
        return grown

    def items(self, kind: PartKind) -> tuple[Item, ...]:
        """Returns the parts of a kind."""
        return self.parts.get(kind, ())

    @property
    def stops_without_sensor(self) -> tuple[str, ...]:
        """Names of the stops without a sensor, in order."""
        sensed = {each["contact"] for each in self.items(SENSOR)}
        return tuple(str(each["name"]) for each in self.items(STOP) if each["name"] not in sensed)

    @property
    def needs_epoch(self) -> bool:
        """Whether a force or a ground is a function of time."""
        return bool(self.items(GROUND)) or any("frequency" in each for each in self.items(FORCE))

    @property
    def asks_for_epoch(self) -> bool:
        """Whether the user has to give the epoch, as no drive publishes index pulses."""
        return self.needs_epoch and not any("order" in each for each in self.items(FORCE))

    @property
    def deviation(self) -> str:
        """The deviation of the initial state that suits the rig; empty if the default does."""
        return suggested_deviation(self.model().system)

    def model(self) -> Model:
        """Returns the model, read from its text.

        Raises:
            ModelError: the parts make no valid model.
        """
        return parse_model(self.model_text(), f"{self.name}.yaml")

    def model_text(self) -> str:
        """Returns the text of the model file."""
        without_start = self._model_text("")
        q = outside_stops(parse_model(without_start, f"{self.name}.yaml").system)
        speed = 0.0 if self.needs_epoch else 1.0  # else nothing would ever move
        written = np.degrees if self.unit == DEGREES else np.asarray
        state = (written(each) for each in (q, q * 0 + speed))
        position, velocity = (", ".join(f"{x:.6g}" for x in each) for each in state)
        return self._model_text(
            f"initial_state: {{position: [{position}], velocity: [{velocity}]}}"
        )

    def _model_text(self, start: str) -> str:
        """Returns the text of the model file with the line of its initial state."""
        parts = {kind.name: _lines(self.items(kind)) for kind in (GROUND, SPRING, FORCE, STOP)}
        mass = _lines(self.items(MASS)).removeprefix("\n")
        angle = "" if self.unit == UNITS[0] else "rad"
        names = {"of_force": "N", "stiffness": "N/m", "damping": "Ns/m"}
        units = {name: unit_of(one, angle) for name, one in names.items()}
        used = (unit_of("kg", angle), self.unit, "s", units["of_force"], "rad")
        return _MODEL.format(
            name=self.name,
            mass=mass,
            start=start,
            units=", ".join(dict.fromkeys(used)),
            unit=f"unit: {self.unit}\n" if angle else "",
            move="turn" if angle else "move along one line",
            length=self.unit,
            **units,
            **parts,
        )

    def sensors_text(self) -> str:
        """Returns the text of the file of sensors."""
        sensor = _lines(self.items(SENSOR)).strip("\n")
        return _SENSORS.format(name=self.name, sensor=sensor)

    def launch_text(self) -> str:
        """Returns the text of the launch file."""
        epoch, remark = (" epoch:=NANOSECONDS", _EPOCH) if self.asks_for_epoch else ("", "")
        suggested = self.deviation
        deviation = f'\n        "initial_deviation": "{suggested}",' if suggested else ""
        return _LAUNCH.format(name=self.name, epoch=epoch, remark=remark, deviation=deviation)

    def check_sensors(self) -> None:
        """Check that each sensor belongs to a stop and can be read by a detector.

        Raises:
            UsageError: a sensor belongs to no stop, or cannot be read.
        """
        stops = [str(each["name"]) for each in self.items(STOP)]
        for each in self.items(SENSOR):
            if each["contact"] not in stops:
                known = ", ".join(stops) or "none"
                raise UsageError(f"--sensor {each['contact']}: no such stop; there are {known}")
        parse_sources(self.sensors_text(), f"{self.name}_sensors.yaml")


def complete(rig: NewRig) -> NewRig:
    """Returns the rig with a switch for each stop without a sensor, on the topic of its name.

    Raises:
        UsageError: the rig has no mass or no stop.
    """
    for kind in (MASS, STOP):
        if not rig.items(kind):
            raise UsageError(
                f"--{kind.name}: none given; expected at least one, such as"
                f" --{kind.name} {kind.example}; in a terminal, without any, new asks"
            )
    for stop in rig.stops_without_sensor:
        rig = rig.with_part(SENSOR, f"{stop},/{stop}")
    return rig


def write(rig: NewRig, folder: Path) -> list[Path]:
    """Write the three files of a complete rig, or none of them; returns their paths.

    Raises:
        UsageError: a file exists or may not be written.
        OutputError: the disk is full or gone.
    """
    texts = {
        folder / f"{rig.name}.yaml": rig.model_text(),
        folder / f"{rig.name}_sensors.yaml": rig.sensors_text(),
        folder / f"{rig.name}.launch.py": rig.launch_text(),
    }
    written: list[Path] = []
    try:
        for path, text in texts.items():
            with path.open("x", encoding="utf-8") as file:
                written.append(path)
                file.write(text)
    except FileExistsError as error:
        _remove(written)
        raise UsageError(f"{error.filename}: is there already; choose another name") from None
    except OSError as error:
        _remove(written)
        raise unwritable(Path(error.filename or written[-1]), error) from None
    return list(texts)


def _remove(files: list[Path]) -> None:
    """Remove what was written of a rig."""
    for each in files:
        each.unlink()


def outside_stops(system: System) -> Vector:
    """Returns the least positions at the epoch with no body inside a stop, m, shape (n,).

    With gaps ``W^T q + g_0`` this is the least distance problem of Lawson and Hanson (Solving
    Least Squares Problems, chapter 23): the residual of a fit with factors that are not negative
    is proportional to ``q``.

    Raises:
        UsageError: every position is inside some stop.
    """
    rest = np.zeros(2 * system.n)
    at_epoch = system.to_frame(np.zeros(1, dtype=np.int64), rest[None])[0]
    gaps = system.gap(at_epoch[: system.n])
    if not np.any(gaps < 0.0):
        return rest[: system.n]
    wanted = _CLEAR * np.max(-gaps) - gaps
    unit = np.append(np.zeros(system.n), 1.0)
    matrix = np.vstack([system.W, wanted])
    residual = matrix @ nnls(matrix, unit)[0] - unit
    if abs(residual[-1]) < _NONE:
        names = ", ".join(system.contact_names)
        raise UsageError(f"--stop: no positions are outside all of {names}; expected room there")
    return np.asarray(-residual[:-1] / residual[-1])


def _lines(items: tuple[Item, ...]) -> str:
    """Returns a list in YAML with one member a line."""
    if not items:
        return " []\n"
    return "".join(f"\n  - {{{', '.join(map(_entry, each.items()))}}}" for each in items) + "\n"


def _entry(pair: tuple[str, str | float | list[str]]) -> str:
    """Returns a key with its value in YAML."""
    key, value = pair
    if isinstance(value, list):
        return f"{key}: [{', '.join(value)}]"
    return f"{key}: {value if isinstance(value, str) else repr(value).removesuffix('.0')}"
