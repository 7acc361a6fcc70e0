# SPDX-License-Identifier: Apache-2.0
"""Samples between the jumps of truth and estimate: one has jumped and the other has not.

A stamp that is off by a millisecond makes the estimate jump a millisecond before or after the
truth. In between, truth and estimate differ by the whole jump, whatever the error of the
estimate before and after. This is the *peaking* of Biemond, van de Wouw, Heemels and Nijmeijer,
Tracking control for hybrid systems with state-triggered jumps, IEEE Transactions on Automatic
Control, 2013.
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
"""Ratio of a jump to another one beside it below which the smaller jump does not count."""


@dataclass(slots=True)
class Mismatch:
    """All samples between the jumps of truth and estimate.

    Attributes:
        windows: impacts with such samples.
        samples: samples in all windows; they are left out of all other metrics.
        longest: the longest window, s.
        V: the largest distance in a window, J.
    """

    windows: int = 0
    samples: int = 0
    longest: float = 0.0
    V: float = 0.0


def windows(
    stamps: Stamps,
    truth: Vector,
    estimates: NDArray[np.float64],
    impact: int,
    others: Sequence[int] = (),
) -> tuple[Stamps, Stamps]:
    """The samples between the jumps of truth and estimates at an impact.

    Args:
        stamps: of the samples, ns, ascending, shape (samples,).
        truth: the true contact speed, gamma = w^T u, shape (samples,), m/s.
        estimates: estimated contact speeds, shape (..., samples), m/s.
        impact: stamp of the impact at which the estimate jumps, ns; jumps are sought ``REACH`` to
            both sides.
        others: stamps of the contact's other impacts, ns. A jump nearer to another impact belongs
            to the other impact.

    Returns:
        Stamps of the first sample between the jumps and of the first sample after both, ns, shape
        (...) each; equal if no sample is between the jumps, or the truth has no jump.
    """
    nothing = np.full(estimates.shape[:-1], impact), np.full(estimates.shape[:-1], impact)
    low, high = np.searchsorted(stamps, [impact - REACH, impact + REACH + 1])
    low = max(int(low) - 2, 0)
    near, here = stamps[low:high], int(np.searchsorted(stamps[low:high], impact))
    if here >= near.size or near.size < 3:
        return nothing
    of_this_impact = np.ones(near.size, dtype=np.bool_)
    for other in others:
        of_this_impact &= np.abs(near - impact) <= np.abs(near - other)
    jumps = _jumps(near, truth[low:high])
    # Coarse samples show curvature as small steps; beside the largest jump these are no jumps.
    largest = float(np.max(jumps, where=of_this_impact, initial=0.0))
    least = max(_LEAST * float(np.max(np.abs(truth[low:high]))), _ALIKE * largest)
    of_truth = int(_nearest(jumps, least, here))
    if of_truth < 0 or not of_this_impact[of_truth]:
        return nothing
    # An estimate that is wrong may jump by any amount at the stamp. Elsewhere only a jump as
    # large as the truth's counts: a law that predicts the impact may jump before its stamp.
    least = _ALIKE * float(jumps[of_truth])
    jump = _nearest(_jumps(near, estimates[..., low:high]), least, here)
    of_estimates = np.where((jump >= 0) & of_this_impact[jump], jump, here)
    return near[np.minimum(of_truth, of_estimates)], near[np.maximum(of_truth, of_estimates)]


def _jumps(stamps: Stamps, speed: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rise of a contact speed, shape (..., samples), beyond the rise that its slope explains.

    The slope over a jump explains nothing, so a rise that follows a fall is set to zero.
    """
    steps, lengths = np.diff(speed), np.diff(stamps)
    jumps = np.zeros(speed.shape)
    jumps[..., 2:] = steps[..., 1:] - steps[..., :-1] * (lengths[1:] / lengths[:-1])
    rise, before = jumps[..., 3:], jumps[..., 2:-1]
    rise[(rise > 0) & (before < -_ALIKE * rise)] = 0.0
    return jumps


def _nearest(jumps: NDArray[np.float64], least: float, here: int) -> NDArray[np.intp]:
    """The sample nearest to ``here`` with a jump of more than ``least``; -1 for none."""
    far = jumps.shape[-1]
    away = np.where(jumps > least, np.abs(np.arange(far) - here), far)
    nearest = away.argmin(axis=-1)
    return np.where(away.min(axis=-1) < far, nearest, -1)
