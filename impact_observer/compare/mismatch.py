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
"""Least jump of the truth's contact speed that is one, over the largest speed around it."""
_LIKE = 0.5
"""Least jump that is like another, over that."""


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
    if here >= near.size or near.size < 3:
        return None
    rises = _rises(near, truth[low:high])
    # Coarse samples see a speed bend, too: what is small beside the jump is none.
    own = [not _is_of_another(at, impact, others) for at in near.tolist()]
    largest = float(np.max(rises, where=own, initial=0.0))
    least = max(_LEAST * float(np.max(np.abs(truth[low:high]))), _LIKE * largest)
    of_truth = _nearest(rises, least, here)
    if of_truth is None or not own[of_truth]:
        return None
    # At the stamp an estimate may be thrown either way, or hardly; ahead of it only like the
    # truth, by a law that knows when the impact must be.
    least = _LIKE * float(rises[of_truth])
    of_estimate = _nearest(_rises(near, estimate[low:high]), least, here)
    if of_estimate is None or not own[of_estimate]:
        of_estimate = here
    first, last = sorted((of_truth, of_estimate))
    return Window(int(near[first]), int(near[last])) if first < last else None


def _is_of_another(at: int, impact: Impact, others: Sequence[int]) -> bool:
    """Whether a jump at the stamp ``at`` (ns) is nearer to another impact of the contact."""
    return any(abs(at - other) < abs(at - impact.stamp) for other in others)


def _rises(stamps: Stamps, speed: NDArray[np.float64]) -> NDArray[np.float64]:
    """By how much a contact's speed has risen at each sample more than its slope explains.

    The slope over a jump explains nothing, so what follows a fall is no rise.
    """
    steps, lengths = np.diff(speed), np.diff(stamps)
    unexplained = steps[1:] - steps[:-1] * (lengths[1:] / lengths[:-1])
    echo = (unexplained[1:] > 0) & (unexplained[:-1] < -_LIKE * unexplained[1:])
    unexplained[1:][echo] = 0.0
    return np.concatenate([[0.0, 0.0], unexplained])


def _nearest(rises: NDArray[np.float64], least: float, here: int) -> int | None:
    """The sample nearest to ``here`` with a rise of more than ``least``."""
    found = np.flatnonzero(rises > least)
    return int(found[np.argmin(np.abs(found - here))]) if found.size else None
