# SPDX-License-Identifier: Apache-2.0
"""How fast the commands and the observer node are.

The figures are differences of two commands, so the start of Python does not count. Beside the
plant is Siconos, an event-driven simulator in C++, where its headers are installed.
"""

import shutil
import subprocess
import time
from functools import partial
from pathlib import Path

from benchmarks.checkout import HERE, Checkout, FailedError, Figure, Figures, Row
from benchmarks.rigs import chain, fast

RUN, LONG = 30.0, 3000.0
"""Duration of a plant's run that is shown, and of that which is timed, s."""
SECONDS, FIRST = 12.0, 6.0
"""Length of a recording for the filter, after its begin, s; chains of 100 masses hit after 5 s."""
TROUBLES = ("--jitter", "1e-4", "--missed", "0.2", "--spurious")
STARTS = 100
PROBLEM = (
    *(2, RUN, 1e-3, 1e-12, 2.5, 0.5, 0.7),
    *(1, 0, 0, 1, 0.2, -0.1, -0.1, 0.1, 20, -10, -10, 10, 0, -1, 0, 4, 0.1, -0.2, 0.5, 0),
)
"""two_mass as ``siconos_plant.cpp`` reads it: n, duration, step, tolerance, frequency, gap,
restitution, M, C, K, W, cosine, position, velocity."""
_HEADERS = Path("/usr/include/siconos")


def plant(checkout: Checkout, folder: Path, _: int) -> Figures:
    """A run of two_mass of 30 s with its bag of impacts; of Siconos with states at 1 kHz."""
    how = ("--rate", "0.01", "-o")
    long = checkout.run(folder, "simulate", "two_mass", "--duration", LONG, *how, "long").seconds
    short = checkout.run(folder, "simulate", "two_mass", "--duration", RUN, *how, "short").seconds
    found = {"30 s": Figure((long - short) * RUN / (LONG - RUN), "s")}
    if (seconds := siconos(folder)) is not None:
        found["30 s by Siconos"] = Figure(seconds, "s")
    return found


