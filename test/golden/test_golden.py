# SPDX-License-Identifier: Apache-2.0
"""The commands give what the version of the golden corpus gave; public names stay or are listed.

``README.md`` in this folder says how the corpus is made and how a change on purpose is named.
"""

import importlib
import re
from collections.abc import Mapping
from typing import Any

import pytest
from golden.comparing import differences, leaves
from golden.make import HERE, annotations, groups, names_of, public_modules, read, run_group
from ruamel.yaml import YAML

CORPUS = read()
EXCUSED = YAML(typ="safe").load(HERE / "changes.yaml")["changes"] or []
NAMES = YAML(typ="safe").load(HERE / "public_names.yaml")
OLD_NAMES = (HERE / "public_names.txt").read_text(encoding="utf-8").split()
QUICK = {
    "bag ball_on_table",
    "bag missed_and_spurious",
    "bag switch",
    "bag two_mass",
    "failed jobs",
    "models",
    "tables",
    "version 0_1",
    "version 0_2",
    "wrong use",
}
LONG = {"bag hammer", "bag rubbing_guide", "bag three_mass", "bag yielding_stop"}


def marks(group: str) -> list[pytest.MarkDecorator]:
    """How long the commands of a group take."""
    if group in LONG:
        return [pytest.mark.long]
    return [] if group in QUICK else [pytest.mark.slow]


GROUPS = [pytest.param(name, id=name, marks=marks(name)) for name in CORPUS]


def full_name(group: str, command: str, field: str) -> str:
    """The name of a figure, as the patterns in ``changes.yaml`` see it."""
    return f"{group} | {command} | {field}"


def excused(name: str) -> bool:
    """Whether a change of this figure is named in ``changes.yaml``."""
    return any(re.search(each["where"], name) for each in EXCUSED)


@pytest.mark.parametrize("group", GROUPS)
def test_commands_give_what_the_golden_corpus_has(group: str) -> None:
    """Exit codes, error lines, verdicts, estimates and figures, within their tolerances."""
    results = run_group(list(CORPUS[group]))
    lines = [
        f"{full_name(group, command, field)}: {line}"
        for command, wanted in CORPUS[group].items()
        for field, line in differences(command, wanted, results[command])
        if not excused(full_name(group, command, field))
    ]
    assert not lines, "\n".join([f"{len(lines)} differences:", *lines[:40]])


def test_the_corpus_has_every_bag_and_every_command() -> None:
    """No group of commands and no command is left out."""
    made = {group: [*commands] for group, commands in CORPUS.items()}
    assert made == groups()


def figures(group: str, command: str, given: Mapping[str, Any]) -> list[str]:
    """The names of all figures of a command."""
    return [
        full_name(group, command, leaf)
        for field in given
        for leaf, _ in leaves(field, given[field])
    ]


def test_every_excuse_names_a_figure_and_a_reason() -> None:
    """Each pattern in ``changes.yaml`` occurs in the corpus."""
    names = [
        name
        for group, commands in CORPUS.items()
        for command, given in commands.items()
        for name in figures(group, command, given)
    ]
    for each in EXCUSED:
        assert each["why"]
        assert any(re.search(each["where"], name) for name in names), each["where"]


def resolved(name: str) -> bool:
    """Whether a dotted name of a module's member exists."""
    words = name.split(".")
    for count in range(len(words) - 1, 0, -1):
        try:
            value: object = importlib.import_module(".".join(words[:count]))
        except ModuleNotFoundError:
            continue
        for word in words[count:]:
            annotated = {w for c in getattr(value, "__mro__", ()) for w in annotations(c)}
            if not hasattr(value, word) and word not in annotated:
                return False
            value = getattr(value, word, None)
        return True
    return False


def changed(name: str) -> str | None:
    """The entry of ``public_names.yaml`` for a name, or for its class or module."""
    words = name.split(".")
    for count in range(len(words), 1, -1):
        if (head := ".".join(words[:count])) in NAMES["moved"]:
            return ".".join([str(NAMES["moved"][head]), *words[count:]])
        if head in NAMES["gone"]:
            return None
    return name


def test_public_names_stay_unless_they_are_listed_as_moved_or_gone() -> None:
    """Every public name of the version before exists, or ``public_names.yaml`` has it."""
    missing = [
        name for name in OLD_NAMES if (today := changed(name)) is not None and not resolved(today)
    ]
    assert not missing, "\n".join(
        ["list these in test/golden/public_names.yaml, under moved or gone:", *missing]
    )


def test_names_that_are_listed_as_gone_or_moved_are_so() -> None:
    """No entry of ``public_names.yaml`` is out of date, and each gone name has a reason."""
    for name, why in NAMES["gone"].items():
        assert why, name
        assert not resolved(name), f"{name} is listed as gone and exists"
    for name, target in NAMES["moved"].items():
        assert resolved(str(target)), f"{name}: {target} does not exist"
    heads = [*NAMES["gone"], *NAMES["moved"]]
    unknown = [
        head
        for head in heads
        if not any(name == head or name.startswith(f"{head}.") for name in OLD_NAMES)
    ]
    assert not unknown, f"no public names of the version before: {unknown}"


def test_new_public_names_are_listed() -> None:
    """A public name that the version before did not have is listed as new, or as a target."""
    known = {*OLD_NAMES, *NAMES["new"], *map(str, NAMES["moved"].values())}
    today = [
        f"{module}.{name}"
        for module in public_modules()
        for name in names_of(importlib.import_module(module))
    ]
    new = [name for name in today if name not in known]
    assert not new, "\n".join(["list these in test/golden/public_names.yaml, under new:", *new])
