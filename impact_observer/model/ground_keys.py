# SPDX-License-Identifier: Apache-2.0
"""The key ``grounds`` of a model file: grounds and their motions."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import msgspec
import numpy as np
import scipy
from msgspec import UnsetType

from impact_observer.errors import ModelError
from impact_observer.model.document import Value, check_names
from impact_observer.model.force_samples import JETS, Samples
from impact_observer.model.forcing import Forcing
from impact_observer.model.grounds import Grounds, LiveNames, motion_of
from impact_observer.model.sampled_files import csv_text, read_table
from impact_observer.model.schema import Ground, Wave
from impact_observer.states import Matrix, Vector

_DISPLACEMENT = "displacement"
Harmonic: TypeAlias = tuple[int, float, float, float]
"""Ground, amplitude (m), frequency (rad/s) and phase (rad)."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundMotions:
    """The grounds of a model file.

    Attributes:
        names: of the grounds.
        harmonics: of their motions.
        samples: displacements of the sampled grounds, k columns; None without such grounds.
        written: the value of the key ``grounds`` with all tables written out.
    """

    names: tuple[str, ...] = ()
    harmonics: tuple[Harmonic, ...] = ()
    samples: Samples | None = None
    written: tuple[Mapping[str, Value], ...] = ()

    def grounds(self, stiffness: Matrix, damping: Matrix, factors: Matrix) -> Grounds:
        """The grounds with their effects on a system; the shapes are those of ``Grounds``."""
        motion = motion_of(len(self.names), self.harmonics)
        if self.samples is not None:
            motion = motion.added(Forcing.of_samples(self.samples))
        owner = tuple(each[0] for each in self.harmonics)
        return Grounds(self.names, motion, owner, stiffness, damping, factors, self.written)


def read_grounds(
    grounds: Sequence[Ground], taken: Sequence[str], folder: Path | None
) -> GroundMotions:
    """The ``grounds`` of a model file, whose names may not be ``taken``.

    Raises:
        ModelError: a value is wrong; the error names the key, or file, line and column.
    """
    names = [each.name for each in grounds]
    check_names("grounds", names, member=".name", taken=taken)
    harmonics: list[Harmonic] = []
    sampled: Samples | None = None
    written: list[Mapping[str, Value]] = []
    for k, ground in enumerate(grounds):
        key, waves, table = f"grounds[{k}].motion", ground.motion.harmonics, ground.motion.sampled
        own = msgspec.to_builtins(ground)
        if isinstance(waves, UnsetType) == isinstance(table, UnsetType):
            raise ModelError(key, "expected one of harmonics, sampled")
        if not isinstance(waves, UnsetType):
            harmonics += _harmonics(k, f"{key}.harmonics", waves)
        elif not isinstance(table, UnsetType):
            rows = read_table(f"{key}.sampled", table, (_DISPLACEMENT,), folder)
            spline = _clamped(f"{key}.sampled", rows).mapped(np.eye(len(grounds))[:, [k]])
            sampled = spline if sampled is None else sampled.plus(spline)
            own["motion"]["sampled"] = csv_text(rows, (_DISPLACEMENT,))
        written.append(own)
    return GroundMotions(tuple(names), tuple(harmonics), sampled, tuple(written))


def _harmonics(ground: int, key: str, waves: Sequence[Wave]) -> Iterator[Harmonic]:
    for i, wave in enumerate(waves):
        yield ground, wave.amplitude, wave.omega(f"{key}[{i}]"), wave.phase


def _clamped(key: str, table: Matrix) -> Samples:
    """The C2 cubic spline through a ``table`` of instants and displacements, at rest at its ends.

    Raises:
        ModelError: fewer than two instants, or instants that do not ascend.
    """
    try:
        time = Samples(table[:, 0], table[:, 1:], "linear").time
    except ModelError as error:
        raise ModelError(key, error.problem) from None
    parts = scipy.interpolate.CubicSpline(time, table[:, 1:], bc_type="clamped").c[::-1]
    jets = np.zeros((JETS, *table[:, 1:].shape))
    jets[:, :-1] = parts * np.array([1.0, 1.0, 2.0, 6.0])[:, None, None]
    jets[0] = table[:, 1:]
    return Samples.of_jets(time, jets)


def live_names(inputs: Sequence[tuple[str, Vector]], n: int) -> LiveNames | None:
    """The live signals of a model, None without any; directions of equal input names add up."""
    names = tuple(dict.fromkeys(name for name, _ in inputs))
    if not names:
        return None
    directions = np.zeros((n, len(names)))
    for name, direction in inputs:
        directions[:, names.index(name)] += direction
    return LiveNames(names, directions)
