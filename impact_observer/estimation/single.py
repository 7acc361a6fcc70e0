"""An impact of one contact while none is closed, near its predicted instant: nearly every event.

The general methods of ``ImpactFilter`` give the same: in every bit where one linearisation is
enough, else but for the remainder of expansions. These are functions of arrays, so that ``numba``
can compile them (``compiled.py``).
"""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics import sizes
from impact_observer.estimation.joint import SETTLED
from impact_observer.estimation.likelihood import FAR
from impact_observer.estimation.saltation import LEAST, ROUNDING, STATE_ROUNDING
from impact_observer.estimation.square_root import product, triangular
from impact_observer.states import Matrix, Vector

ROUNDS = 6
"""Most linearisations of a measurement about its own posterior."""
_ONE = np.ones(1)

Gap: TypeAlias = tuple[Matrix, Matrix, Matrix, float]
"""Value, slope and E of a gap, of (1, x, f, df/dt, d2f/dt2), shape (3, 1 + 5n); derivatives of
value and slope by the state, shape (1, 2n) each; and the gap at rest, m."""
Jump: TypeAlias = tuple[Matrix, NDArray[np.float64]]
"""The state after the impact, as ``Jet`` has it, shapes (6n, 1 + 5n) and (3, 2n, 2n)."""
Sizes: TypeAlias = tuple[Matrix, Matrix, Matrix, Matrix]
"""What numbers are rounded against; see ``dynamics.sizes``."""
Forces: TypeAlias = tuple[Vector, Matrix]
"""Frequencies and rows of a ``Forcing.jet`` of order 2, shapes (h,) and (3n, 1 + 2h)."""
Contact: TypeAlias = tuple[Forces, Gap, Jump, Sizes, float]
"""The constants of an impact; last, the distance from its stamp, in s, within which the remainder
of expansions is rounding."""
State: TypeAlias = tuple[Vector, Matrix, Matrix]
"""An estimate, a root of its covariance, and other replicas less the estimate, one a column:
shapes (2n,), (2n, any) and (2n, N - 1); with the instant of the impact before them 1 + 2n."""
Fit: TypeAlias = tuple[float, float, float, float]
"""Normalised innovation of an impact; its standard deviation, of either sign, m; the predicted
slope of the gap, m/s; and the standard deviation of that."""


def single(
    t: float, flown: float, state: State, clock: float, contact: Contact
) -> tuple[bool, State, Fit]:
    """The posterior of an impact, at its stamp.

    Args:
        t: its stamp, s since the epoch.
        flown: seconds since the event before.
        state: the prior.
        clock: standard deviation of the stamp, s.
        contact: that hits.

    Returns:
        Whether the impact is near its predicted instant; if not, the rest is meaningless. The
        posterior, its root of shape (2n, 2n). The fit.
    """
    frequency, rows = contact[0]
    turned = np.ones(1 + 2 * frequency.size)
    for k in range(frequency.size):
        angle = frequency[k] * t
        turned[1 + 2 * k], turned[2 + 2 * k] = math.cos(angle), math.sin(angle)
    y = np.concatenate((_ONE, state[0], rows.dot(turned)))
    is_near, joint, fit = corrected(y, state, clock, contact)
    return is_near, jumped(y, flown, joint, contact) if is_near else state, fit


def corrected(y: Vector, state: State, clock: float, contact: Contact) -> tuple[bool, State, Fit]:
    """Instant and state just before an impact, corrected by it.

    As ``ImpactFilter.likelihood`` and ``joint_posterior``.

    Args:
        y: (1, x, f, df/dt, d2f/dt2) at the prior, shape (1 + 5n,); changed.
        state: see ``single``.
        clock: see ``single``.
        contact: see ``single``.

    Returns:
        Whether the impact is near; instant and state, one joint vector; the fit.
    """
    (x, root, differences), (_, (jet, H, D, rest), _, scale, near) = state, contact
    (size, columns), now = root.shape, jet.dot(y)
    value, slope, E = now[0], now[1], now[2:]
    seen, others, spread = H.dot(root), H.dot(differences), length(D.dot(root))
    rounded = ROUNDING * (np.abs(H).dot(sizes(x, 0.0, scale))[0] + abs(rest)) + LEAST
    prior, replicas = np.zeros((1 + size, 1 + columns)), np.zeros((1 + size, differences.shape[1]))
    prior[0, 0], prior[1:, 1:], replicas[1:] = clock, root, differences
    z, posterior, fit = np.zeros(1 + size), prior, (0.0, 1.0, slope, spread)
    by_state, by_stamp = length(seen), slope * clock
    both = math.hypot(by_state, by_stamp) + rounded
    is_near = abs(value) / both < FAR
    # About how far from its stamp it will be estimated: most that are not near end here.
    is_near &= (
        clock * max((by_state + rounded) / both, abs(value * by_stamp) / both**2) <= 3 * near
    )
    about, own = x, prior
    for turn in range(ROUNDS if is_near else 0):
        mean, bent = product(own, D, E)
        first = bent.shape[1]
        joint = np.zeros((2 + size, first + 2 + columns))
        joint[:1, :first], joint[0, first] = bent, rounded
        joint[0, first + 1], joint[:1, first + 2 :] = slope * clock, seen
        joint[1:, first + 1 :] = prior
        found = triangular(joint)
        gain, white = found[1:, :1].copy(), -(value + mean[0]) / found[0, 0]
        if turn == 0:
            fit = white, found[0, 0], slope, spread
        z, posterior = gain[:, 0] * white, found[1:, 1:].copy()
        z[1:] += x
        e, clear = z[0], abs(posterior[0, 0])
        change = e * (D.dot(z[1:] - about)[0] + E[0] * (e / 2))
        noise, after = length(bent), length(product(posterior, D, E)[1])
        enough = SETTLED * math.hypot(math.hypot(slope * clear, noise), rounded)
        settled = abs(change) + abs(noise - after) <= enough or turn + 1 == ROUNDS
        is_near = max(abs(e), clear) <= near
        if settled or not is_near:
            replicas -= gain.dot(others / found[0, 0])
            break
        about, own = z[1:], posterior
        y[1 : 1 + size] = about
        now = jet.dot(y)
        value, slope, E = H.dot(x)[0] + rest, now[1], now[2:]
    return is_near, (z, posterior, replicas), fit


def jumped(y: Vector, flown: float, joint: State, contact: Contact) -> State:
    """The state after the impact, as ``ImpactFilter.posterior``.

    Args:
        y: see ``corrected``; changed.
        flown: see ``single``.
        joint: instant and state just before the impact, corrected.
        contact: see ``single``.
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
    for i, each in enumerate(sizes(x, flown, scale)):
        whole[i, 2 + 2 * size + i] = STATE_ROUNDING * each
    return x, triangular(whole), H.dot(differences)


def length(row: Matrix) -> float:
    """The Euclidean length of the only one, shape (1, k)."""
    flat = row.ravel()
    return math.sqrt(flat.dot(flat))
