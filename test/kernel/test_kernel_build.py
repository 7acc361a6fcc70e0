# SPDX-License-Identifier: Apache-2.0
"""A kernel that is missing, stale or cannot be built is an error that gives the remedy."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from impact_observer import kernel

PACKAGE = Path(kernel.__file__).parents[1]
IMPORT = """
import sys
sys.path.insert(0, sys.argv[1])
try:
    import impact_observer.kernel
except ImportError as error:
    print(error)
"""
REMEDY = "run ./dev setup, or pip install --no-build-isolation -e ."


def delete_sources(folder: Path) -> None:
    """As in a wheel."""
    for path in folder.glob("*.[ch]pp"):
        path.unlink()


def change_sources(folder: Path) -> None:
    """A comment more."""
    with (folder / "dynamics.cpp").open("a", encoding="utf-8") as file:
        file.write("// changed\n")


def delete_kernel(folder: Path) -> None:
    """As in a fresh clone."""
    for path in folder.glob("*.so"):
        path.unlink()


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (delete_sources, None),
        (change_sources, "was built from other sources"),
        (delete_kernel, "is not built"),
    ],
)
def test_import_names_the_remedy_for_a_missing_or_stale_kernel(
    tmp_path: Path, change: Callable[[Path], None], problem: str | None
) -> None:
    """An ImportError of one line; a wheel has no sources and needs none."""
    folder = tmp_path / PACKAGE.name / "kernel"
    shutil.copytree(PACKAGE / "kernel", folder)
    for name in ("__init__.py", "errors.py"):
        shutil.copy(PACKAGE / name, folder.parent)
    change(folder)
    command = [sys.executable, "-c", IMPORT, str(tmp_path)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert printed == (f"impact_observer.kernel {problem}: {REMEDY}\n" if problem else "")


def last_error(tmp_path: Path, **environment: str) -> str:
    """The last line of the standard error of a build in ``tmp_path`` with this environment."""
    command = [sys.executable, "setup.py", "-q", "build_ext", f"-b{tmp_path}", f"-t{tmp_path}"]
    done = subprocess.run(
        command,
        cwd=PACKAGE.parent,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_building_without_a_compiler_is_one_line(tmp_path: Path) -> None:
    """The line names the packages that are missing."""
    compiler = str(tmp_path / "g++")
    last = last_error(tmp_path, CXX=compiler)
    assert last == f"error: no C++ compiler {compiler}: sudo apt install build-essential"


@pytest.mark.slow
@pytest.mark.skipif(
    Path("/usr/include/pybind11").exists(), reason="the compiler finds the headers of Ubuntu"
)
def test_building_without_pybind11_is_one_line(tmp_path: Path) -> None:
    """The line names the packages of pip and of Ubuntu."""
    (tmp_path / "pybind11.py").write_text("raise ModuleNotFoundError\n")
    last = last_error(tmp_path, PYTHONPATH=str(tmp_path), CXX="g++")
    assert (
        last
        == "error: g++ finds no pybind11: pip install pybind11, or sudo apt install pybind11-dev"
    )
