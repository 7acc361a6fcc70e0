# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for ``launch`` and ``launch_ros``, which no package index has: what our files use.

They take the arguments of the real ones and no other, and evaluate as these do. A node is not
started: the context gets what would be.
"""

import runpy
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from types import ModuleType
from typing import Any, List  # noqa: UP035 (launch_ros knows a list only so)

import pytest
from ruamel.yaml import YAML


def load_yaml(text: str) -> Any:  # noqa: ANN401 (YAML holds anything)
    """What a YAML text holds, as plain values."""
    return YAML(typ="safe", pure=True).load(StringIO(text))


@dataclass
class LaunchContext:
    """The values of arguments, the environment, and the nodes and commands so far."""

    launch_configurations: dict[str, str] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    nodes: list["Node"] = field(default_factory=list)
    processes: list[list[str]] = field(default_factory=list)


@dataclass
class LaunchConfiguration:
    """The value of an argument, when it is asked for."""

    variable_name: str

    def perform(self, context: LaunchContext) -> str:
        """The text."""
        return context.launch_configurations[self.variable_name]


@dataclass
class IfCondition:
    """Whether a text is true."""

    predicate_expression: LaunchConfiguration

    def evaluate(self, context: LaunchContext) -> bool:
        """As ``launch`` does; a text that is neither is an error."""
        return {"true": True, "1": True, "false": False, "0": False}[
            self.predicate_expression.perform(context).strip().lower()
        ]


@dataclass(kw_only=True)
class Action(ABC):
    """What a description lists."""

    condition: IfCondition | None = None

    def visit(self, context: LaunchContext) -> list[Any] | None:
        """Act, unless the condition is false."""
        if self.condition is None or self.condition.evaluate(context):
            return self.execute(context)
        return None

    @abstractmethod
    def execute(self, context: LaunchContext) -> list[Any] | None:
        """Act; return what is to be visited next."""


@dataclass
class DeclareLaunchArgument(Action):
    """An argument with a default."""

    name: str
    default_value: str = field(kw_only=True)
    description: str = field(kw_only=True)

    def execute(self, context: LaunchContext) -> None:
        """Take the default unless a value was given."""
        assert isinstance(self.default_value, str)
        context.launch_configurations.setdefault(self.name, self.default_value)


@dataclass
class SetEnvironmentVariable(Action):
    """A variable of later processes."""

    name: str
    value: str

    def execute(self, context: LaunchContext) -> None:
        """Set it."""
        context.environment[self.name] = self.value


@dataclass(kw_only=True)
class OpaqueFunction(Action):
    """A function of the context that makes actions."""

    function: Callable[[LaunchContext], list[Any]]

    def execute(self, context: LaunchContext) -> list[Any]:
        """Call it."""
        return self.function(context)


@dataclass
class Shutdown(Action):
    """The end of the launch."""

    def execute(self, context: LaunchContext) -> None:
        """Nothing to start."""


@dataclass
class ParameterValue:
    """A parameter and its type."""

    value: Any
    value_type: Any = field(kw_only=True)

    def evaluate(self, context: LaunchContext) -> Any:  # noqa: ANN401 (a parameter's value)
        """The value; an argument's text is read as YAML and must be of the type."""
        kind = list if self.value_type == List[str] else self.value_type  # noqa: UP006
        if not isinstance(self.value, LaunchConfiguration):
            assert isinstance(self.value, kind), (self.value, kind)
            return self.value
        text = self.value.perform(context)
        if kind is str:
            return text
        found = load_yaml(text)
        found = float(found) if kind is float and type(found) is int else found
        assert type(found) is kind, (text, kind)
        return found


@dataclass(kw_only=True)
class Node(Action):
    """A node of a package."""

    package: str
    executable: str
    name: str
    namespace: str = ""
    parameters: Sequence[str | Mapping[str, ParameterValue]] = ()
    remappings: Sequence[tuple[str, str]] = ()
    output: str = "log"
    additional_env: Mapping[str, str] = field(default_factory=dict)
    on_exit: Action | None = None

    def execute(self, context: LaunchContext) -> None:
        """Keep it instead of starting a process."""
        context.nodes.append(self)


@dataclass(kw_only=True)
class ExecuteProcess(Action):
    """A command."""

    cmd: list[str]
    output: str = "log"

    def execute(self, context: LaunchContext) -> None:
        """Keep it instead of starting a process."""
        context.processes.append(self.cmd)


@dataclass
class LaunchDescription:
    """What a launch file describes."""

    entities: list[Any]

    def get_launch_arguments(self) -> list[DeclareLaunchArgument]:
        """The arguments, in order."""
        return [each for each in self.entities if isinstance(each, DeclareLaunchArgument)]

    def visit(self, context: LaunchContext) -> list[Any]:
        """All that is listed."""
        del context
        return self.entities


def from_file(path: str) -> LaunchDescription:
    """The description in a launch file."""
    made = runpy.run_path(path)["generate_launch_description"]()
    assert isinstance(made, LaunchDescription)
    return made


@dataclass
class PythonLaunchDescriptionSource:
    """A launch file that another one includes."""

    location: str


@dataclass
class IncludeLaunchDescription(Action):
    """The description in another file, with arguments."""

    source: PythonLaunchDescriptionSource
    launch_arguments: Iterable[tuple[str, str]] = field(default=(), kw_only=True)

    def execute(self, context: LaunchContext) -> list[Any]:
        """Set the arguments, as ``launch`` does for all that follows too."""
        context.launch_configurations.update(self.launch_arguments)
        return [from_file(self.source.location)]


MODULES: dict[str, dict[str, object]] = {
    "launch": {"LaunchContext": LaunchContext, "LaunchDescription": LaunchDescription},
    "launch.actions": {
        each.__name__: each
        for each in (
            DeclareLaunchArgument,
            ExecuteProcess,
            IncludeLaunchDescription,
            OpaqueFunction,
            SetEnvironmentVariable,
            Shutdown,
        )
    },
    "launch.conditions": {"IfCondition": IfCondition},
    "launch.launch_description_sources": {
        "PythonLaunchDescriptionSource": PythonLaunchDescriptionSource,
        "get_launch_description_from_python_launch_file": from_file,
    },
    "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration},
    "launch_ros": {},
    "launch_ros.actions": {"Node": Node},
    "launch_ros.parameter_descriptions": {"ParameterValue": ParameterValue},
}
"""Names that launch files import, by module."""


def put_in_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let launch files import the stand-ins."""
    for name, contents in MODULES.items():
        module = ModuleType(name)
        vars(module).update(contents)
        monkeypatch.setitem(sys.modules, name, module)
