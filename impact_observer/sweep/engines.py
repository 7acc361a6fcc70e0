# SPDX-License-Identifier: Apache-2.0
"""Engines that run cases: processes of this machine by joblib, or a Dask cluster."""

import logging
import os
import warnings
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import closing, contextmanager, suppress
from itertools import islice
from typing import TYPE_CHECKING

from impact_observer import __version__
from impact_observer.errors import SweepError, UsageError
from impact_observer.process_end import end_with_parent

if TYPE_CHECKING:
    from distributed import Client

    from impact_observer.sweep.case_runs import Outcome
    from impact_observer.sweep.plan import Case

    Batches = Sequence[tuple[Case, ...]]

_PATIENCE = 10.0
"""Longest wait for a scheduler, and for its first worker, s."""
_CLOSING = 2.0
"""Longest wait for a scheduler at the end, s."""
_AHEAD = 4
"""Batches submitted to a cluster ahead, for each of its threads."""
_INSTALL = "pip install joblib distributed pyarrow"


def run_batches(
    batches: "Batches", *, jobs: int | None = None, scheduler: str | None = None
) -> "Generator[Outcome, None, None]":
    """Yield the outcomes of batches as they are finished.

    Args:
        batches: of cases, in any order.
        jobs: processes on this machine; None for as many as it has cores.
        scheduler: address of a Dask scheduler, whose workers run the cases instead.

    Raises:
        UsageError: a package is missing, or the scheduler or its workers cannot be used.
        SweepError: processes have died.
    """
    return _on_machine(batches, jobs) if scheduler is None else _on_cluster(batches, scheduler)


def _on_machine(batches: "Batches", jobs: int | None) -> "Generator[Outcome, None, None]":
    try:
        import joblib
    except ImportError as error:
        raise UsageError(f"sweep needs joblib ({error}); {_INSTALL}") from None

    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        # One by one: laws differ in cost, and with batches some cores would be idle.
        parallel = joblib.Parallel(
            n_jobs=-1 if jobs is None else jobs, return_as="generator_unordered", batch_size=1
        )
        try:
            with (
                _unused_results_dropped(),
                closing(
                    parallel(joblib.delayed(_run_for)(os.getpid(), each) for each in batches)
                ) as finished,
            ):
                for outcomes in finished:
                    yield from outcomes
        except BrokenExecutor as error:
            line = str(error).splitlines()[0]
            raise SweepError(f"a process of the sweep has died: {line}") from None


def _run_for(parent: int, batch: "tuple[Case, ...]") -> "list[Outcome]":
    """The outcomes of a batch, in a process that ends with its parent."""
    end_with_parent(parent)
    from impact_observer.sweep.case_runs import run_batch

    return run_batch(batch)


@contextmanager
def _unused_results_dropped() -> "Iterator[None]":
    """Suppress the warning of joblib on unused results of an interrupted sweep."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*successfully executed.*but not used")
        yield


def _on_cluster(batches: "Batches", scheduler: str) -> "Generator[Outcome, None, None]":
    """Run cases by the workers of a Dask cluster, including workers that join later."""
    try:
        from distributed import as_completed
    except ImportError as error:
        raise UsageError(f"--scheduler needs Dask ({error}); {_INSTALL}") from None
    from impact_observer.sweep.case_runs import run_batch

    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # errors are raised as one line
    with _connected(scheduler) as client:
        waiting, running = iter(batches), 0
        futures = as_completed(loop=client.loop, with_results=True)
        while True:
            try:
                free = _AHEAD * sum(client.ncores().values()) - running
                more = islice(waiting, max(free, 0))
                started = [client.submit(run_batch, each, pure=False) for each in more]
                futures.update(started)
                running += len(started)
                if not running:
                    return
                _, outcomes = next(futures)
                if isinstance(outcomes, BaseException):  # from a cancelled future
                    raise outcomes
            except Exception as error:  # noqa: BLE001 (lost workers and schedulers raise many kinds)
                line = " ".join(f"{type(error).__name__}: {error}".split())
                raise SweepError(f"{scheduler}: {line}") from None
            running -= 1
            yield from outcomes


@contextmanager
def _connected(scheduler: str) -> "Iterator[Client]":
    """A client of a cluster whose workers can run the cases."""
    from distributed import Client
    from distributed import TimeoutError as LateError  # not the builtin one in Python 3.10
    from distributed.comm import resolve_address

    try:
        resolve_address(scheduler)  # fails at once; a client would wait
        client = Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        line = " ".join(str(error).split())
        raise UsageError(f"--scheduler {scheduler}: cannot be reached: {line}") from None
    try:
        _check_workers(client, scheduler)
        yield client
    finally:
        with suppress(LateError, OSError):  # the scheduler may be gone
            client.close(timeout=_CLOSING)


def _check_workers(client: "Client", scheduler: str) -> None:
    """Raise UsageError if the cluster has no workers, or one lacks this version."""
    from distributed import TimeoutError as LateError

    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except LateError:
        raise UsageError(f"--scheduler {scheduler}: has no workers; start some") from None
    try:
        installed = dict(client.run(_installed))
    except Exception as error:  # noqa: BLE001 (errors of workers have any type)
        line = " ".join(str(error).split())
        raise UsageError(
            f"--scheduler {scheduler}: a worker cannot use this package ({line}); install it and"
            " impact_observer[sweep] there too"
        ) from None
    for worker, version in installed.items():
        if version != __version__:
            raise UsageError(
                f"--scheduler {scheduler}: worker {worker} has impact_observer {version}; expected"
                f" {__version__}, as here"
            )


def _installed() -> str:
    """Version of the package on this worker."""
    from impact_observer import __version__ as version

    return version
