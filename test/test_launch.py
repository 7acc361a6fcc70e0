# SPDX-License-Identifier: Apache-2.0
"""The launch files and the nodes' parameter files: alone, against the demo command, and run."""

import contextlib
import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import types
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import launch_stand_ins
import pytest
from launch_stand_ins import load_yaml

from impact_observer.cli.demo import LAWS
from impact_observer.cli.main import main
from impact_observer.io.interfaces import INTERFACES
from impact_observer.options import Option
from impact_observer.ros.parameters import TABLES
from impact_observer.ros.wiring import DemoSetup, local_discovery, monitors, observers, plant

ROOT = Path(__file__).parents[1]
LAUNCH_FILES = sorted(ROOT.glob("launch/*.launch.py"))
PARAMETER_FILES = sorted(ROOT.glob("config/nodes/*.yaml"))
EPOCH = 1_700_000_000_123_456_789

ARGUMENTS = {
    "demo": {"model", "laws", "duration", "realtime_factor", "initial_state", "rate", "epoch"}
    | {"record"},
    "robot": {
        "record",
        "model",
        "measurements",
        "measurement_rate",
        "clock_error",
        "rate",
        "duration",
    },
    "plant": {p.name for p in TABLES["plant"]} | {"use_sim_time", "params_file", "namespace"},
    "detector": {p.name for p in TABLES["detector"]}
    | {"use_sim_time", "params_file", "namespace", "impacts"},
    "observer": {p.name for p in TABLES["observer"]}
    | {
        "use_sim_time",
        "params_file",
        "name",
        "namespace",
        "impacts",
        "monitor",
        "monitor_name",
        "record",
    },
}


@dataclass
class Started:
    """A node as it is started."""

    executable: str
    name: str = ""
    namespace: str = "/"
    parameters: dict[str, Any] = field(default_factory=dict)
    remappings: dict[str, str] = field(default_factory=dict)


def started(executable: str, arguments: Sequence[str]) -> Started:
    """The node that ``executable`` becomes under ``arguments`` such as ``--ros-args -p a:=b``."""
    node = Started(executable)
    flags = [argument for argument in arguments if argument != "--ros-args"]
    for flag, value in zip(flags[::2], flags[1::2], strict=True):
        if flag == "--params-file":
            (parameters,) = load_yaml(Path(value).read_text(encoding="utf-8")).values()
            node.parameters |= parameters["ros__parameters"]
            continue
        left, right = value.split(":=")
        if flag == "-p":
            node.parameters[left] = load_yaml(right)
        elif left == "__node":
            node.name = right
        elif left == "__ns":
            node.namespace = right
        else:
            node.remappings[left] = right
    return node


def described(node: launch_stand_ins.Node, context: launch_stand_ins.LaunchContext) -> Started:
    """The same of a node of a stand-in."""
    made = Started(node.executable, node.name, f"/{node.namespace.strip('/')}")
    for each in node.parameters:
        if isinstance(each, str):
            (parameters,) = load_yaml(Path(each).read_text(encoding="utf-8")).values()
            made.parameters |= parameters["ros__parameters"]
        else:
            made.parameters |= {name: value.evaluate(context) for name, value in each.items()}
    made.remappings = dict(node.remappings)
    assert node.package == ("impact_observer" if node.executable in TABLES else node.executable)
    return made


@dataclass
class Launcher:
    """Launch, real or a stand-in; it returns what it would start, and starts no process."""

    launch: ModuleType
    nodes: list[Started]
    commands: list[list[str]] = field(default_factory=list)

    def load(self, name: str) -> Any:  # noqa: ANN401 (launch has no types)
        """The description in a launch file."""
        return self.load_file(ROOT / "launch" / f"{name}.launch.py")

    def load_file(self, path: Path) -> Any:  # noqa: ANN401 (launch has no types)
        """The same of any file."""
        sources = importlib.import_module("launch.launch_description_sources")
        return sources.get_launch_description_from_python_launch_file(str(path))

    def run(self, file: str | Path, **given: str) -> list[Started]:
        """What ``ros2 launch`` starts."""
        context = self.launch.LaunchContext()
        context.launch_configurations.update(given)
        self.nodes.clear()
        self.commands.clear()
        entities = [self.load(file) if isinstance(file, str) else self.load_file(file)]
        while entities:
            entities = (entities.pop(0).visit(context) or []) + entities
        if isinstance(context, launch_stand_ins.LaunchContext):
            self.commands = context.processes
            return [described(node, context) for node in context.nodes]
        return list(self.nodes)


