# SPDX-License-Identifier: Apache-2.0
"""The nodes' parameters: one table for each node, by which they are declared and documented.

A parameter of a node is an ``Option``. An observer has those of ``options.OBSERVER_OPTIONS`` too,
a plant those of ``sensor_faults.SENSOR_FAULTS``.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.options import (
    OBSERVER_OPTIONS,
    Option,
    Value,
)
from impact_observer.sensor_faults import MEASUREMENT_RATE, SENSOR_FAULTS

if TYPE_CHECKING:
    from rcl_interfaces.msg import ParameterDescriptor
    from rclpy.node import Node

_MODEL = Option("model", "", "a model file or the name of a sample", required=True)
_AUTOSTART = Option(
    "autostart",
    True,
    "configure and activate the node at its start; false: by its transitions of the life cycle",
)
_INPUT_TIMEOUT = Option(
    "input_timeout",
    1.0,
    "longest time without a sample of a live force",
    "s",
    low=0.001,
    high=1e9,
)
_FUTURE = Option(
    "future",
    1.0,
    "how far ahead of the clock a stamp may be; an event further ahead waits",
    "s",
    low=0.0,
    high=1e9,
)
_MAX_MESSAGE = Option(
    "max_message",
    1_000_000,
    "longest message of events, states or samples; a longer one is refused and counted",
    "bytes",
    low=100,
    high=1_000_000_000,
)
_LARGEST = 2**63 - 1
"""The largest int that a ROS parameter can hold."""

_MEASUREMENTS = Option(
    "measurements",
    "",
    "a file of sensors beside the impacts, or the name of a sample; empty: no sensors",
)
PLANT = (
    _MODEL,
    Option("rate", 100.0, "rate of the true states", "Hz", low=0.001, high=1e5),
    Option("epoch", 0, "stamp of t = 0; 0: the time of the clock at the start", "ns", low=0),
    Option("duration", 0.0, "simulated time until the end; 0: no end", "s", low=0.0, high=1e9),
    Option("publish_clock", False, "publish /clock, the source of simulated time"),
    Option("clock_rate", 100.0, "rate of /clock in simulated time", "Hz", low=0.1, high=1e4),
    Option(
        "realtime_factor",
        1.0,
        "simulated seconds per second; a factor other than 1 needs publish_clock",
        low=0.001,
        high=1000.0,
    ),
    Option(
        "wait_for_subscribers",
        0,
        "subscribers on impacts and on the true states to wait for before the start",
        low=0,
        high=1000,
    ),
    Option("seed", 0, "seed of the random generator; recorded with the model", low=0),
    _INPUT_TIMEOUT,
    replace(
        _FUTURE, meaning="how far ahead of the clock a sample may be; a sample further ahead waits"
    ),
    *(replace(each, name=f"sensor.{each.name}") for each in SENSOR_FAULTS),
    _MEASUREMENTS,
    MEASUREMENT_RATE,
    _MAX_MESSAGE,
    _AUTOSTART,
)
OBSERVER = (
    _MODEL,
    *OBSERVER_OPTIONS,
    Option("rate", 100.0, "rate of the estimates", "Hz", low=0.001, high=1e5, live=True),
    Option(
        "lag",
        0.0,
        "delay of the estimates; at most history",
        "s",
        low=0.0,
        high=1e9,
        live=True,
    ),
    _FUTURE,
    _INPUT_TIMEOUT,
    _MEASUREMENTS,
    Option(
        "wait_for_measurements",
        False,
        "publish nothing until each sensor of measurements has had a sample",
    ),
    _MAX_MESSAGE,
    _AUTOSTART,
)
DETECTOR = (
    Option("sources", "", "a file of sensors, or the name of a sample", required=True),
    Option("epoch", 0, "stamp of t = 0 that events carry; 0: unknown", "ns", low=0),
    _MAX_MESSAGE,
    _AUTOSTART,
)
MONITOR = (
    _MODEL,
    Option("law", "", "name of the law in the messages; empty: the name of the observer node"),
    _MAX_MESSAGE,
    _AUTOSTART,
)
TABLES: Mapping[str, tuple[Option, ...]] = {
    "plant": PLANT,
    "detector": DETECTOR,
    "observer": OBSERVER,
    "monitor": MONITOR,
}


def declare(node: "Node", table: tuple[Option, ...]) -> dict[str, Any]:
    """Declare the parameters of ``table`` on ``node``, and read their values.

    Returns:
        The values by name, each of the type of its default.

    Raises:
        UsageError: a parameter is of the wrong type, out of range, or missing.
    """
    from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
    from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException

    values: dict[str, Any] = {}
    for each in table:
        descriptor = ParameterDescriptor(
            description=each.summary,
            additional_constraints=each.limits,
            read_only=not each.live,
            dynamic_typing=each.type == "double",  # a whole number is one too
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
        if each.type == "double" and type(value) is int:
            value = float(value)
        each.check(value)
        values[each.name] = value
    return values


def _declared(node: "Node", each: Option, descriptor: "ParameterDescriptor") -> Value:
    """Declare one parameter, and return its value."""
    if each.default != ():
        value: Value = node.declare_parameter(each.name, each.default, descriptor).value
        return value
    # An empty list has no type in ROS; a list of one empty string stands for an empty list.
    return tuple(filter(None, node.declare_parameter(each.name, [""], descriptor).value or ()))


def on_change(
    node: "Node",
    table: tuple[Option, ...],
    check: Callable[[Mapping[str, Value]], None],
    apply: Callable[[Mapping[str, Value]], None],
) -> None:
    """Let the live parameters of ``table`` be set while ``node`` runs.

    Args:
        node: the node that has declared the parameters.
        table: the parameters of the node.
        check: raises ``UsageError`` if new values, by name, do not fit the others.
        apply: uses new values that are allowed.
    """
    from rcl_interfaces.msg import SetParametersResult
    from rclpy.parameter import Parameter

    rows = {each.name: each for each in table if each.live}

    def known(given: Iterable[Parameter]) -> dict[str, Value]:
        return {each.name: each.value for each in given if each.name in rows}

    def allowed(given: list[Parameter]) -> SetParametersResult:
        values = known(given)
        try:
            for name, value in values.items():
                rows[name].check(value)
            check(values)
        except ImpactObserverError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(allowed)
    node.add_post_set_parameters_callback(lambda given: apply(known(given)))
