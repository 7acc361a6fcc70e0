"""Divided differences of ``exp(s z)`` that stay accurate where their points coincide.

They are the exact response of a mode to a harmonic, resonance included: see ``spectral.py``.
"""

import numpy as np
from numpy.typing import NDArray

Complex = NDArray[np.complex128]

_NEAR = 0.5
"""Spread of ``s`` times the points below which the second difference is a power series."""
_TERMS = 14
"""Terms of that series: the first one left out is below 1e-16 of the sum."""


def first(a: Complex, b: Complex, s: NDArray[np.float64]) -> Complex:
    """``exp[a, b] = (e^{as} - e^{bs}) / (a - b)``, and ``s e^{as}`` where ``a = b``."""
    swap = a.real > b.real
    low, high = np.where(swap, b, a), np.where(swap, a, b)
    z = (low - high) * s
    small = np.where(z == 0, 1.0, z)
    quotient: Complex = np.where(z == 0, 1.0, np.expm1(small) / small)
    return np.asarray(s * np.exp(high * s) * quotient)


def second(a: Complex, b: Complex, c: Complex, s: NDArray[np.float64]) -> Complex:
    """``exp[a, b, c]``; ``s^2 e^{as} / 2`` where all three coincide."""
    a, b, c, s = np.broadcast_arrays(a, b, c, s)
    ab, bc, ac = abs(a - b), abs(b - c), abs(a - c)
    ab_widest = (ab > ac) & (ab >= bc)
    bc_widest = (bc > ac) & ~ab_widest
    # Divide by the largest distance: order the points so that it is that of a and c.
    a, b, c = (
        np.where(bc_widest, b, a),
        np.where(bc_widest, a, np.where(ab_widest, c, b)),
        np.where(ab_widest, b, c),
    )
    far = abs(a - c) * s > _NEAR
    distance = np.where(far, a - c, 1.0)
    quotient = (first(a, b, s) - first(b, c, s)) / distance
    return np.where(far, quotient, _series(a, b, c, s))


def _series(a: Complex, b: Complex, c: Complex, s: NDArray[np.float64]) -> Complex:
    """``s^2 e^{ms} sum_k h_k / (k+2)!`` about the mean ``m``, ``h_k`` homogeneous symmetric."""
    mean = (a + b + c) / 3
    x, y, z = ((p - mean) * s for p in (a, b, c))
    only_x, with_y, with_z = (np.ones_like(x) for _ in range(3))
    total, factorial = with_z / 2, 2.0
    for k in range(1, _TERMS):
        factorial *= k + 2
        only_x = x * only_x
        with_y = only_x + y * with_y
        with_z = with_y + z * with_z
        total = total + with_z / factorial
    return s**2 * np.exp(mean * s) * total
