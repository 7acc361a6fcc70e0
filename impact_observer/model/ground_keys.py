# SPDX-License-Identifier: Apache-2.0
"""The key ``grounds`` of a model file: grounds and their motions."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
import scipy

from impact_observer.errors import ModelError
from impact_observer.model import sampled_files
from impact_observer.model.document import Section, Value
from impact_observer.model.force_samples import JETS, Samples
from impact_observer.model.forcing import Forcing
from impact_observer.model.grounds import Grounds, LiveNames, motion_of
from impact_observer.states import Matrix, Vector

KINDS = ("harmonics", "sampled")
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

    def unit(self, name: Value) -> Vector:
        """The unit vector of a ground, shape (k,); zero for any other name."""
        return np.array([float(each == name) for each in self.names])

    def grounds(self, stiffness: Matrix, damping: Matrix, factors: Matrix) -> Grounds:
        """The grounds with their effects on a system; the shapes are those of ``Grounds``."""
        motion = motion_of(len(self.names), self.harmonics)
        if self.samples is not None:
            motion = motion.added(Forcing.of_samples(self.samples))
        owner = tuple(each[0] for each in self.harmonics)
        return Grounds(self.names, motion, owner, stiffness, damping, factors, self.written)


def read_grounds(document: Section, taken: Sequence[str], folder: Path | None) -> GroundMotions:
    """The grounds of a ``document``, whose names may not be ``taken``.

    Raises:
        ModelError: a value is wrong; the error names the key, or file, line and column.
    """
    items = [Section(key, value, ("name", "motion")) for key, value in document.items("grounds")]
    names: list[str] = []
    for item in items:
        name = item.text("name")
        if name in (*taken, *names):
            raise ModelError(item.key("name"), f"{name!r} is taken already; names must differ")
        names.append(name)
    harmonics: list[Harmonic] = []
    sampled: Samples | None = None
    written: list[Mapping[str, Value]] = []
    for k, item in enumerate(items):
        motion = Section(item.key("motion"), item.value("motion"), KINDS)
        if sum(kind in motion for kind in KINDS) != 1:
            raise ModelError(item.key("motion"), f"expected one of {', '.join(KINDS)}")
        if "harmonics" in motion:
            harmonics += _harmonics(k, motion)
            written.append({"name": names[k], "motion": {"harmonics": motion.value("harmonics")}})
            continue
        table = sampled_files.read_table(motion, "sampled", (_DISPLACEMENT,), folder)
        spline = _clamped(motion.key("sampled"), table).mapped(np.eye(len(items))[:, [k]])
        sampled = spline if sampled is None else sampled.plus(spline)
        text = sampled_files.csv_text(table, (_DISPLACEMENT,))
        written.append({"name": names[k], "motion": {"sampled": text}})
    return GroundMotions(tuple(names), tuple(harmonics), sampled, tuple(written))


def _harmonics(ground: int, motion: Section) -> Iterator[Harmonic]:
    for key, value in motion.items("harmonics"):
        each = Section(key, value, ("amplitude", "frequency", "phase"))
        frequency = each.positive("frequency")
        yield ground, each.number("amplitude"), frequency, each.number("phase", 0.0)


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


def live_names(
    inputs: Sequence[tuple[str, Vector]],
    n: int,
) -> LiveNames | None:
    """The live signals of a model, None without any; directions of equal input names add up."""
    names = tuple(dict.fromkeys(name for name, _ in inputs))
    if not names:
        return None
    directions = np.zeros((n, len(names)))
    for name, direction in inputs:
        directions[:, names.index(name)] += direction
    return LiveNames(names, directions)
