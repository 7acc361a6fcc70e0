# SPDX-License-Identifier: Apache-2.0
"""Flow in strides for motions without closed form: sampled forces, and unsafe splittings.

Between two samples, and over strides short against the fastest rate, the motion is a Taylor
polynomial up to rounding. Strides begin at the start of the phase, so that states do not depend on
the requested instants, to the bit. The kernel computes the strides (``series.hpp``).
"""

from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.kernel import SampledForces
from impact_observer.model import Forcing
from impact_observer.model.force_samples import Samples
from impact_observer.model.live_samples import LiveSamples
from impact_observer.states import Matrix, Vector

Jets: TypeAlias = NDArray[np.float64]


def forces_of(forcing: Forcing) -> tuple[SampledForces | None, NDArray[np.intp]]:
    """The samples of ``forcing`` in the kernel, None without any, and the coordinates they drive.

    The coordinates are indices.
    """
    if forcing.sampled is None:
        return None, np.zeros(0, dtype=np.intp)
    return _shared(forcing.sampled)


@lru_cache(KEPT)
def _shared(samples: Samples) -> tuple[SampledForces, NDArray[np.intp]]:
    """The samples that are not always zero, and their coordinates."""
    assert samples.jets is not None, "derived"
    active = np.flatnonzero(samples.drives)
    if not isinstance(samples, LiveSamples):
        jets = _rows(samples.jets[..., active])
        return SampledForces(samples.time, jets, samples.rounding, samples.check), active
    forces = SampledForces(
        samples.time,
        _rows(samples.jets[..., active]),
        samples.rounding,
        samples.check,
        dropped=samples.dropped,
        newest=samples.newest,
    )

    def splice(first: int, time: Vector, jets: Jets, newest: float) -> None:
        forces.splice(first, time, _rows(jets[..., active]), newest)

    samples.follow(splice, forces.drop)
    return forces, active


def _rows(jets: Jets) -> Matrix:
    """Jets, shape (4, samples, forces), as one row for each sample."""
    return np.swapaxes(jets, 0, 1).reshape(jets.shape[1], -1)
