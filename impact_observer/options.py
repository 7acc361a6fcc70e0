# SPDX-License-Identifier: Apache-2.0
"""The table of the options of an observer: name, type, default, unit, range and meaning.

Command lines, node parameters, launch files, the YAML samples in ``config/nodes`` and
``docs/commands.md`` are made from these rows. The module imports no NumPy and no ROS.
"""

import math
from dataclasses import dataclass, field, fields, replace
from inspect import cleandoc
from typing import List, TypeAlias, TypeVar  # noqa: UP035

from impact_observer.errors import UnsetError, UsageError

SETTLED = 1e-2
"""Default of the ratio V over V at the start below which an estimate has settled."""
_LAST_STAMP = 2**31 * 1_000_000_000 - 1
"""Equal to the whole seconds of ``stamps.MAX_STAMP``, without an import of NumPy."""

Value: TypeAlias = bool | int | float | str | tuple[str, ...]
_Default = TypeVar("_Default", bound=Value)


@dataclass(frozen=True, slots=True)
class Option:
    """One option.

    Attributes:
        name: name of the field, of the node parameter and, with hyphens, of the flag.
        default: default value, whose type is the option's; empty if the option is required.
        meaning: one line, without the unit.
        unit: SI unit; empty for none.
        low: least value allowed; only for numbers.
        high: largest value allowed; only for numbers.
        choices: the values allowed; only for strings; empty for any.
        required: whether the empty default is refused.
        short: a shorter flag of the command line beside that of ``name``; empty for none.
        metavar: name of the value in ``--help``.
        live: whether a value may be set while a node runs.
    """

    name: str
    default: Value
    meaning: str
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    required: bool = False
    short: str = ""
    metavar: str = ""
    live: bool = False

    @property
    def type(self) -> str:
        """``bool``, ``int``, ``double``, ``string`` or ``string[]``, as ROS calls them."""
        names = {bool: "bool", int: "int", float: "double", str: "string", tuple: "string[]"}
        return names[type(self.default)]

    @property
    def value_type(self) -> object:
        """The type as launch files name it."""
        # launch_ros knows a list of strings only as typing.List[str].
        return List[str] if isinstance(self.default, tuple) else type(self.default)  # noqa: UP006

    @property
    def limits(self) -> str:
        """The values allowed, in words; empty for any."""
        if self.choices:
            return " | ".join(self.choices)
        if self.type == "bool":
            return "true | false"
        if self.low is None:
            return "required" if self.required else ""
        low = f"{self.low:g}"
        if self.high is None:
            return f">= {low}"
        return f"{low} to {self.high:d}" if self.type == "int" else f"{low} to {self.high:g}"

    @property
    def expected(self) -> str:
        """The type and the values allowed, for error lines."""
        kinds = {"int": "a whole number, ", "string": "a text", "string[]": "a tuple of texts"}
        kind = "" if self.choices else kinds.get(self.type, "")
        return f"{kind}{self.limits} {self.unit}".strip(", ") or "a value"

    @property
    def summary(self) -> str:
        """The meaning with its unit."""
        return f"{self.meaning} [{self.unit}]" if self.unit else self.meaning

    @property
    def description(self) -> str:
        """The summary, the values allowed and the default, for launch files."""
        allowed = f"; {self.limits}" if self.limits else ""
        default = f"; the node's default: {self.default}" if self.default not in ("", ()) else ""
        return f"{self.summary}{allowed}{default}"

    @property
    def long_flag(self) -> str:
        """The flag of the command line, such as ``--clock-error``."""
        return f"--{self.name.replace('_', '-')}"

    def check(self, value: Value, kind: str = "parameter") -> None:
        """Check that ``value`` is of the option's type, and is allowed.

        Args:
            value: the value to check.
            kind: how the error line calls the option.

        Raises:
            UsageError: ``value`` is not allowed; names option, value and what is expected.
        """
        if self.required and value == "":
            line = f"{kind} {self.name}: is not set; expected {self.meaning}"
            raise UnsetError(self.name, line)
        if not self._allows(value):
            raise UsageError(f"{kind} {self.name}: {value} found; expected {self.expected}")

    def _allows(self, value: Value) -> bool:
        """Whether the value is of the right type and within its range."""
        if isinstance(value, bool) or isinstance(self.default, bool):
            return isinstance(value, bool) and isinstance(self.default, bool)
        if isinstance(self.default, (int, float)):
            if not isinstance(value, int if self.type == "int" else (int, float)):
                return False
            low = -math.inf if self.low is None else self.low
            high = math.inf if self.high is None else self.high
            return low <= value <= high and abs(value) < math.inf
        return type(value) is type(self.default) and (not self.choices or value in self.choices)


