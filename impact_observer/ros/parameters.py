"""The one table of the nodes' parameters: it declares, checks and documents them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, List, TypeAlias  # noqa: UP035

from impact_observer.errors import UsageError
from impact_observer.integrators import DEFAULT_STEP, EVENT_DRIVEN, INTEGRATORS
from impact_observer.sensor_faults import SENSOR_FAULTS, SensorFault

if TYPE_CHECKING:
    from rcl_interfaces.msg import ParameterDescriptor
    from rclpy.node import Node

Value: TypeAlias = bool | int | float | str | tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a node; all are read-only while the node runs.

    Attributes:
        name: as in ``--ros-args -p name:=value``.
        default: says the type too; an empty string means that one must be given. A list of
            strings is empty by default.
        meaning: one line, without the unit.
        unit: SI unit; empty for none.
        low: least value allowed, numbers only.
        high: largest value allowed, numbers only.
        choices: the values allowed, strings only; empty for any.
        required: whether the empty default is refused.
    """

    name: str
    default: Value
    meaning: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    required: bool = False

    @property
    def type(self) -> str:
        """``bool``, ``int``, ``double``, ``string`` or ``string[]``."""
        names = {bool: "bool", int: "int", float: "double", str: "string", tuple: "string[]"}
        return names[type(self.default)]

    @property
    def value_type(self) -> object:
        """What launch files give it as."""
        # launch_ros knows lists of strings by this name only
        return List[str] if isinstance(self.default, tuple) else type(self.default)  # noqa: UP006

    @property
    def limits(self) -> str:
        """The values allowed, in words; empty for any."""
        if self.choices:
            return " | ".join(self.choices)
        if self.low is None and self.high is None:
            return "required" if self.required else ""
        if self.high is None:
            return f">= {self.low:g}"
        return f"{self.low:g} to {self.high:g}"

    @property
    def summary(self) -> str:
        """The meaning with its unit."""
        return f"{self.meaning} [{self.unit}]" if self.unit else self.meaning

    @property
    def description(self) -> str:
        """The summary, what is allowed and the default."""
        allowed = f"; {self.limits}" if self.limits else ""
        default = f"; the node's default: {self.default}" if self.default not in ("", ()) else ""
        return f"{self.summary}{allowed}{default}"

    def check(self, value: Value) -> None:
        """Raise unless ``value``, of the right type, is one of those allowed.

        Raises:
            UsageError: naming the parameter, the value and what is expected.
        """
        if self.required and value == "":
            raise UsageError(f"parameter {self.name}: is not set; expected {self.meaning}")
        fits = (
            (not self.choices or value in self.choices)
            and (self.low is None or self.low <= value)  # type: ignore[operator]
            and (self.high is None or value <= self.high)  # type: ignore[operator]
        )
        if not fits:
            raise UsageError(f"parameter {self.name}: {value} found; expected {self.limits}")


_MODEL = Parameter("model", "", "a model file or a sample's name", required=True)
_LARGEST = 2**63 - 1
"""The largest int that a ROS parameter can hold."""


def _of_sensor(trouble: SensorFault) -> Parameter:
    """What may be wrong with the plant's sensor, as a parameter."""
    flag = isinstance(trouble.ideal, bool)
    low, high = (None, None) if flag else (trouble.low, trouble.high)
    name = f"sensor.{trouble.name}"
    return Parameter(name, trouble.ideal, trouble.meaning, trouble.unit, low=low, high=high)


