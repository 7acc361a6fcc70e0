# SPDX-License-Identifier: Apache-2.0
"""Arguments that the kernel was not made for: errors, never crashes or undefined behaviour."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from impact_observer.kernel import _kernel

ROOT = Path(__file__).resolve().parents[2]
SANITIZERS = (
    "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all"
    " -fno-sanitize=null,vptr,object-size"
)
"""A null pointer ends the process anyway, casts to derived classes are dynamic, and the sizes of
objects are known only with optimisation: these checks took a quarter of the compiling."""
LIBRARIES = ("libasan.so", "libstdc++.so")
"""Which must be loaded before everything else."""


def library(name: str) -> str:
    """The path of a library of the compiler, or its name alone where there is none."""
    command = ["g++", f"-print-file-name={name}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def sanitized(folder: Path) -> dict[str, str]:
    """The environment of a process with a kernel that ends it at undefined behaviour."""
    if shutil.which("g++") is None or not all(Path(library(x)).is_absolute() for x in LIBRARIES):
        pytest.skip("no g++ with sanitizers: apt install build-essential")
    command = [sys.executable, "setup.py", "-q", "build_ext", "--debug", f"-b{folder}"]
    flags = dict.fromkeys(("CFLAGS", "CXXFLAGS", "LDFLAGS"), SANITIZERS)  # by setuptools' version
    compiler = {"CC": "gcc", "CXX": "g++"}
    environment = os.environ | flags | compiler
    subprocess.run([*command, f"-t{folder}"], cwd=ROOT, env=environment, check=True)
    return {
        "KERNEL_FILE": str(next(folder.rglob("_kernel.*.so"))),
        "LD_PRELOAD": " ".join(map(library, LIBRARIES)),
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1:max_allocation_size_mb=4096",
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "FEWER_EXAMPLES": "1",
    }


def end_of(environment: dict[str, str], *arguments: str) -> str:
    """What a Python process prints; it must end by itself."""
    path = os.pathsep.join(map(str, (ROOT, ROOT / "test")))
    done = subprocess.run(
        [sys.executable, "-m", *arguments],
        env=os.environ | environment | {"PYTHONPATH": path},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    at = max(done.stderr.find("ERROR: "), done.stderr.find("runtime error: "), 2000)
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[at - 2000 : at + 2000]}"
    return done.stdout


def assert_all_tried(printed: str) -> None:
    """Each function has been called with wrong arguments, and accepted neither all nor NaN."""
    found = json.loads(printed)
    assert found
    for name, counts in found.items():
        assert sum(counts.values()) > counts.get("returned", 0), f"{name}: {counts}"
        assert "accepted NaN" not in counts, f"{name}: {counts}"


@pytest.mark.slow
def test_wrong_arguments_are_errors_and_never_crash() -> None:
    """Of any shape, order, type, alignment, size and value, in a process of their own."""
    here = {"KERNEL_FILE": str(_kernel.__file__)}
    assert_all_tried(end_of(here, "kernel_fuzz", "1", "20"))


@pytest.mark.slow
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    """At wrong arguments, and in the tests of the kernel that are not slow."""
    environment = sanitized(tmp_path)
    assert_all_tried(end_of(environment, "kernel_fuzz", "2", "15"))
    arguments = ("-p", "kernel_loaded", "-p", "no:cacheprovider", "-q", "-m", "not slow")
    assert " passed" in end_of(environment, "pytest", *arguments, "test/kernel")