@pytest.fixture
def launcher(monkeypatch: pytest.MonkeyPatch) -> Launcher:
    """The real launch; where it is missing, the stand-ins."""
    if importlib.util.find_spec("launch_ros") is None:
        launch_stand_ins.put_in_place(monkeypatch)
        return Launcher(importlib.import_module("launch"), [])
    launch_ros = importlib.import_module("launch_ros.actions")
    launch = importlib.import_module("launch")
    perform = importlib.import_module("launch.utilities").perform_substitutions
    nodes: list[Started] = []
    commands: list[list[str]] = []

    def execute(action: Any, context: Any) -> None:  # noqa: ANN401
        words = [perform(context, list(part)) for part in action.cmd]
        if isinstance(action, launch_ros.Node):
            nodes.append(started(action.node_executable, words[1:]))
        else:
            commands.append(words)

    monkeypatch.setattr(launch_ros.Node.__mro__[1], "execute", execute)
    return Launcher(launch, nodes, commands)


def demo_nodes(duration: float) -> list[Started]:
    """What the demo command starts."""
    pytest.importorskip("rclpy")
    demonstration = importlib.import_module("impact_observer.ros.demonstration")
    setup = DemoSetup("three_mass", LAWS, "random:7", duration, 4.0, 200.0, EPOCH)
    nodes = (*observers(setup), *monitors(setup), plant(setup, recorders=1))
    commands = [demonstration.node_arguments(node) for node in nodes]
    return [started(name, rest) for _, name, *rest in commands]


def by_name(node: Started) -> str:
    """The name of a node, for sorting."""
    return node.name


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_launch_file_compiles_and_names_only_executables_of_the_package(path: Path) -> None:
    """What setup.py installs is what the files start."""
    text = path.read_text(encoding="utf-8")
    assert "generate_launch_description" in compile(text, str(path), "exec").co_names
    installed = re.findall(r'"(\w+) = impact_observer\.ros', (ROOT / "setup.py").read_text())
    ours = re.findall(r'package="impact_observer",\s+executable="(\w+)"', text)
    assert set(ours) <= set(installed)


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.name)
def test_nodes_of_a_launch_file_end_with_it_and_may_be_local(path: Path) -> None:
    """Every process gets the environment that lets it follow, and the range of discovery."""
    text = path.read_text(encoding="utf-8")
    assert text.count("additional_env=following(),") == len(re.findall(r"\bNode\(\n", text)) > 0
    assert text.index("*local_discovery(),") < text.index("OpaqueFunction(function=")