def option(
    default: _Default,
    meaning: str,
    unit: str = "",
    *,
    low: float | None = None,
    high: float | None = None,
    short: str = "",
    metavar: str = "",
) -> _Default:
    """Make a field of a dataclass of options; the arguments are those of ``Option``."""
    row = Option("", default, meaning, unit, low, high, short=short, metavar=metavar)
    return field(default=default, metadata={"option": row})


def rows_of(options: type) -> tuple[Option, ...]:
    """The options of a dataclass whose fields are made by ``option``."""
    return tuple(replace(each.metadata["option"], name=each.name) for each in fields(options))


@dataclass(frozen=True)
class Options:
    """All options of an observer; ``observer.make_observer`` makes an observer of them.

    Raises:
        UsageError: a value is of the wrong type, or not in its range.
    """

    law: str = option("geometric", "law by which events correct the estimate")
    initial_state: str = option(
        "zero",
        "initial state: q1,..,qn,u1,..,un, in m or rad and m/s or rad/s; or random:SEED, drawn"
        " with standard deviations of 1 m and 1 m/s; or zero",
        short="initial",
        metavar="STATE",
    )
    initial_deviation: str = option(
        "1",
        "standard deviations of the initial state, in the units of initial_state: one number, or"
        " 2n numbers; check-model suggests deviations for a small rig",
        metavar="D",
    )
    clock_error: float = option(
        -1.0,
        "standard deviation of the stamps of events beyond their rounding to 1 ns; negative:"
        " learned from the events",
        "s",
        low=-1.0,
        high=0.1,
    )
    clock_offset_error: float = option(
        0.0,
        "standard deviation of a constant delay of all stamps, to be estimated; 0: no delay",
        "s",
        low=0.0,
        high=0.1,
    )
    missed: float = option(
        0.1,
        "minimum-variance: probability of a missed detection",
        low=0.0,
        high=0.9,
    )
    spurious: float = option(
        0.1,
        "minimum-variance: probability (not a rate) that an event is a false positive",
        low=0.0,
        high=0.9,
    )
    mislabelled: float = option(
        0.01,
        "minimum-variance: probability that an impact is reported for another contact",
        low=0.0,
        high=0.9,
    )
    dead_time: float = option(
        0.0,
        "minimum-variance: time after an event during which the sensor reports no other hit of"
        " the contact; such a hit is no missed detection",
        "s",
        low=0.0,
        high=10.0,
    )
    model_error: float = option(
        -1.0,
        "process noise: white noise of the accelerations; 0: the model is exact; negative: learned"
        " from the events, as is an error of the restitution",
        "m/s^1.5",
        low=-1.0,
        high=1e6,
        metavar="A",
    )
    estimate_parameters: tuple[str, ...] = option(
        (),
        "minimum-variance: parameters of the model to estimate with the state, by the names of"
        " identify --free, optionally with standard deviations, such as restitution=0.1",
        metavar="NAME[=D],...",
    )
    ensemble: int = option(
        10,
        "number of replicas, whose distances show convergence",
        low=1,
        high=1_000_000,
    )
    epoch: int = option(
        0, "stamp of t = 0 of the forcing; 0: taken from events", "ns", low=0, high=_LAST_STAMP
    )
    history: float = option(
        10.0,
        "how long after its stamp an event may arrive and still be applied",
        "s",
        low=0.001,
        high=1e9,
    )

    def __post_init__(self) -> None:
        """Check every value."""
        for row in OBSERVER_OPTIONS:
            row.check(getattr(self, row.name), "option")


OBSERVER_OPTIONS = rows_of(Options)
Options.__doc__ = "\n".join(
    [cleandoc(Options.__doc__ or ""), "\nAttributes:"]
    + [f"    {each.name}: {each.summary}" for each in OBSERVER_OPTIONS]
)


def highest(name: str) -> float:
    """The largest value allowed of an observer's option; infinite for no limit.

    Raises:
        KeyError: there is no such option.
    """
    high = {each.name: each.high for each in OBSERVER_OPTIONS}[name]
    return math.inf if high is None else high
