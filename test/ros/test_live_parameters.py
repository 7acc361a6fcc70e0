# SPDX-License-Identifier: Apache-2.0
"""Parameters that are set while a node runs, by services that another process calls."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

import yaml  # type: ignore[import-untyped]
from diagnostic_msgs.msg import DiagnosticArray
from impact_observer_msgs.msg import EventVerdict, ImpactEvent, ObserverState
from processes import Spinner, ros_arguments, running_node, spinning
from rcl_interfaces.msg import Parameter as Given
from rcl_interfaces.srv import GetParameters, ListParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_value_to_python
from rosgraph_msgs.msg import Clock

from impact_observer.io.interfaces import EVENTS, STATES, Quality
from impact_observer.io.messages import read_estimate
from impact_observer.model import read_model
from impact_observer.observer import Observer, Options, initial_state, make_observer
from impact_observer.observer.make_observer import declared_by
from impact_observer.plant import Plant, simulate
from impact_observer.ros.topics import qos_profile, ros_messages
from impact_observer.stamps import NS_PER_S, grid

pytestmark = pytest.mark.ros

EPOCH = 5_000_000_000
BEFORE = Options(
    "minimum-variance", "random:1", clock_error=1e-3, spurious=0.05, epoch=EPOCH, dead_time=0.01
)
CHANGE = {"clock_error": 1e-5, "missed": 0.3, "initial_deviation": "2"}


def parameters_of(spinner: Spinner, node: str) -> dict[str, object]:
    """All parameters that a node lists, with their values."""
    names = spinner.call(ListParameters, f"{node}/list_parameters").result.names
    values = spinner.call(GetParameters, f"{node}/get_parameters", names=names).values
    return dict(zip(names, map(parameter_value_to_python, values), strict=True))


def file_of(parameters: dict[str, object]) -> str:
    """The text that ``ros2 param dump`` prints: names with dots are nested."""
    nested: dict[str, Any] = {}
    for name, value in parameters.items():
        *groups, last = name.split(".")
        place = nested
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = value
    return str(yaml.dump({"/**": {"ros__parameters": nested}}, default_flow_style=False))


def redeclared(observer: Observer, stamp: int) -> None:
    """Make the change on an observer without ROS."""
    options = replace(BEFORE, **CHANGE)  # type: ignore[arg-type]
    declared = declared_by(options, observer.system, observer.law.uncertainty)
    law = type(observer.law)(observer.system, declared)
    observer.redeclare(law, *initial_state(BEFORE.initial_state, observer.system), stamp)


def test_what_a_node_says_of_its_parameters_is_a_file_that_it_loads(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """With the read-only ones, and with a value that was set while the node ran."""
    given = {"model": "two_mass", "law": "minimum-variance", "rate": 20}
    plant = {"model": "two_mass", "sensor.jitter": 0.001}
    with (
        spinning() as spinner,
        running_node("observer", ros_arguments(given), ros_environment),
        running_node("plant", ros_arguments(plant), ros_environment),
    ):
        missed = Given(name="missed", value=Parameter("missed", value=0.25).get_parameter_value())
        name = "observer/set_parameters_atomically"
        answer = spinner.call(SetParametersAtomically, name, parameters=[missed])
        assert answer.result.successful, answer.result.reason
        said = {node: parameters_of(spinner, node) for node in ("observer", "plant")}
    assert said["observer"]["missed"] == 0.25
    with spinning() as spinner:
        for node, parameters in said.items():
            path = tmp_path / f"{node}.yaml"
            path.write_text(file_of(parameters), encoding="utf-8")
            arguments = ["--ros-args", "--params-file", str(path)]
            with running_node(node, arguments, ros_environment):
                assert parameters_of(spinner, node) == parameters


def test_a_change_acts_from_a_published_stamp_and_can_be_repeated(
    ros_environment: dict[str, str],
) -> None:
    """An observer without ROS that changes at that stamp gives the same estimate, in every bit."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    impacts = simulate(plant, grid(EPOCH, EPOCH + 8 * NS_PER_S, 1.0)).events
    ours = {
        "law": BEFORE.law,
        "initial_state": f"'{BEFORE.initial_state}'",
        "clock_error": BEFORE.clock_error,
        "spurious": BEFORE.spurious,
        "dead_time": BEFORE.dead_time,
        "epoch": EPOCH,
    }
    arguments = ros_arguments({"model": "two_mass", "use_sim_time": True, "rate": 10.0, **ours})
    states, verdicts, said = list[ObserverState](), list[EventVerdict](), dict[str, str]()

    def on_diagnostics(array: DiagnosticArray) -> None:
        for status in array.status:
            said.update({each.key: each.value for each in status.values})

    with running_node("observer", arguments, ros_environment), spinning() as spinner:
        probe, many = spinner.probe, qos_profile(Quality(depth=1000))
        clock = probe.create_publisher(Clock, "/clock", qos_profile(STATES))
        events = probe.create_publisher(ImpactEvent, "impacts", qos_profile(EVENTS))
        probe.create_subscription(ObserverState, "observer/state", states.append, many)
        probe.create_subscription(EventVerdict, "observer/verdicts", verdicts.append, many)
        probe.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, many)
        spinner.until(lambda: clock.get_subscription_count() and events.get_subscription_count())

        def go_on(begin: int, end: int) -> None:
            """Send the impacts from ``begin`` to ``end``, s since the epoch, and the clock."""
            some = [e for e in impacts if begin * NS_PER_S <= e.stamp - EPOCH < end * NS_PER_S]
            for each in some:
                clock.publish(ros_messages().clock(each.stamp))
                spinner.settle(0.02)
                count = len(verdicts)
                events.publish(ros_messages().event(each))
                spinner.until(lambda count=count: len(verdicts) > count)  # type: ignore[misc]
            clock.publish(ros_messages().clock(EPOCH + end * NS_PER_S))
            spinner.until(lambda: states and states[-1].header.stamp.sec >= 5 + end)

        go_on(0, 4)
        given = [
            Given(name=name, value=Parameter(name, value=value).get_parameter_value())
            for name, value in CHANGE.items()
        ]
        name = "observer/set_parameters_atomically"
        answer = spinner.call(SetParametersAtomically, name, parameters=given)
        assert answer.result.successful, answer.result.reason
        spinner.until(lambda: "clock_error was set to" in said)
        go_on(4, 8)
    value, _, since = said["clock_error was set to"].partition(" from ")
    assert value == "1e-05"
    stamp = int(since.removesuffix(" ns on"))
    assert stamp == EPOCH + 4 * NS_PER_S
    same = make_observer(model, BEFORE)
    for each in impacts:
        if each.stamp >= stamp and same.law.uncertainty.clock_error == BEFORE.clock_error:
            redeclared(same, stamp)
        if each.stamp < EPOCH + 8 * NS_PER_S:
            same.receive(each)
    last = read_estimate(states[-1])[1]
    wanted = same.estimate(last.stamp)
    assert last.q.tobytes() == wanted.q.tobytes()
    assert last.covariance.tobytes() == wanted.covariance.tobytes()