PLANT = (
    _MODEL,
    Parameter("rate", 100.0, "true states published", "Hz", low=0.001, high=1e5),
    Parameter("epoch", 0, "stamp of t = 0; 0 for the clock at the start", "ns", low=0),
    Parameter(
        "duration", 0.0, "end after so much simulated time; 0 for never", "s", low=0.0, high=1e9
    ),
    Parameter("integrator", EVENT_DRIVEN, "exact, or time stepping", choices=INTEGRATORS),
    Parameter("step", DEFAULT_STEP, "of the integrator moreau", "s", low=1e-9, high=1.0),
    Parameter("publish_clock", False, "own the time and publish /clock"),
    Parameter("clock_rate", 100.0, "of /clock, per simulated second", "Hz", low=0.1, high=1e4),
    Parameter(
        "realtime_factor",
        1.0,
        "simulated seconds a second; not 1 needs publish_clock",
        low=0.001,
        high=1000.0,
    ),
    Parameter("wait_for_subscribers", 0, "begin when each topic has so many", low=0, high=1000),
    Parameter("seed", 0, "of everything random, recorded with the model", low=0),
    *map(_of_sensor, SENSOR_FAULTS),
)
OBSERVER = (
    _MODEL,
    Parameter("law", "geometric", "name of the observer's law"),
    Parameter("initial_state", "zero", "q1,..,qn,u1,..,un, random:SEED or zero"),
    Parameter("initial_deviation", "1", "standard deviations of that: one number, or 2n"),
    Parameter(
        "clock_error",
        -1.0,
        "standard deviation of the events' stamps; below 0: learnt from them",
        "s",
        low=-1.0,
        high=0.1,
    ),
    Parameter(
        "clock_offset_error",
        0.0,
        "standard deviation of what all stamps are late by",
        "s",
        low=0.0,
        high=0.1,
    ),
    Parameter(
        "missed",
        0.1,
        "minimum-variance: probability that an impact is not heard",
        low=0.0,
        high=0.9,
    ),
    Parameter("spurious", 0.1, "likewise, that nothing has happened", low=0.0, high=0.9),
    Parameter("mislabelled", 0.01, "likewise, that it was another contact", low=0.0, high=0.9),
    Parameter(
        "model_error", 0.0, "of accelerations, as white noise", "m/s^1.5", low=0.0, high=1e6
    ),
    Parameter(
        "estimate_parameters",
        (),
        "minimum-variance: of the model, learnt with the state, such as [restitution=0.1]",
    ),
    Parameter(
        "parameter_drift",
        0.0,
        "share of their deviations by which these go astray in a minute",
        low=0.0,
        high=1e3,
    ),
    Parameter(
        "ensemble", 10, "replicas run together, to see whether they agree", low=1, high=1_000_000
    ),
    Parameter(
        "agreed", 1e-4, "V distance of agreement over the motion's energy", low=1e-30, high=1.0
    ),
    Parameter("rate", 100.0, "estimates published", "Hz", low=0.001, high=1e5),
    Parameter("epoch", 0, "stamp of t = 0; 0 to learn it from the events", "ns", low=0),
    Parameter("history", 10.0, "how late an event may be and still be applied", "s", low=0.001),
    Parameter("lag", 0.0, "estimates are of so long ago; at most history", "s", low=0.0, high=1e9),
    Parameter("future", 1.0, "how far ahead of the clock a stamp may be", "s", low=0.0, high=1e9),
    Parameter(
        "events_durability",
        "volatile",
        "of the subscription to impacts",
        choices=("volatile", "transient_local"),
    ),
    Parameter(
        "rehearsal",
        0.1,
        "share of its time, at most, in which the node runs the last event again, so that the"
        " next is answered at once; 0 for never",
        low=0.0,
        high=0.5,
    ),
    Parameter(
        "compiled",
        False,
        "minimum-variance: machine code for what an event takes, by numba: half a minute once,"
        " then a second at each start",
    ),
)
DETECTOR = (
    Parameter("sources", "", "a file of sensors, or a sample's name", required=True),
    Parameter("epoch", 0, "stamp of t = 0 that events carry; 0 for unknown", "ns", low=0),
)
MONITOR = (
    _MODEL,
    Parameter("law", "", "named in the messages; empty for the observer's topic"),
)
VIEWER = (
    _MODEL,
    Parameter("observers", "observer", "names of the observers to show, with commas"),
    Parameter("frame", "world", "in which the markers are"),
    Parameter("rate", 25.0, "markers published", "Hz", low=0.1, high=1000.0),
    Parameter(
        "reach",
        0.0,
        "how far a body moves, to space them; 0 for the model's",
        "m",
        low=0.0,
        high=1e6,
    ),
)
TABLES: Mapping[str, tuple[Parameter, ...]] = {
    "plant": PLANT,
    "detector": DETECTOR,
    "observer": OBSERVER,
    "monitor": MONITOR,
    "viewer": VIEWER,
}


