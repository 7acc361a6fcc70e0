"""Runs the missing cases of a sweep, and writes their outcomes from time to time."""

import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from impact_observer.sweep.case_runs import Outcome
from impact_observer.sweep.engines import run_cases
from impact_observer.sweep.outcomes_file import write_outcomes
from impact_observer.sweep.plan import Sweep

PERIOD = 5.0
"""Least time between two writings of the file, s."""
LOAD = 20.0
"""Least time between two writings, over the duration of the last one."""


def run_missing(
    sweep: Sweep,
    path: Path,
    outcomes: dict[int, Outcome],
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> None:
    """Run the cases that are not in ``outcomes`` yet, and write all outcomes to the file.

    Args:
        sweep: what is swept.
        path: the file of outcomes, also written after errors and interrupts.
        outcomes: by the numbers of their cases; new ones are added.
        jobs: processes on this machine; None for as many as it has cores.
        scheduler: address of a Dask scheduler, whose workers run the cases instead.
        progress: called with the number of outcomes.

    Raises:
        UsageError: a package is missing, or the scheduler cannot be used.
        SweepError: processes have died, or the file cannot be written.
        KeyboardInterrupt: with a line on what is done.
    """
    missing = [case for case in sweep.cases() if case.number not in outcomes]
    if not missing:
        return
    before = len(outcomes)
    progress(before)
    due = time.monotonic() + PERIOD
    try:
        with closing(run_cases(missing, jobs=jobs, scheduler=scheduler)) as finished:
            for outcome in finished:
                outcomes[outcome.case] = outcome
                progress(len(outcomes))
                if (start := time.monotonic()) >= due:
                    write_outcomes(path, sweep, outcomes)
                    end = time.monotonic()
                    due = end + max(PERIOD, LOAD * (end - start))
    except KeyboardInterrupt:
        done = f"{len(outcomes)} of {sweep.size} cases are done; the same command goes on"
        raise KeyboardInterrupt(done) from None
    finally:
        if len(outcomes) > before:
            write_outcomes(path, sweep, outcomes)
