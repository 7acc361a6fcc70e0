# SPDX-License-Identifier: Apache-2.0
"""The house: which rooms import which, and rules for tests."""

import ast
import gc
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import chain
from pathlib import Path

import pytest

from docs.rooms import ROOMS

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "impact_observer"
TESTS = ROOT / "test"
BENCHMARKS = ROOT / "benchmarks"

LEVELS = {room.name: level for level, rooms in enumerate(ROOMS, 1) for room in rooms}
"""The modules beside the rooms are the vocabulary, level 0."""
CORE = ("model", "dynamics", "robots", "plant", "bank", "observer")
ALLOWED = {"numpy", "scipy", "msgspec", *sys.stdlib_module_names} - {"argparse"}
ENTRANCE = {"__init__.py", "__main__.py"}
"""Modules beside the rooms that lead into them: they may import any room."""


def modules(*rooms: str) -> list[Path]:
    """All modules of the given rooms, or of the whole package."""
    folders = [PACKAGE / room for room in rooms] or [PACKAGE]
    return sorted(path for folder in folders for path in folder.rglob("*.py"))


def named(path: Path) -> str:
    """A module or test, as a reader would call it."""
    return str(path.relative_to(ROOT))


@cache
def imports(path: Path) -> tuple[str, ...]:
    """Full names of everything that a module imports, wherever in it."""
    return tuple(_imports(path))


def _imports(path: Path) -> Iterator[str]:
    package = path.relative_to(ROOT).parent.parts
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


@pytest.fixture(scope="module", autouse=True)
def without_garbage_collection() -> Iterator[None]:
    """It would go through all syntax trees again and again."""
    gc.disable()
    yield
    parsed.cache_clear()
    gc.enable()


@cache
def parsed(path: Path) -> ast.Module:
    """The syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def room(path: Path) -> str:
    """The room that a module lies in; empty for the vocabulary."""
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else ""


def room_of_name(name: str) -> str | None:
    """The room that an imported name lies in; None where it is not ours, or is a word."""
    parts = name.split(".")
    return parts[1] if parts[0] == PACKAGE.name and len(parts) > 1 and parts[1] in LEVELS else None


def test_every_room_has_its_place() -> None:
    """A new room must be put into the order above."""
    rooms = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    rooms |= {path.parent.name for path in PACKAGE.glob("*/*.py")}
    assert rooms <= set(LEVELS)


def test_modules_import_only_rooms_below_their_own() -> None:
    """Data flows one way; plant and observer do not import each other."""
    for path in modules():
        own = room(path)
        if not own and path.name in ENTRANCE:
            continue
        level = LEVELS.get(own, 0)
        for name in imports(path):
            other = room_of_name(name)
            allowed = other is None or other == own or LEVELS[other] < level
            assert allowed, f"{named(path)} imports {name}"


def test_core_needs_numpy_scipy_and_a_schema_only() -> None:
    """No ROS, no bags, no command line; YAML in one place, a schema for files."""
    extra = {"model/yaml_text.py": {"ruamel"}, "robots/pinocchio_model.py": {"pinocchio"}}
    for path in modules(*CORE):
        allowed = {PACKAGE.name, *ALLOWED, *extra.get(str(path.relative_to(PACKAGE)), ())}
        for name in imports(path):
            assert name.split(".")[0] in allowed, f"{named(path)} imports {name}"


def test_vocabulary_needs_numpy_only() -> None:
    """The modules beside the rooms import the least."""
    for path in PACKAGE.glob("*.py"):
        for name in imports(path) if path.name not in ENTRANCE else ():
            top = name.split(".")[0]
            assert top in {PACKAGE.name, *ALLOWED}, f"{named(path)} imports {name}"


def test_core_prints_nothing() -> None:
    """Results are returned, errors are raised."""
    for path in modules(*CORE):
        called = {
            node.func.id
            for node in ast.walk(parsed(path))
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        }
        assert not called & {"print", "input", "breakpoint"}, named(path)


def test_no_file_name_stands_twice() -> None:
    """A file is identified by its name."""
    stems = Counter(path.stem for path in modules() if path.name != "__init__.py")
    assert [stem for stem, count in stems.items() if count > 1] == []


def test_no_class_name_stands_twice() -> None:
    """A class name has one meaning in the whole package."""
    classes = Counter(
        node.name
        for path in modules()
        for node in parsed(path).body
        if isinstance(node, ast.ClassDef)
    )
    assert [name for name, count in classes.items() if count > 1] == []


def test_every_source_file_begins_with_its_licence() -> None:
    """Every source file that is not empty begins with one SPDX line."""
    for path in chain(modules(), TESTS.rglob("*.py"), BENCHMARKS.rglob("*.py")):
        first, _, _ = path.read_text(encoding="utf-8").partition("\n")
        assert first in {"", "# SPDX-License-Identifier: Apache-2.0"}, named(path)


def is_test(node: ast.AST) -> bool:
    """Whether pytest would run it."""
    return isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and node.name.startswith(
        "test_"
    )


def scopes(path: Path) -> Iterator[ast.Module | ast.ClassDef]:
    """Where pytest looks for tests: the file, its classes and theirs."""
    waiting: list[ast.Module | ast.ClassDef] = [parsed(path)]
    while waiting:
        scope = waiting.pop()
        waiting += [node for node in scope.body if isinstance(node, ast.ClassDef)]
        yield scope


def functions_of(path: Path) -> list[ast.FunctionDef]:
    """All test functions of a file, in classes too."""
    return [node for scope in scopes(path) for node in scope.body if is_test(node)]  # type: ignore[misc]


def called_name(call: ast.Call) -> str:
    """The last part of what is called."""
    function = call.func
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def asserts(test: ast.FunctionDef) -> bool:
    """Whether something in it can fail: assert, raises, fail or a helper named assert_..."""
    for node in ast.walk(test):
        if isinstance(node, ast.Assert):
            return True
        if isinstance(node, ast.Call):
            name = called_name(node)
            if name in {"raises", "warns", "fail"} or name.startswith("assert_"):
                return True
    return False


FILES = sorted(TESTS.rglob("test_*.py"))


def test_every_test_asserts_and_says_what() -> None:
    """A file has tests; a test has a docstring of its own and can fail."""
    for path in FILES:
        tests = functions_of(path)
        assert tests, f"{named(path)} has no test"
        for test in tests:
            assert asserts(test), f"{named(path)}::{test.name} asserts nothing"
            assert ast.get_docstring(test), f"{named(path)}::{test.name} has no docstring"


def test_no_test_is_hidden_by_another_of_its_name() -> None:
    """Of two functions of one name pytest runs the second only."""
    for path in FILES:
        for scope in scopes(path):
            names = [node.name for node in scope.body if is_test(node)]  # type: ignore[attr-defined]
            assert len(names) == len(set(names)), named(path)


def test_collecting_tests_has_no_side_effects() -> None:
    """No test file calls anything at its top level as a statement, but to be skipped."""
    for path in FILES:
        for node in parsed(path).body:
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
                skips = called_name(node.value) == "importorskip"
                assert skips, f"{named(path)} line {node.lineno}"
