# SPDX-License-Identifier: Apache-2.0
"""Runs cases by joblib: in processes of this machine, or by the workers of a Dask cluster."""

import logging
import os
import warnings
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager

from impact_observer.errors import SweepError, UsageError
from impact_observer.process_end import end_with_parent
from impact_observer.sweep.cases import Sweep, Value

try:
    import joblib
    import pyarrow.parquet  # noqa: F401
except ImportError as error:
    raise UsageError(
        f"sweep needs joblib, pyarrow ({error}); pip install joblib pyarrow"
    ) from None

_PATIENCE = 10.0
"""Longest wait for a scheduler, and for its first worker, s."""


def run_cases(
    sweep: Sweep, *, jobs: int | None = None, dask: str | None = None
) -> Iterator[dict[str, Value]]:
    """Yield the rows of all cases as they are finished.

    Args:
        sweep: the cases.
        jobs: processes on this machine; None for as many as it has cores.
        dask: address of a Dask scheduler, whose workers run the cases instead.

    Raises:
        UsageError: the package ``distributed`` is missing, or the cluster cannot be used.
        SweepError: processes or workers have died.
    """
    parent = 0 if dask else os.getpid()
    tasks = (joblib.delayed(_rows)(parent, sweep, block) for block in sweep.blocks)
    with _cluster(dask) if dask else joblib.parallel_config("loky", inner_max_num_threads=1):
        count = -1 if jobs is None else jobs
        parallel = joblib.Parallel(n_jobs=count, return_as="generator_unordered")
        # joblib warns of the rows that an interrupted sweep leaves.
        warnings.filterwarnings("ignore", message=".*successfully executed.*but not used")
        try:
            for rows in parallel(tasks):
                yield from rows
        except BrokenExecutor as error:
            line = str(error).splitlines()[0]
            raise SweepError(f"a process of the sweep has died: {line}") from None


def _rows(parent: int, sweep: Sweep, block: range) -> list[dict[str, Value]]:
    """The rows of a block, in a process that ends with its parent; 0 for a worker of a cluster."""
    if parent:
        end_with_parent(parent)
    return sweep.rows(block)


@contextmanager
def _cluster(address: str) -> Iterator[None]:
    """Make joblib use the workers of a Dask scheduler."""
    try:
        from distributed import Client
        from distributed.comm import resolve_address
    except ImportError as error:
        raise UsageError(f"--dask needs Dask ({error}); pip install distributed") from None
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # errors are raised as one line
    try:
        resolve_address(address)  # fails at once; a client would wait
        client = Client(address, timeout=_PATIENCE, set_as_default=True)
        client.wait_for_workers(1, timeout=_PATIENCE)
    except (OSError, ValueError, TimeoutError) as error:
        line = " ".join(str(error).split())
        raise UsageError(f"--dask {address}: cannot be used: {line}") from None
    with client, joblib.parallel_config("dask"):
        try:
            yield
        except (OSError, RuntimeError) as error:
            line = " ".join(f"{type(error).__name__}: {error}".split())
            raise SweepError(f"--dask {address}: {line}") from None
