# SPDX-License-Identifier: Apache-2.0
"""Which of 48 changed operators, constants and comparisons the tests of a room find.

Each mutant changes one place of the code, in a copy of the repository. The tests of its room run
there until one fails or the time is over. First they have to pass without a change.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
TESTS = {
    "dynamics": ["test/dynamics"],
    "bank": ["test/bank", "test/observer"],
    "observer": ["test/observer"],
    "batch": ["test/batch"],
}
"""Rooms, and where their tests are."""
EACH, SEED = 12, 0
PAIRS: list[tuple[type[ast.AST], type[ast.AST]]] = [
    *((ast.Lt, ast.LtE), (ast.Gt, ast.GtE), (ast.Eq, ast.NotEq)),
    *((ast.Add, ast.Sub), (ast.Mult, ast.Div), (ast.And, ast.Or)),
]
SWAPS: dict[type[ast.AST], Any] = dict([*PAIRS, *((b, a) for a, b in PAIRS)])


class Mutant(NamedTuple):
    """One change of the code.

    Attributes:
        room: whose tests run.
        path: of the file, relative to the root.
        place: number of the changed node among all nodes of the file.
    """

    room: str
    path: Path
    place: int


def places(tree: ast.Module) -> Iterator[int]:
    """Numbers of the nodes that :func:`changed` can change."""
    for number, node in enumerate(ast.walk(tree)):
        operator = getattr(node, "op", None) or next(iter(getattr(node, "ops", ())), None)
        constant = isinstance(node, ast.Constant) and type(node.value) in {int, float}
        if type(operator) in SWAPS or isinstance(operator, ast.Not) or constant:
            yield number


def changed(source: str, place: int) -> tuple[str, str]:
    """The source with a change, and the line and text of the node before and after."""
    tree = ast.parse(source)
    node = list(ast.walk(tree))[place]
    before = ast.unparse(node)
    if isinstance(node, ast.Constant):
        node.value = node.value + 1 if type(node.value) is int else 1.5 * float(str(node.value))
        node.value = node.value or 1.0
    elif isinstance(node, ast.Compare):
        node.ops[0] = SWAPS[type(node.ops[0])]()
    elif isinstance(node, ast.UnaryOp):
        node.operand = ast.UnaryOp(ast.Not(), node.operand)
    elif isinstance(node, ast.BinOp | ast.BoolOp | ast.AugAssign):
        node.op = SWAPS[type(node.op)]()
    text = ast.unparse(ast.fix_missing_locations(tree))
    line = getattr(node, "lineno", 0)
    return text, f"line {line}: {before}  ->  {ast.unparse(node)}"


def mutants() -> list[Mutant]:
    """The same number from each room, in an order that the seed gives."""
    made = []
    chance = random.Random(SEED)
    for room in TESTS:
        files = sorted((ROOT / "impact_observer" / room).rglob("*.py"))
        found = [
            Mutant(room, file.relative_to(ROOT), place)
            for file in files
            for place in places(ast.parse(file.read_text(encoding="utf-8")))
        ]
        made += chance.sample(found, EACH)
    return made


def passes(room: str, copy: Path, jobs: str) -> bool:
    """Whether the tests of a room pass in time in a copy."""
    options = ["-x", "-q", "-n", jobs, "-p", "no:cacheprovider", "-m", "not ros and not long"]
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", *options, *TESTS[room]],
            cwd=copy,
            env=os.environ | {"PYTHONPATH": str(copy), "OPENBLAS_NUM_THREADS": "1"},
            capture_output=True,
            timeout=600.0,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def main(words: Sequence[str]) -> int:
    """Run the mutants that were asked for.

    Returns:
        0; 1 where tests fail without a change.
    """
    parser = argparse.ArgumentParser(prog="./dev bench mutants", description=__doc__)
    number = range(EACH * len(TESTS))
    parser.add_argument("--only", type=int, nargs="+", choices=number, metavar="N", help="these")
    parser.add_argument("--jobs", default="2", metavar="N", help="processes of pytest")
    asked = parser.parse_args(words)
    found, alive, chosen = mutants(), [], asked.only or number
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder, "copy")
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".*", "__pycache__", "build"))
        for room in dict.fromkeys(found[k].room for k in chosen):
            if not passes(room, copy, asked.jobs):
                print(f"{room}: its tests fail without a change", file=sys.stderr)
                return 1
        for k in chosen:
            mutant = found[k]
            source = (ROOT / mutant.path).read_text(encoding="utf-8")
            text, what = changed(source, mutant.place)
            (copy / mutant.path).write_text(text, encoding="utf-8")
            survived = passes(mutant.room, copy, asked.jobs)
            (copy / mutant.path).write_text(source, encoding="utf-8")
            alive += [k] * survived
            print(
                f"{k:2d} {'survived' if survived else 'killed  '} {mutant.path} {what}", flush=True
            )
    print(f"{len(chosen) - len(alive)} of {len(chosen)} killed; survived: {alive}")
    return 0
