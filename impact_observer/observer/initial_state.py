"""Where a replica starts, as users write it."""

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.states import Vector


def initial_state(text: str, system: System) -> tuple[Vector, Vector]:
    """Read ``q1,..,qn,u1,..,un``, ``random:SEED`` or ``zero``.

    ``random:SEED`` is ``numpy.random.default_rng(SEED).normal(size=2n)``, q then u.

    Returns:
        Position and velocity, shape (n,) each.

    Raises:
        UsageError: naming what was found and what is expected.
    """
    n = system.n
    kind, _, seed = text.strip().partition(":")
    if kind == "zero" and not seed:
        x = np.zeros(2 * n)
    elif kind == "random":
        if not (seed.isascii() and seed.isdigit()):
            raise UsageError(f"initial state {text!r}: expected random:SEED, SEED a whole number")
        x = np.random.default_rng(int(seed)).normal(size=2 * n)
    else:
        x = _numbers(text, n)
    return system.checked_state(x[:n], x[n:])


def _numbers(text: str, n: int) -> Vector:
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        raise UsageError(
            f"initial state {text!r}: expected zero, random:SEED or {2 * n} numbers"
            " q1,..,qn,u1,..,un"
        ) from None
    if values.size != 2 * n:
        raise UsageError(
            f"initial state {text!r}: {values.size} numbers, expected {2 * n}: q1,..,qn,u1,..,un"
        )
    return values
