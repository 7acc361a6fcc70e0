# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Flow in strides, for what has no closed form: sampled forces, and spectra that cannot be split.

Between two samples, and over strides short against the fastest rate, the motion is its Taylor
polynomial but for rounding. Strides are counted from the phase's start, so that the result does
not depend on which instants are asked for, to the bit. The kernel makes them (``series.hpp``).
"""

from functools import cached_property, lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from impact_observer.dynamics.contact.projection import KEPT
from impact_observer.dynamics.flow.flow import Equations, Flow, Functions, PhaseFrame
from impact_observer.dynamics.flow.modes import Modes, split
from impact_observer.dynamics.flow.spectral import SpectralFlow
from impact_observer.kernel import Guards, PhaseMotion, SampledForces
from impact_observer.kernel import SeriesFlow as Strides
from impact_observer.model.angles import Angles
from impact_observer.model.force_samples import JETS, Samples
from impact_observer.model.live_samples import LiveSamples
from impact_observer.states import Matrix, Vector


def flow_of(
    system: Equations, shapes: Matrix | None = None, frame: PhaseFrame | None = None
) -> Flow:
    """The flow of ``system`` without contact: in closed form where there is one.

    Args:
        system: what moves.
        shapes: of its undamped modes by LAPACK, shape (n, n), if available.
        frame: in which its coordinates lie; None where they are all that there are.
    """
    modes = split(system, shapes) if system.n else _NOTHING
    if modes.are_pairs and system.n and system.forcing.sampled is None:
        return SpectralFlow(system, modes, frame)
    return SeriesFlow(system, modes, frame)


_NOTHING = Modes(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 2, 2)), proportional=True)


class SeriesFlow(Flow):
    """Flow of a system, free or in its modes, in strides."""

    def __init__(self, system: Equations, modes: Modes, frame: PhaseFrame | None = None) -> None:
        """Prepare loads and rates."""
        super().__init__(system, frame)
        self.modes = modes
        forcing, r = system.forcing, system.n
        forces = np.vstack([forcing.constant, forcing.cosine, forcing.sine]).T
        sampled, self._active = None, np.zeros(0, dtype=np.intp)
        orders = np.zeros(forcing.frequency.size)
        if forcing.sampled is not None:
            sampled, self._active = _forces(forcing.sampled)
        if isinstance(forcing.sampled, LiveSamples):
            orders = forcing.sampled.orders.astype(np.float64)
        self._phases = int(orders.any())
        forces = np.hstack([forces, np.eye(len(forces))[:, self._active]])
        loads = modes.pushed(self._pushed(forces)).reshape(2 * r, forces.shape[1])
        load, push = np.hsplit(loads, [1 + 2 * forcing.frequency.size])
        self._rate = max(modes.fastest, *forcing.fastest, 0.0)
        self._kernel = Strides(
            modes.coordinates(frame),
            modes.J.reshape(2 * r, -1) if r else np.zeros((0, 2)),
            (forcing.frequency, Angles(forcing.frequency).turns),
            load,
            self._with_phase(push),
            sampled,
            self._rate,
            orders,
        )

    def start(self, t: float, x: Vector) -> PhaseMotion:
        """The motion through ``x`` at ``t``."""
        return self._kernel.start(t, x)

    def guards(self, functions: Functions) -> Guards:
        """``functions`` of all motions."""
        time = 1 / self._rate if self._rate > 0 else 0.0
        position, *rows = self._seen(functions, time)
        force = self._with_phase(functions.force[:, self._active])
        return self._kernel.guards(position, *self.modes.seen(*rows), functions.waves, force)

    def _with_phase(self, forces: Matrix) -> Matrix:
        """Columns of sampled forces, and of the drive's phase, which is no force."""
        return np.pad(forces, ((0, 0), (0, self._phases)))

    @cached_property
    def _spectral(self) -> SpectralFlow:
        return SpectralFlow(self._system, self.modes, self._frame)

    def moving(self, s: float) -> Matrix:
        """``T e^{Js} T^{-1}``; where it is not split, by a matrix exponential."""
        if self.modes.are_pairs and self._system.n:
            return self._spectral.moving(s)
        T, T_inverse, *_ = self.modes.coordinates(self._frame)
        if not self._system.n:
            return np.zeros((2 * len(T), 2 * len(T)))
        return np.asarray(T @ linalg.expm(s * self.modes.J[0]) @ T_inverse)


Jets: TypeAlias = NDArray[np.float64]


@lru_cache(KEPT)
def _forces(samples: Samples) -> tuple[SampledForces, NDArray[np.intp]]:
    """The forces that are not always zero, and their coordinates.

    The phase of a drive is the last of the forces, if something turns with it.
    """
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
