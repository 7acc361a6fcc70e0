# SPDX-License-Identifier: Apache-2.0
"""Flow in strides, for what has no closed form: sampled forces, and spectra that cannot be split.

Between two samples, and over strides short against the fastest rate, the motion is its Taylor
polynomial but for rounding. Strides are counted from the phase's start, so that the result does
not depend on which instants are asked for, to the bit. The kernel makes them (``series.hpp``).
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
        samples: as the kernel has them; None where there are none.
        active: their coordinates.
        orders: how often each harmonic turns in a revolution of the drive, shape (h,). If any
            does, the phase of the drive is the last of the forces.
    """

    samples: SampledForces | None
    active: NDArray[np.intp]
    orders: Vector

    def columns(self, forces: Matrix) -> Matrix:
        """Those of ``forces``, a column a coordinate; the drive's phase is no force."""
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
        found = jets[..., active]
        return _rows(np.concatenate([found, phase[..., None]], axis=2) if turning else found)

    found = SampledForces(
        samples.time,
        columns(samples.jets, samples.turns),
        samples.rounding,
        samples.check,
        dropped=samples.dropped,
        newest=samples.newest,
    )

    def splice(first: int, time: Vector, jets: Jets, turns: Matrix, newest: float) -> None:
        found.splice(first, time, columns(jets, turns), newest)

    samples.follow(splice, found.drop)
    return found, active


def _rows(jets: Jets) -> Matrix:
    """Jets, shape (4, samples, forces), with those of each sample in a row."""
    return np.swapaxes(jets, 0, 1).reshape(jets.shape[1], -1)
