"""Samples between the jumps of truth and estimate, where one has jumped and the other has not.

A stamp that is off by a millisecond makes the estimate jump a millisecond before or after the
truth. In between they differ by the whole jump, which says nothing about the estimate before or
after: the *peaking* of Biemond, van de Wouw, Heemels and Nijmeijer, Tracking control for hybrid
systems with state-triggered jumps, IEEE Transactions on Automatic Control, 2013.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from impact_observer.stamps import NS_PER_S
from impact_observer.states import Stamps, Vector

REACH = NS_PER_S // 10
"""Largest time between the two jumps of one impact, ns: more than any clock error that can be
declared, less than the usual time between two impacts of a contact."""
_LEAST = 0.05
"""Smallest step of the true contact speed that is a jump, over the largest speed around it."""
_ALIKE = 0.5
"""Smallest jump that counts beside another one, over that one."""


@dataclass(slots=True)
class Mismatch:
    """All samples between the jumps of truth and estimate.

    Attributes:
        windows: impacts with such samples.
        samples: their number; they are left out of all other metrics.
        longest: the longest window, s.
        V: the largest distance in a window, J.
    """

    windows: int = 0
    samples: int = 0
    longest: float = 0.0
    V: float = 0.0


def window(
    stamps: Stamps, truth: Vector, estimate: Vector, impact: int, others: Sequence[int] = ()
) -> tuple[int, int] | None:
    """The samples between the jumps of truth and estimate at an impact.

    Args:
        stamps: of the samples, ns, ascending, shape (samples,).
        truth: the true contact speed, gamma = w^T u, shape (samples,), m/s.
        estimate: the estimated one, shape (samples,), m/s.
        impact: stamp of the impact at which the estimate jumps, ns; where to look, ``REACH`` to
            both sides.
        others: stamps of the contact's other impacts, ns. A jump that is nearer to one of them
            belongs to that impact.

    Returns:
        Stamps of the first sample between them and of the first one after both, ns; None where
        there is no sample between the jumps, or the truth has no jump.
    """
    low, high = np.searchsorted(stamps, [impact - REACH, impact + REACH + 1])
    low = max(int(low) - 2, 0)
    near, here = stamps[low:high], int(np.searchsorted(stamps[low:high], impact))
    if here >= near.size or near.size < 3:
        return None
    of_this_impact = np.ones(near.size, dtype=np.bool_)
    for other in others:
        of_this_impact &= np.abs(near - impact) <= np.abs(near - other)
    jumps = _jumps(near, truth[low:high])
    # Coarse samples show curvature as small steps: they are no jumps beside the largest one.
    largest = float(np.max(jumps, where=of_this_impact, initial=0.0))
    least = max(_LEAST * float(np.max(np.abs(truth[low:high]))), _ALIKE * largest)
    of_truth = _nearest(jumps, least, here)
    if of_truth is None or not of_this_impact[of_truth]:
        return None
    # An estimate that is wrong may jump by any amount at the stamp. Elsewhere only a jump like
    # that of the truth counts: a law that predicts the impact may jump before its stamp.
    least = _ALIKE * float(jumps[of_truth])
    of_estimate = _nearest(_jumps(near, estimate[low:high]), least, here)
    if of_estimate is None or not of_this_impact[of_estimate]:
        of_estimate = here
    first, last = sorted((of_truth, of_estimate))
    return (int(near[first]), int(near[last])) if first < last else None


def _jumps(stamps: Stamps, speed: Vector) -> NDArray[np.float64]:
    """By how much a contact speed rises at each sample beyond what its slope explains.

    The slope over a jump explains nothing, so a rise that follows a fall is set to zero.
    """
    steps, lengths = np.diff(speed), np.diff(stamps)
    unexplained = steps[1:] - steps[:-1] * (lengths[1:] / lengths[:-1])
    echo = (unexplained[1:] > 0) & (unexplained[:-1] < -_ALIKE * unexplained[1:])
    unexplained[1:][echo] = 0.0
    return np.concatenate([[0.0, 0.0], unexplained])


def _nearest(jumps: NDArray[np.float64], least: float, here: int) -> int | None:
    """The sample nearest to ``here`` with a jump of more than ``least``."""
    found = np.flatnonzero(jumps > least)
    return int(found[np.argmin(np.abs(found - here))]) if found.size else None