class Values:
    """The values of a node's parameters, by name and type."""

    def __init__(self, values: Mapping[str, Value]) -> None:
        self._values = values

    def value(self, name: str) -> Value:
        """A parameter as it is."""
        return self._values[name]

    def text(self, name: str) -> str:
        """A string parameter."""
        return str(self._values[name])

    def number(self, name: str) -> float:
        """A double parameter."""
        return float(self._number(name))

    def integer(self, name: str) -> int:
        """An int parameter."""
        return int(self._number(name))

    def texts(self, name: str) -> tuple[str, ...]:
        """A list of strings, without empty ones."""
        value = self._values[name]
        assert isinstance(value, tuple), "a list of strings"
        return tuple(filter(None, value))

    def flag(self, name: str) -> bool:
        """A bool parameter."""
        return bool(self._values[name])

    def _number(self, name: str) -> float:
        value = self._values[name]
        assert isinstance(value, (int, float)), "its default is a number"
        return value


def declare(node: "Node", table: tuple[Parameter, ...]) -> Values:
    """Declare a table's parameters on ``node`` and read them.

    Raises:
        UsageError: a parameter of the wrong type, out of range, or missing.
    """
    from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
    from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException

    values: dict[str, Value] = {}
    for each in table:
        descriptor = ParameterDescriptor(
            description=each.summary,
            additional_constraints=each.limits,
            read_only=True,
        )
        if each.low is not None and each.type == "int":
            to = _LARGEST if each.high is None else int(each.high)
            descriptor.integer_range = [IntegerRange(from_value=int(each.low), to_value=to)]
        elif each.low is not None:
            to_value = 1e300 if each.high is None else float(each.high)
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(each.low), to_value=to_value)
            ]
        try:
            value = _declared(node, each, descriptor)
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            article = "an" if each.type == "int" else "a"
            wanted = ", ".join(filter(None, (f"{article} {each.type}", each.limits)))
            raise UsageError(f"parameter {each.name}: expected {wanted}: {error}") from None
        each.check(value)
        values[each.name] = value
    return Values(values)


def _declared(node: "Node", each: Parameter, descriptor: "ParameterDescriptor") -> Value:
    """The value of a parameter that is declared now."""
    if each.default != ():
        value: Value = node.declare_parameter(each.name, each.default, descriptor).value
        return value
    # An empty list has no type in ROS, whichever way it comes; one empty string stands for it.
    return tuple(node.declare_parameter(each.name, [""], descriptor).value or ())


def check(table: tuple[Parameter, ...], values: Mapping[str, Value]) -> None:
    """Raise unless all ``values`` that the table knows are allowed.

    Raises:
        UsageError: naming the parameter, the value and what is expected.
    """
    for each in table:
        if each.name in values:
            each.check(values[each.name])


def markdown(table: tuple[Parameter, ...]) -> str:
    """The table as the README shows it."""
    rows = [
        "| parameter | type | default | unit | allowed | meaning |",
        "|---|---|---|---|---|---|",
    ]
    for p in table:
        default = str(p.default).lower() if isinstance(p.default, bool) else p.default
        cells = (
            f"`{p.name}`",
            p.type,
            f"`{default}`" if default not in ("", ()) else "",
            p.unit,
            p.limits.replace("|", "\\|"),
            p.meaning,
        )
        rows.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return "\n".join(rows)