def test_local_launches_are_discovered_on_this_machine_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Off by default; the environment is set before any node starts (launch is stood in for)."""
    module: Any = types.ModuleType("launch")
    for name in ("DeclareLaunchArgument", "SetEnvironmentVariable", "IfCondition"):
        setattr(module, name, lambda *given, _name=name, **named: (_name, given, named))
    module.LaunchConfiguration = str
    for name in ("launch", "launch.actions", "launch.conditions", "launch.substitutions"):
        monkeypatch.setitem(sys.modules, name, module)
    declared, discovery = local_discovery()
    assert declared[1] == ("local",)
    assert declared[2]["default_value"] == "false"
    assert discovery[1] == ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    assert discovery[2]["condition"][:2] == ("IfCondition", ("local",))


def test_every_launch_file_is_tested() -> None:
    """A new launch file needs its arguments listed here."""
    assert {path.name.partition(".")[0] for path in LAUNCH_FILES} == set(ARGUMENTS)


@pytest.mark.parametrize("path", PARAMETER_FILES, ids=lambda path: path.name)
def test_parameter_file_holds_the_whole_table_at_its_defaults(path: Path) -> None:
    """Names, types and values are those of the table; only the required model is an example."""
    (parameters,) = load_yaml(path.read_text(encoding="utf-8")).values()
    values = parameters["ros__parameters"]
    for name, value in values.items():
        if isinstance(value, list):  # ROS parameters have no empty list
            values[name] = tuple(filter(None, value))
    assert values.pop("use_sim_time", False) is False
    assert list(values) == [each.name for each in TABLES[path.stem]]
    for each in TABLES[path.stem]:
        assert type(values[each.name]) is type(each.default), each.name
        each.check(values[each.name])
        assert each.required or values[each.name] == each.default, each.name


@pytest.mark.ros
@pytest.mark.usefixtures("ros_environment")
@pytest.mark.parametrize("path", PARAMETER_FILES, ids=lambda path: path.name)
def test_node_accepts_its_parameter_file(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A node of another name comes up with it, and misses and mistrusts nothing."""
    from processes import spinning

    from impact_observer.ros.entry import NODES

    module = importlib.import_module(f"impact_observer.ros.{path.stem}_node")
    with spinning(["--ros-args", "--params-file", str(path), "-r", "__node:=mine"]) as spinner:
        spinner.add(node := getattr(module, NODES[path.stem])())
        assert node.is_active
        assert node.get_name() == "mine"
    assert "does not exist" not in "".join(capfd.readouterr())


@pytest.mark.parametrize("name", ARGUMENTS)
def test_launch_file_declares_its_arguments(launcher: Launcher, name: str) -> None:
    """Each with a description and a default, as ``--show-args`` prints them."""
    arguments = launcher.load(name).get_launch_arguments()
    assert {argument.name for argument in arguments} == ARGUMENTS[name] | {"local"}
    assert all(argument.description for argument in arguments)
    assert all(argument.default_value is not None for argument in arguments)


@pytest.mark.parametrize("duration", [12.5, 0.0])
def test_demo_launch_starts_the_nodes_of_the_demo_command(
    launcher: Launcher, duration: float
) -> None:
    """The same executables, names, parameters and remappings, without the recorder."""
    launched = launcher.run(
        "demo",
        model="three_mass",
        duration=f"{duration:g}",
        realtime_factor="4",
        initial_state="random:7",
        rate="200",
        epoch=str(EPOCH),
    )
    commanded = demo_nodes(duration)
    for node in launched:
        if node.executable == "plant":
            node.parameters["wait_for_subscribers"] = len(LAWS) + 1
    assert sorted(launched, key=by_name) == sorted(commanded, key=by_name)
    kinds = [{k: type(v) for k, v in n.parameters.items()} for n in sorted(launched, key=by_name)]
    assert kinds == [
        {k: type(v) for k, v in n.parameters.items()} for n in sorted(commanded, key=by_name)
    ]


