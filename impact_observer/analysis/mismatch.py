"""Where of truth and estimate one has jumped already and the other has not.

A sensor's stamp that is off by a millisecond makes the estimate jump a millisecond away from the
truth. In between they differ by the whole jump, which says nothing of the estimate before or
after: the *peaking* of Biemond, van de Wouw, Heemels and Nijmeijer, Tracking control for hybrid
systems with state-triggered jumps, IEEE Transactions on Automatic Control, 2013.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.stamps import NS_PER_S
from impact_observer.states import Stamps

REACH = NS_PER_S // 10
"""How far apart the two jumps of one impact may be, ns: more than any clock error that can be
declared, less than a contact's usual time between impacts."""
_LEAST = 0.05
"""Least jump of a contact's speed that is one, over the largest speed around it."""


class Impact(NamedTuple):
    """An impact that an observer used.

    Attributes:
        stamp: when the observer was told, or believed, that it was, ns.
        contact: index in the system.
    """

    stamp: int
    contact: int


class Window(NamedTuple):
    """Samples between the two jumps.

    Attributes:
        begin: stamp of the first sample, ns.
        end: stamp of the first sample at which both have jumped, ns.
    """

    begin: int
    end: int


def window(
    stamps: Stamps,
    truth: NDArray[np.float64],
    estimate: NDArray[np.float64],
    impact: Impact,
    others: Sequence[int] = (),
) -> Window | None:
    """The samples between the jumps of truth and estimate at an impact.

    Args:
        stamps: of the samples, ns, ascending, shape (samples,).
        truth: the contact's speed, gamma = w^T u, shape (samples,), m/s.
        estimate: likewise.
        impact: where to look, ``REACH`` to both sides.
        others: stamps of the contact's other impacts, ns: a jump that is nearer to one of them
            belongs to that one.

    Returns:
        None where no sample lies between, or the truth has no jump there.
    """
    low, high = np.searchsorted(stamps, [impact.stamp - REACH, impact.stamp + REACH + 1])
    low = max(int(low) - 2, 0)
    near, here = stamps[low:high], int(np.searchsorted(stamps[low:high], impact.stamp))
    if here >= near.size:
        return None
    of_truth = _jump(near, truth[low:high], here, rises=True)
    if of_truth is None:
        return None
    at = int(near[of_truth])
    if any(abs(at - other) < abs(at - impact.stamp) for other in others):
        return None
    of_estimate = _jump(near, estimate[low:high], here)
    if of_estimate is None:
        of_estimate = here
    first, last = sorted((of_truth, of_estimate))
    return Window(int(near[first]), int(near[last])) if first < last else None


def _jump(
    stamps: Stamps, speed: NDArray[np.float64], here: int, *, rises: bool = False
) -> int | None:
    """The first sample after the jump of a contact's speed that is nearest to ``here``.

    A jump is what the slope before it does not explain. The plant's contact speed can only rise;
    an estimate may be thrown either way.
    """
    if speed.size < 3:
        return None
    steps = np.diff(speed)
    lengths = np.diff(stamps)
    unexplained = steps[1:] - steps[:-1] * (lengths[1:] / lengths[:-1])
    jumps = np.abs(unexplained) > _LEAST * np.max(np.abs(speed))
    # The slope over a jump explains nothing of what follows, so each has an echo.
    echoes = jumps[1:] & jumps[:-1] & (unexplained[1:] * unexplained[:-1] < 0)
    jumps[1:] &= ~echoes
    if rises:
        jumps &= unexplained > 0
    found = np.flatnonzero(jumps) + 2
    return int(found[np.argmin(np.abs(found - here))]) if found.size else None
