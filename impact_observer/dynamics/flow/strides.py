# SPDX-License-Identifier: Apache-2.0
"""Flow in strides for motions without closed form: sampled forces, and unsafe splittings.

Between two samples, and over strides short against the fastest rate, the motion is a Taylor
polynomial up to rounding. Strides begin at the start of the phase, so that states do not depend on
the requested instants, to the bit. The kernel computes the strides (``series.hpp``).
"""

from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.kernel import SampledForces
from impact_observer.model import Forcing
from impact_observer.model.force_samples import JETS, Samples
from impact_observer.model.live_samples import LiveSamples
from impact_observer.states import Matrix, Vector

Jets: TypeAlias = NDArray[np.float64]


class Forces(NamedTuple):
    """The sampled forces of a forcing that are not always zero.

    Attributes:
        samples: the samples in the kernel; None without samples.
        active: indices of the coordinates with sampled forces.
        orders: periods of each harmonic in a revolution of the drive, shape (h,). If any harmonic
            turns with the drive, the phase of the drive is the last of the forces.
    """

    samples: SampledForces | None
    active: NDArray[np.intp]
    orders: Vector

    def columns(self, forces: Matrix) -> Matrix:
        """The active columns of ``forces``, shape (w, n), and a zero column for a drive."""
        return np.pad(forces[:, self.active], ((0, 0), (0, int(self.orders.any()))))


def forces_of(forcing: Forcing) -> Forces:
    """The sampled forces of ``forcing``."""
    sampled, orders = forcing.sampled, np.zeros(forcing.frequency.size)
    if sampled is None:
        return Forces(None, np.zeros(0, dtype=np.intp), orders)
    if isinstance(sampled, LiveSamples):
        orders = sampled.orders.astype(np.float64)
    return Forces(*_shared(sampled), orders)


@lru_cache(KEPT)
def _shared(samples: Samples) -> tuple[SampledForces, NDArray[np.intp]]:
    """The samples that are not always zero, and their coordinates."""
    assert samples.jets is not None, "derived"
    active = np.flatnonzero(samples.drives)
    if not isinstance(samples, LiveSamples):
        jets = _rows(samples.jets[..., active])
        return SampledForces(samples.time, jets, samples.rounding, samples.check), active
    turning = samples.orders.any()

    def columns(jets: Jets, turns: Matrix) -> Matrix:
        phase = np.concatenate([turns, np.zeros((JETS - 2, turns.shape[1]))])
        chosen = jets[..., active]
        return _rows(np.concatenate([chosen, phase[..., None]], axis=2) if turning else chosen)

    forces = SampledForces(
        samples.time,
        columns(samples.jets, samples.turns),
        samples.rounding,
        samples.check,
        dropped=samples.dropped,
        newest=samples.newest,
    )

    def splice(first: int, time: Vector, jets: Jets, turns: Matrix, newest: float) -> None:
        forces.splice(first, time, columns(jets, turns), newest)

    samples.follow(splice, forces.drop)
    return forces, active


def _rows(jets: Jets) -> Matrix:
    """Jets, shape (4, samples, forces), as one row for each sample."""
    return np.swapaxes(jets, 0, 1).reshape(jets.shape[1], -1)