def test_demo_launch_has_the_defaults_of_the_demo_command(
    launcher: Launcher, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those of ``impact-observer demo --help``."""
    with pytest.raises(SystemExit):
        main(["demo", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    nodes = {node.name: node for node in launcher.run("demo")}
    plant = nodes["plant"].parameters
    assert f"a sample ({plant['model']})" in text
    for name in ("duration", "realtime_factor"):
        assert f"(default {plant[name]:g})" in text, name


def test_observer_launch_passes_only_what_is_given(launcher: Launcher) -> None:
    """The rest stays as the node has it; its topics keep their names."""
    (observer,) = launcher.run("observer", model="two_mass")
    remappings = {"impacts": "impacts"}
    assert observer == Started("observer", "observer", "/", {"model": "two_mass"}, remappings)


@pytest.mark.parametrize("state", ["random:1", "zero", "0.1,-0.2,0.5,0", "1,2,3,4", "1"])
def test_initial_state_arrives_as_a_string(launcher: Launcher, state: str) -> None:
    """Whatever YAML would make of it."""
    (observer,) = launcher.run("observer", model="two_mass", initial_state=state)
    assert observer.parameters["initial_state"] == state


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [("rate", "50", 50.0), ("epoch", str(EPOCH), EPOCH), ("use_sim_time", "true", True)],
)
def test_argument_arrives_with_the_type_of_its_parameter(
    launcher: Launcher, name: str, text: str, value: object
) -> None:
    """A double needs no point on the command line, and nanoseconds lose no digit."""
    (observer,) = launcher.run("observer", model="two_mass", **{name: text})
    assert (observer.parameters[name], type(observer.parameters[name])) == (value, type(value))


@pytest.mark.parametrize("name", ["plant", "observer"])
def test_argument_beats_the_parameter_file(launcher: Launcher, name: str) -> None:
    """The file gives the rest."""
    path = ROOT / "config" / "nodes" / f"{name}.yaml"
    (node,) = launcher.run(name, params_file=str(path), rate="20", namespace="rig")
    assert (node.parameters["rate"], node.parameters["model"]) == (20.0, "two_mass")
    assert (node.name, node.namespace) == (name, "/rig")


def test_detector_launch_passes_the_sensors_and_the_topic(launcher: Launcher) -> None:
    """Its events go where the observer of the rig listens."""
    (detector,) = launcher.run("detector", sources="rig.yaml", impacts="/rig/impacts", epoch="5")
    assert detector == Started(
        "detector",
        "detector",
        "/",
        {"sources": "rig.yaml", "epoch": 5},
        {"impacts": "/rig/impacts"},
    )


@pytest.mark.parametrize("template", ["ball", "chisel", "gear", "shaker"])
def test_the_launch_file_of_a_new_rig_starts_detector_and_observer(
    launcher: Launcher, template: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the files beside it; other parameters may be given, and the nodes know them all."""
    monkeypatch.chdir(tmp_path)
    assert main(["new", "rig", "--from", template]) == 0
    launched = launcher.run(tmp_path / "rig.launch.py", epoch="5", use_sim_time="true")
    given = {"epoch": 5, "use_sim_time": True}
    files = {
        "detector": {"sources": str(tmp_path / "rig_sensors.yaml")},
        "observer": {"model": str(tmp_path / "rig.yaml"), "law": "minimum-variance"},
    }
    assert [node.executable for node in launched] == list(files)
    for node in launched:
        assert node.parameters.items() >= (files[node.executable] | given).items()
        assert node.remappings == {"impacts": "impacts"}
        for each in TABLES[node.executable]:
            if each.name in node.parameters:
                each.check(node.parameters[each.name])


def test_observer_launch_starts_a_monitor_on_request(launcher: Launcher) -> None:
    """It subscribes to that observer and is given its own parameters only."""
    observer, monitor = launcher.run(
        "observer",
        model="rig.yaml",
        law="kinematic",
        rate="20",
        impacts="/rig/impacts",
        name="observer_kinematic",
        monitor="true",
        monitor_name="monitor_kinematic",
    )
    assert observer.remappings == {"impacts": "/rig/impacts"}
    assert monitor == Started(
        "monitor",
        "monitor_kinematic",
        "/",
        {"model": "rig.yaml", "law": "kinematic"},
        {"observer/joint_states": "observer_kinematic/joint_states"},
    )


@pytest.mark.parametrize("name", ["demo", "observer", "robot"])
def test_launches_with_observers_record_on_request(launcher: Launcher, name: str) -> None:
    """All topics, into the given folder; the demonstration's plant waits for the recorder."""
    launched = launcher.run(name)
    assert launcher.commands == []
    recorded = launcher.run(name, record="rig")
    (command,) = launcher.commands
    assert command[:3] == ["ros2", "bag", "record"]
    assert command[-2:] == ["-o", "rig"]
    wait = "wait_for_subscribers"
    added = sum(n.parameters.get(wait, 0) for n in recorded)
    assert added - sum(n.parameters.get(wait, 0) for n in launched) == (name == "demo")


def test_robot_launch_starts_plant_observer_and_frames(launcher: Launcher) -> None:
    """Plant and observer know the same error and encoders; estimates move the robot's own URDF."""
    from impact_observer.model import read_model

    plant, observer, frames = launcher.run("robot", rate="50", clock_error="0.001")
    assert (plant.name, observer.name) == ("plant", "observer")
    both = {"model": "hammer_arm", "measurements": "hammer_arm", "rate": 50.0}
    assert observer.parameters == {**both, "law": "minimum-variance", "clock_error": 0.001}
    assert plant.parameters == {
        **both,
        "measurement_rate": 100.0,
        "duration": 0.0,
        "sensor.jitter": 0.001,
    }
    robot = read_model("hammer_arm").robot
    assert robot is not None
    assert frames.executable == "robot_state_publisher"
    assert frames.parameters == {"robot_description": robot.known_urdf.text}
    assert frames.remappings == {
        "joint_states": "observer/joint_states",
        "robot_description": "observer/robot_description",
    }


@pytest.mark.parametrize("name", ARGUMENTS)
def test_what_is_launched_is_what_the_package_has(launcher: Launcher, name: str) -> None:
    """Executables, parameters with their values, and the topics that are given other names."""
    given = {
        "model": "two_mass",
        "sources": "switch",
        "impacts": "/rig/impacts",
        "monitor": "true",
    }
    known = {argument.name for argument in launcher.load(name).get_launch_arguments()}
    launched = launcher.run(name, **{key: each for key, each in given.items() if key in known})
    topics = {each.name for each in INTERFACES}
    ours = [node for node in launched if node.executable in TABLES]
    assert ours
    assert len({(node.namespace, node.name) for node in launched}) == len(launched)
    for node in ours:
        sim_time = Option("use_sim_time", False, "of ROS")
        table = {each.name: each for each in (*TABLES[node.executable], sim_time)}
        for parameter, value in node.parameters.items():
            table[parameter].check(value)
        assert node.remappings.keys() <= topics
        assert re.fullmatch(r"[a-z_]+", node.name)


@pytest.fixture
def ros2_launch(
    tmp_path: Path, ros_environment: dict[str, str]
) -> Callable[..., "subprocess.Popen[str]"]:
    """The command itself, with this package as colcon installed it."""
    index = pytest.importorskip("ament_index_python")
    pytest.importorskip("launch_ros")
    if shutil.which("ros2") is None:
        pytest.skip("no command ros2")
    try:
        index.get_package_prefix("impact_observer")
    except index.PackageNotFoundError:
        pytest.skip("impact_observer is not in the ament index; colcon build, then source it")

    def start(name: str, *arguments: str) -> "subprocess.Popen[str]":
        return subprocess.Popen(
            ["ros2", "launch", str(ROOT / "launch" / f"{name}.launch.py"), *arguments],
            env={**ros_environment, "ROS_LOG_DIR": os.fspath(tmp_path)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    return start


@pytest.mark.ros
@pytest.mark.slow
def test_demo_launch_runs_and_estimates(
    ros2_launch: Callable[..., "subprocess.Popen[str]"],
) -> None:
    """Estimates and errors of both laws come, and all ends with the plant, in good order."""
    from processes import spinning

    from impact_observer.io import interfaces
    from impact_observer.ros.topics import message_class, qos_profile

    quality = qos_profile(interfaces.STATES)
    received = {law: [0, 0] for law in LAWS}

    def count(law: str, kind: int) -> Callable[[object], None]:
        def add(_: object) -> None:
            received[law][kind] += 1

        return add

    with spinning() as spinner:
        for law in LAWS:
            topics = (
                (interfaces.JOINT_STATE, f"observer_{law}/joint_states"),
                (interfaces.ESTIMATE_ERROR, f"monitor_{law}/error"),
            )
            for kind, (type_name, topic) in enumerate(topics):
                spinner.probe.create_subscription(
                    message_class(type_name), topic, count(law, kind), quality
                )
        process = ros2_launch("demo", "duration:=6")
        try:
            spinner.until(lambda: process.poll() is not None, patience=90)
        finally:
            with contextlib.suppress(ProcessLookupError):  # the nodes, if any is left
                os.killpg(process.pid, signal.SIGKILL)
            output, _ = process.communicate()
    assert process.returncode == 0, output
    assert "process has died" not in output, output
    assert all(estimates > 200 and errors > 200 for estimates, errors in received.values()), (
        received
    )
