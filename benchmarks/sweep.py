# SPDX-License-Identifier: Apache-2.0
"""How fast sweeps are, and how they scale: ``./dev bench sweep``.

The first table is of the whole command, from its start to its end: 10 000 starts of three_mass
over a minute, with the law geometric, in two processes. The least time of the rounds counts, as
others use the machine too; processor time is that of all processes.

For the second table a small sweep is run by one process, by two of joblib's, and by a local Dask
cluster of two workers with a thread each, in turn in every round. It has three laws that differ
tenfold in cost, with and without jitter. Before anything is timed all three engines have run
once, so that processes are started and modules imported, and their files must be equal byte for
byte. It has medians of the rounds; the speedup is the time of one process over that of the engine
in the same round. In the row `2 copies` two processes at once do the whole work each, and it
counts twice: the most that two cores can give.
"""

import argparse
import json
import logging
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory

from distributed import LocalCluster
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.harness import DisagreementError, new_file
from impact_observer.model import read_model
from impact_observer.sweep.case_runs import Outcome, run_batch
from impact_observer.sweep.engines import run_batches
from impact_observer.sweep.model_variants import model_variants
from impact_observer.sweep.outcomes_file import write_outcomes
from impact_observer.sweep.plan import Case, PlantSetup, Sweep, sensors_of

STARTS = 10_000
GOAL = 5.0
"""Of the whole command, s."""
LAWS = ("geometric", "unilateral", "minimum-variance")
JITTER = (0.0, 1e-3)
WORKERS = 2
Engine = Callable[[Sequence[tuple[Case, ...]]], "Iterator[Outcome]"]


def swept(runs: int) -> Sweep:
    """Half a minute of two masses."""
    model = read_model("two_mass")
    return Sweep(
        PlantSetup(model.text()),
        LAWS,
        sensors_of({"jitter": JITTER}),
        model_variants(model, {}),
        runs,
    )


@contextmanager
def engines() -> Iterator[dict[str, Engine]]:
    """The engines, by name."""
    with LocalCluster(
        n_workers=WORKERS,
        threads_per_worker=1,
        dashboard_address=None,
        silence_logs=logging.CRITICAL,
    ) as cluster:
        address = cluster.scheduler_address
        yield {
            "1 process": lambda batches: run_batches(batches, jobs=1),
            "2 processes": lambda batches: run_batches(batches, jobs=WORKERS),
            "Dask, 2 workers": lambda batches: run_batches(batches, scheduler=address),
        }


def check_equal(sweep: Sweep, contestants: Mapping[str, Engine]) -> None:
    """Check that all engines make the same file.

    Raises:
        DisagreementError: they do not.
    """
    found: dict[str, bytes] = {}
    with TemporaryDirectory() as folder:
        for name, engine in contestants.items():
            outcomes = {each.case: each for each in engine([*sweep.batches()])}
            path = Path(folder) / "sweep.parquet"
            write_outcomes(path, sweep, outcomes)
            found[name] = path.read_bytes()
            if any(each.error for each in outcomes.values()):
                raise DisagreementError(f"{name}: a case has failed")
    if len(set(found.values())) > 1:
        raise DisagreementError("the engines do not make the same file")


def seconds(work: Callable[[], object]) -> float:
    """The time of ``work``."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def command(folder: Path) -> tuple[float, float]:
    """Time and processor time of the whole command with ``STARTS``, s."""
    path = folder / "starts.parquet"
    words = ["three_mass", "--runs", str(STARTS), "--duration", "60", "--jobs", str(WORKERS)]
    program = "import sys; from impact_observer.cli.main import main; sys.exit(main())"
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", program, "sweep", *words, "--json", "-o", str(path)],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    taken, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    path.unlink()
    return taken, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def serial(runs: int) -> None:
    """All cases in this process."""
    for batch in swept(runs).batches():
        run_batch(batch)


def measured(runs: int, rounds: int) -> dict[str, list[float]]:
    """Seconds of each engine in each round; ``2 copies`` is the most that the machine can do."""
    sweep = swept(runs)
    batches = [*sweep.batches()]
    times: dict[str, list[float]] = {}
    with engines() as contestants, ProcessPoolExecutor(WORKERS, get_context("spawn")) as pool:
        check_equal(sweep, contestants)
        list(pool.map(serial, [1] * WORKERS))
        for _ in track(range(rounds), "rounds", console=Console(stderr=True), transient=True):
            for name, engine in contestants.items():
                taken = seconds(lambda engine=engine: list(engine(batches)))  # type: ignore[misc]
                times.setdefault(name, []).append(taken)
            taken = seconds(lambda: list(pool.map(serial, [runs] * WORKERS)))
            times.setdefault("2 copies", []).append(taken)
    return times


def rows(times: Mapping[str, Sequence[float]], size: int) -> list[dict[str, object]]:
    """Seconds, cases a second and the speedup of each engine; medians of the rounds."""
    one = times["1 process"]
    found: list[dict[str, object]] = []
    for name, taken in times.items():
        copies = WORKERS if name == "2 copies" else 1
        speedups = [copies * base / own for base, own in zip(one, taken, strict=True)]
        found.append(
            {
                "engine": name,
                "seconds": statistics.median(taken),
                "cases_per_second": copies * size / statistics.median(taken),
                "speedup": statistics.median(speedups),
                "least": min(speedups),
                "largest": max(speedups),
            }
        )
    return found


def main(args: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="./dev bench sweep", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--runs", type=int, default=4, metavar="N", help="seeds (default 4)")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="(default 5)")
    parser.add_argument("--json", type=new_file, metavar="FILE", help="write every time to FILE")
    given = parser.parse_args(args)
    if given.runs < 1 or given.rounds < 1:
        parser.error("argument --runs, --rounds: expected whole numbers above 0")
    size = swept(given.runs).size
    try:
        times = measured(given.runs, given.rounds)
    except DisagreementError as error:
        print(f"bench sweep: {error}", file=sys.stderr)
        return 1
    with TemporaryDirectory() as folder:
        whole = [command(Path(folder)) for _ in range(given.rounds)]
    best, processor = (min(each) for each in zip(*whole, strict=True))
    met = "met" if best <= GOAL else "not met"
    table = Table("command", "s", "processor s", "goal", "", box=box.SIMPLE_HEAD)
    table.add_row(f"{STARTS} starts", f"{best:.2f}", f"{processor:.2f}", f"<= {GOAL:g}", met)
    Console().print(table)
    table = Table(box=box.SIMPLE_HEAD, title=f"{size} cases, the same bits", title_justify="left")
    for heading in ("", "s", "cases/s", "speedup", "of the rounds"):
        table.add_column(heading, justify="right" if heading else "left")
    found = rows(times, size)
    for row in found:
        table.add_row(
            str(row["engine"]),
            f"{row['seconds']:.2f}",
            f"{row['cases_per_second']:.1f}",
            f"{row['speedup']:.2f}",
            f"{row['least']:.2f} to {row['largest']:.2f}",
        )
    Console().print(table)
    if given.json:
        document = {"cases": size, "rounds": given.rounds, "engines": found, "seconds": times}
        document |= {"starts": STARTS, "command": whole, "goal": GOAL}
        given.json.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
