"""An impact of one contact while none is closed, heard when it was expected: nearly every event.

``ImpactFilter`` makes the same of it in general: in every bit where one linearisation is enough,
else but for what expansions leave out. Here is what such an event needs and nothing else, as
functions of arrays, so that ``numba`` can compile them (``compiled.py``).
"""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics import sizes
from impact_observer.estimation.joint import SETTLED
from impact_observer.estimation.likelihood import FAR
from impact_observer.estimation.saltation import LEAST, ROUNDING
from impact_observer.estimation.square_root import product, triangular
from impact_observer.states import Matrix, Vector

ROUNDS = 6
"""How often a measurement is linearised about what it says itself, at most."""
_ONE = np.ones(1)

Gap: TypeAlias = tuple[Matrix, Matrix, Matrix, float]
"""Value, slope and E of a gap, of (1, x, f, df/dt, d2f/dt2), shape (3, 1 + 5n); what value and
slope change by with the state, shape (1, 2n) each; and the gap at rest, m."""
Jump: TypeAlias = tuple[Matrix, NDArray[np.float64]]
"""The state after the impact, as ``Jet`` has it, shapes (6n, 1 + 5n) and (3, 2n, 2n)."""
Sizes: TypeAlias = tuple[Matrix, Matrix, Matrix]
"""What numbers are rounded against; see ``dynamics.sizes``."""
Forces: TypeAlias = tuple[Vector, Matrix]
"""Frequencies and rows of a ``Forcing.jet`` of order 2, shapes (h,) and (3n, 1 + 2h)."""
Contact: TypeAlias = tuple[Forces, Gap, Jump, Sizes, float]
"""All that an impact depends on besides what was known before it; last, how far from its stamp
expansions leave out but rounding, s."""
State: TypeAlias = tuple[Vector, Matrix, Matrix]
"""An estimate, a root of its covariance, and other replicas less the estimate, one a column:
shapes (2n,), (2n, any) and (2n, N - 1); with the instant of the impact before them 1 + 2n."""
Fit: TypeAlias = tuple[float, float, float, float]
"""How an impact fits what was known: its innovation, in standard deviations; one of these, of
either sign, m; the gap's slope as it was expected, m/s; and the standard deviation of that."""


def single(t: float, known: State, clock: float, contact: Contact) -> tuple[bool, State, Fit]:
    """What an impact tells where it is stamped.

    Args:
        t: its stamp, s since the epoch.
        known: just before it.
        clock: standard deviation of the stamp, s.
        contact: that hits.

    Returns:
        Whether it is what this is for, expected and near; else nothing here is of use. What is
        known just after it, the root of shape (2n, 2n). How it fits.
    """
    frequency, rows = contact[0]
    turned = np.ones(1 + 2 * frequency.size)
    for k in range(frequency.size):
        angle = frequency[k] * t
        turned[1 + 2 * k], turned[2 + 2 * k] = math.cos(angle), math.sin(angle)
    y = np.concatenate((_ONE, known[0], rows.dot(turned)))
    usual, joint, fit = heard(y, known, clock, contact)
    return usual, struck(y, joint, contact) if usual else known, fit


def heard(y: Vector, known: State, clock: float, contact: Contact) -> tuple[bool, State, Fit]:
    """What its instant tells, as ``ImpactFilter.evidence`` and ``heard``.

    Args:
        y: (1, x, f, df/dt, d2f/dt2) just before, shape (1 + 5n,); changed.
        known: this and the others as of ``single``.
        clock: likewise.
        contact: likewise.

    Returns:
        As ``single``, but what is known of instant and state just before the impact.
    """
    (x, root, differences), (_, (jet, H, D, rest), _, scale, near) = known, contact
    (size, columns), now = root.shape, jet.dot(y)
    value, slope, E = now[0], now[1], now[2:]
    seen, others, unsure = H.dot(root), H.dot(differences), length(D.dot(root))
    rounded = ROUNDING * (np.abs(H).dot(sizes(x, *scale))[0] + abs(rest)) + LEAST
    prior, replicas = np.zeros((1 + size, 1 + columns)), np.zeros((1 + size, differences.shape[1]))
    prior[0, 0], prior[1:, 1:], replicas[1:] = clock, root, differences
    z, learnt, fit = np.zeros(1 + size), prior, (0.0, 1.0, slope, unsure)
    by_state, by_stamp = length(seen), slope * clock
    both = math.hypot(by_state, by_stamp) + rounded
    usual = abs(value) / both < FAR
    # How far from its stamp it will be, nearly: most that are not near need not be looked at.
    usual &= clock * max((by_state + rounded) / both, abs(value * by_stamp) / both**2) <= 3 * near
    about, own = x, prior
    for turn in range(ROUNDS if usual else 0):
        mean, bent = product(own, D, E)
        first = bent.shape[1]
        joint = np.zeros((2 + size, first + 2 + columns))
        joint[:1, :first], joint[0, first] = bent, rounded
        joint[0, first + 1], joint[:1, first + 2 :] = slope * clock, seen
        joint[1:, first + 1 :] = prior
        found = triangular(joint)
        gain, white = found[1:, :1].copy(), -(value + mean[0]) / found[0, 0]
        if turn == 0:
            fit = white, found[0, 0], slope, unsure
        z, learnt = gain[:, 0] * white, found[1:, 1:].copy()
        z[1:] += x
        e, clear = z[0], abs(learnt[0, 0])
        change = e * (D.dot(z[1:] - about)[0] + E[0] * (e / 2))
        noise, after = length(bent), length(product(learnt, D, E)[1])
        enough = SETTLED * math.hypot(math.hypot(slope * clear, noise), rounded)
        settled = abs(change) + abs(noise - after) <= enough or turn + 1 == ROUNDS
        usual = max(abs(e), clear) <= near
        if settled or not usual:
            replicas -= gain.dot(others / found[0, 0])
            break
        about, own = z[1:], learnt
        y[1 : 1 + size] = about
        now = jet.dot(y)
        value, slope, E = H.dot(x)[0] + rest, now[1], now[2:]
    return usual, (z, learnt, replicas), fit


def struck(y: Vector, joint: State, contact: Contact) -> State:
    """What is known after it, as ``ImpactFilter.after``.

    Args:
        y: as of ``heard``; changed.
        joint: instant and state just before, now that it is heard.
        contact: as of ``single``.
    """
    (z, root, differences), (_, _, (jet, maps), scale, _) = joint, contact
    e, size = z[0], z.size - 1
    y[1 : 1 + size] = z[1:]
    now, onward = jet.dot(y).reshape(3, size), np.array([[1.0, e, e * e / 2], [0.0, 1.0, e]])
    line, map_ = onward.dot(now), onward.dot(maps.reshape(3, size * size))
    H = np.empty((size, 1 + size))
    H[:, 0], H[:, 1:] = line[1], map_[0].reshape(size, size)
    mean, bent = product(root, map_[1].reshape(size, size), now[2])
    x = line[0] + mean
    whole = np.zeros((size, 2 + 3 * size))
    whole[:, : 1 + size], whole[:, 1 + size : 2 + 2 * size] = H.dot(root), bent
    for i, each in enumerate(sizes(x, *scale)):
        whole[i, 2 + 2 * size + i] = ROUNDING * each
    return x, triangular(whole), H.dot(differences)


def length(row: Matrix) -> float:
    """The Euclidean length of the only one, shape (1, k)."""
    flat = row.ravel()
    return math.sqrt(flat.dot(flat))
