# SPDX-License-Identifier: Apache-2.0
"""Threads of the linear algebra library."""

import os


def one_matrix_thread(*, always: bool = False) -> None:
    """Limit the linear algebra of this process to one thread, before numpy is imported.

    More threads are no faster for small matrices, are many times slower where other processes use
    the processor too, and can change the last bit: node and command would differ.

    Args:
        always: whether to override a number that the environment has.
    """
    for library in ("OPENBLAS", "MKL", "OMP", "BLIS"):
        name = f"{library}_NUM_THREADS"
        os.environ[name] = "1" if always else os.environ.get(name, "1")
