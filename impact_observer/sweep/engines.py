"""What runs the cases of a sweep: processes of this machine by joblib, or a Dask cluster."""

import logging
import os
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from importlib.util import find_spec
from itertools import islice
from typing import TYPE_CHECKING

from impact_observer import __version__
from impact_observer.errors import SweepError, UsageError

if TYPE_CHECKING:
    from distributed import Client

    from impact_observer.sweep.case_runs import Outcome
    from impact_observer.sweep.plan import Case

_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "BLIS_NUM_THREADS")
_PATIENCE = 10.0
"""How long to wait for a scheduler, and for its first worker, s."""
_PARTING = 2.0
"""How long to wait for a scheduler at the end, s."""
_AHEAD = 4
"""Cases that a cluster has before it, for each of its threads."""
_INSTALL = "pip install impact_observer[sweep]"


def one_thread() -> None:
    """Let the linear algebra of this process run in one thread, if numpy is not imported yet.

    Threads of small matrices only wait for each other, and their number can change the last bit.
    """
    os.environ.update(dict.fromkeys(_THREADS, "1"))


def run_cases(
    cases: "Sequence[Case]", *, jobs: int | None = None, scheduler: str | None = None
) -> "Generator[Outcome, None, None]":
    """The outcomes of cases, as they are finished.

    Args:
        cases: in any order.
        jobs: processes on this machine; None for as many as it has cores.
        scheduler: address of a Dask scheduler, whose workers do it instead; None for none.

    Raises:
        UsageError: the package that is needed is not here, or the scheduler or its workers
            cannot be used.
        SweepError: processes have died.
    """
    return on_machine(cases, jobs) if scheduler is None else on_cluster(cases, scheduler)


def on_machine(cases: "Sequence[Case]", jobs: int | None) -> "Generator[Outcome, None, None]":
    """With processes of this machine."""
    try:
        import joblib
        from joblib.externals.loky.process_executor import BrokenProcessPool
    except ImportError as error:
        raise UsageError(f"sweep needs joblib ({error}); {_INSTALL}") from None
    from impact_observer.sweep.case_runs import run_case

    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        # One by one: laws differ so much in cost that batches leave cores idle.
        parallel = joblib.Parallel(
            n_jobs=-1 if jobs is None else jobs, return_as="generator_unordered", batch_size=1
        )
        try:
            with closing(parallel(joblib.delayed(run_case)(case) for case in cases)) as outcomes:
                yield from outcomes
        except BrokenProcessPool as error:
            line = str(error).splitlines()[0]
            raise SweepError(f"a process of the sweep has died: {line}") from None


def on_cluster(cases: "Sequence[Case]", scheduler: str) -> "Generator[Outcome, None, None]":
    """With the workers of a Dask cluster; those that come later are used too."""
    try:
        from distributed import as_completed
    except ImportError as error:
        raise UsageError(f"--scheduler needs Dask ({error}); {_INSTALL}") from None
    from impact_observer.observer import law_named
    from impact_observer.sweep.case_runs import run_case

    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # an error is told once, in one line
    with _connected(scheduler) as client:
        laws = {case.options.law for case in cases if case.options.compiled}
        if any(law_named(law).compiles for law in laws):
            _check_compilers(client, scheduler)
        waiting, under_way = iter(cases), 0
        running = as_completed(loop=client.loop, with_results=True)
        while True:
            try:
                free = _AHEAD * sum(client.ncores().values()) - under_way
                more = islice(waiting, max(free, 0))
                started = [client.submit(run_case, each, pure=False) for each in more]
                running.update(started)
                under_way += len(started)
                if not under_way:
                    return
                _, outcome = next(running)
                if isinstance(outcome, BaseException):  # what is cancelled is not raised
                    raise outcome
            except Exception as error:  # noqa: BLE001 (of workers and schedulers that went away)
                line = " ".join(f"{type(error).__name__}: {error}".split())
                raise SweepError(f"{scheduler}: {line}") from None
            under_way -= 1
            yield outcome


@contextmanager
def _connected(scheduler: str) -> "Iterator[Client]":
    """A client of a cluster whose workers have this version of the package."""
    from distributed import Client
    from distributed import TimeoutError as LateError  # not the builtin one in Python 3.10
    from distributed.comm import resolve_address

    try:
        resolve_address(scheduler)  # a client of no address is slow to say so
        client = Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        line = " ".join(str(error).split())
        raise UsageError(f"--scheduler {scheduler}: cannot be reached: {line}") from None
    try:
        _check_workers(client, scheduler)
        yield client
    finally:
        with suppress(LateError, OSError):  # of a scheduler that is gone already
            client.close(timeout=_PARTING)


def _check_workers(client: "Client", scheduler: str) -> None:
    """Raise UsageError where there are no workers, or where they would compute something else."""
    from distributed import TimeoutError as LateError

    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except LateError:
        raise UsageError(f"--scheduler {scheduler}: has no workers; start some") from None
    try:
        versions = dict(client.run(_version))
    except Exception as error:  # noqa: BLE001 (what a worker raises comes as a plain one)
        line = " ".join(str(error).split())
        raise UsageError(
            f"--scheduler {scheduler}: a worker cannot use this package ({line}); install it and"
            " impact_observer[sweep] there too"
        ) from None
    for worker, found in versions.items():
        if found != __version__:
            raise UsageError(
                f"--scheduler {scheduler}: worker {worker} has impact_observer {found}; expected"
                f" {__version__}, as here"
            )


def _check_compilers(client: "Client", scheduler: str) -> None:
    """Raise UsageError where a worker has no numba: each of its cases would be one that failed."""
    for worker, found in client.run(_has_numba).items():
        if not found:
            raise UsageError(
                f"--scheduler {scheduler}: worker {worker} has no numba, which --compiled needs;"
                " pip install impact_observer[compiled] there too, or leave --compiled out"
            )


def _has_numba() -> bool:
    """Whether it is installed, where this is called."""
    return find_spec("numba") is not None


def _version() -> str:
    """Of the package, where this is called."""
    from impact_observer import __version__ as found

    return found