def siconos(folder: Path) -> float | None:
    """Time of Siconos for two_mass, s; None where Siconos or a compiler is missing."""
    compiler = shutil.which("g++")
    if compiler is None or not (_HEADERS / "kernel" / "SiconosKernel.hpp").exists():
        return None
    program, given = folder / "siconos_plant", folder / "problem.txt"
    folders = [_HEADERS, *(each for each in _HEADERS.rglob("*") if each.is_dir())]
    command = [compiler, "-O3", "-DNDEBUG", "-std=c++17", *(f"-I{each}" for each in folders)]
    command += [str(HERE / "benchmarks" / "siconos_plant.cpp"), "-o", str(program)]
    command += ["-lsiconos_kernel", "-lsiconos_numerics"]
    subprocess.run(command, check=True, capture_output=True)
    given.write_text(" ".join(map(str, PROBLEM)) + "\n", "utf-8")
    with subprocess.Popen(
        [program, given], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        begin = 0.0
        for line in process.stdout:  # Siconos prints other lines, too
            if line.strip() == "ready":
                begin = time.perf_counter()
                process.stdin.write("run\n")
                process.stdin.flush()
            if line.strip() == "done":
                seconds = time.perf_counter() - begin
                process.stdin.close()
                return seconds
    return None


def chains(checkout: Checkout, folder: Path, _: int) -> Figures:
    """Runs of chains of many masses with three stops."""
    found = {}
    for n in (20, 100):
        model = folder / f"chain_{n}.yaml"
        model.write_text(chain(n), "utf-8")
        taken = []
        for seconds in (220.0, 20.0):
            how = ("--duration", seconds, "--rate", "0.05", "-o", f"chain_{n}_{seconds:g}")
            taken.append(checkout.run(folder, "simulate", model, *how).seconds)
        found[f"20 s of {n} masses"] = Figure((taken[0] - taken[1]) / 10, "s")
    return found


def filter_cost(
    checkout: Checkout, folder: Path, seed: int, *, text: str, troubles: tuple[str, ...]
) -> Figures:
    """``observe --law minimum-variance`` for a recorded second with true states at 100 Hz."""
    (folder / "model.yaml").write_text(text, "utf-8")
    taken = []
    for seconds in (SECONDS + FIRST, FIRST):
        bag = f"bag_{seconds:g}"
        how = ("--duration", seconds, "--seed", seed, *troubles, "-o", bag)
        checkout.run(folder, "simulate", "model.yaml", *how)
        words = ("observe", bag, "--law", "minimum-variance", "-o", f"{bag}_observed")
        taken.append(checkout.run(folder, *words).seconds)
    return {"a recorded second": Figure((taken[0] - taken[1]) / SECONDS, "s")}


def observe(checkout: Checkout, folder: Path, _: int) -> Figures:
    """``geometric`` on a minute of ten hits a second with true states at 1 kHz, and ``smooth``."""
    (folder / "model.yaml").write_text(fast(12.75, 1.0), "utf-8")
    for seconds in (5, 65):
        how = ("--duration", seconds, "--rate", "1000", "-o", f"bag_{seconds}")
        checkout.run(folder, "simulate", "model.yaml", *how)
    found = {}
    for name, words in {"observe": ("observe",), "smooth": ("smooth", "--rate", "10")}.items():
        command, *options = words
        long, short = (
            checkout.run(
                folder, command, f"bag_{seconds}", *options, "-o", f"{name}_{seconds}"
            ).seconds
            for seconds in (65, 5)
        )
        found[f"{name}, a recorded second"] = Figure((long - short) / 60, "s")
    return found


def commands(checkout: Checkout, folder: Path, _: int) -> Figures:
    """The commands of README and tutorial on half a minute of two_mass, with Python's start."""
    bag, clock = ("--duration", RUN, "--seed", 1, "-o", "bag"), ("--clock-error", "1e-4")
    lines = (
        ("simulate", "two_mass", *bag),
        ("check", "bag"),
        ("check-model", "two_mass"),
        ("observe", "bag", "-o", "estimate"),
        ("plot", "estimate", "-o", "motion.png"),
        ("compare", "estimate"),
        ("export", "estimate", "-o", "table.csv"),
        ("identify", "bag", "--free", "restitution,gap", *clock, "-o", "fitted.yaml"),
        ("smooth", "bag", *clock, "-o", "smoothed"),
        ("demo",),
    )
    return {each[0]: Figure(checkout.run(folder, *each).seconds, "s") for each in lines}


def sweep(checkout: Checkout, folder: Path, _: int) -> Figures:
    """Starts of three_mass, each observed for 20 s."""
    taken = []
    for runs in (STARTS + 1, 1):
        how = ("--runs", runs, "--duration", "20", "--jobs", "1", "-o", f"{runs}.parquet")
        taken.append(checkout.run(folder, "sweep", "three_mass", *how).seconds)
    return {f"{STARTS} starts": Figure(taken[0] - taken[1], "s")}


def topic(checkout: Checkout, folder: Path, _: int) -> Figures:
    """Round trips by topics; see ``benchmarks/topic.py``."""
    del folder
    try:
        from benchmarks import topic as trips  # noqa: PLC0415 (only where ROS is)
    except ImportError as error:
        raise FailedError(f"no ROS here ({error}): source Jazzy, or ./dev setup") from None
    return trips.topic(checkout)


_FILTERED = {
    "filter, drill, exact": (fast(), ()),
    "filter, drill, 20 % missed, 5 false a second": (fast(), (*TROUBLES, "5")),
    "filter, 20 masses, jitter": (chain(20), TROUBLES[:2]),
    "filter, 20 masses, 20 % missed, 2 false a second": (chain(20), (*TROUBLES, "2")),
    "filter, 100 masses, jitter": (chain(100), TROUBLES[:2]),
}
ROWS = (
    Row("plant", "how long does a plant's run take?", plant),
    Row("chains", "how long do runs of many masses take?", chains),
    *(
        Row(name, "what does the filter cost?", partial(filter_cost, text=text, troubles=troubles))
        for name, (text, troubles) in _FILTERED.items()
    ),
    Row("observe", "what does a recorded second cost?", observe),
    Row("commands", "how long do README's commands take?", commands),
    Row("sweep", "how long do many runs take?", sweep),
    Row("topic", "how late is an estimate after its event, by topics?", topic),
)
"""Rows of ``./dev bench speed``."""
