# SPDX-License-Identifier: Apache-2.0
"""How well the parameters of a model are known: the covariance of their values."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from impact_observer.errors import ModelError
from impact_observer.model.document import LARGEST, Value, finite, symmetric
from impact_observer.model.schema import UncertaintyKeys
from impact_observer.stamps import MAX_STAMP
from impact_observer.states import Matrix, Vector, frozen

KEY = "uncertainty"
_ROUNDING = 1e-9
"""Largest error of a covariance that counts as rounding, relative to the deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class ParameterUncertainty:
    """Gaussian errors of the values that a model file gives to p parameters.

    Attributes:
        names: of the parameters, as ``identify --free`` has them, such as ``restitution.stop``.
        covariance: of their errors, shape (p, p), squares of SI units; zero for exact values.
        fitted_to: first and last stamp of the impacts from which the values were fitted, ns;
            None for other values.

    Raises:
        ModelError: a value is wrong; the error names the key of the model file.
    """

    names: tuple[str, ...]
    covariance: Matrix
    fitted_to: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        """Copy, freeze and check all fields."""
        p, names = len(self.names), f"{KEY}.names"
        for i, name in enumerate(self.names):
            if name in self.names[:i]:
                raise ModelError(f"{names}[{i}]", f"{name!r} found twice; name it once")
        covariance = _checked_covariance(self.covariance, p)
        object.__setattr__(self, "covariance", covariance)
        if self.fitted_to is None:
            return
        first, last = self.fitted_to
        if not 0 <= first <= last <= MAX_STAMP:
            raise ModelError(
                f"{KEY}.fitted_to",
                f"{first} to {last} found; expected the first and the last stamp of a recording,"
                f" ns, from 0 to {MAX_STAMP}",
            )

    @property
    def deviations(self) -> Vector:
        """Standard deviations of the values, shape (p,), SI units."""
        return frozen(np.sqrt(np.diag(self.covariance)))

    @property
    def deviation_by_name(self) -> dict[str, float]:
        """Standard deviation of each value by the name of its parameter, SI units."""
        return dict(zip(self.names, self.deviations.tolist(), strict=True))

    def is_fitted_to(self, stamps: Iterable[int]) -> bool:
        """Whether the first or the last impact of the recording of the values is of ``stamps``.

        Stamps are in ns. Recordings of other times may begin at the same stamp, as files do.
        """
        return not {*(self.fitted_to or ())}.isdisjoint(stamps)

    def without(self, names: Collection[str]) -> "ParameterUncertainty | None":
        """The deviations of other parameters than ``names``; None if there are none."""
        kept = [k for k, name in enumerate(self.names) if name not in names]
        if not kept:
            return None
        own = tuple(self.names[k] for k in kept)
        return replace(self, names=own, covariance=self.covariance[np.ix_(kept, kept)])

    def correlation(self, names: Sequence[str]) -> Matrix:
        """The correlations of parameters; others than those of ``names`` have none.

        Shape (k, k) for k names.
        """
        found, where = np.eye(len(names)), {name: i for i, name in enumerate(self.names)}
        own = [k for k, name in enumerate(names) if name in where]
        here = [where[names[k]] for k in own]
        found[np.ix_(own, own)] = correlations_of(self.covariance)[np.ix_(here, here)]
        np.fill_diagonal(found, 1.0)
        return found

    @property
    def document(self) -> dict[str, Value]:
        """The value of the key ``uncertainty`` in a model file."""
        found: dict[str, Value] = {
            "names": list(self.names),
            "covariance": self.covariance.tolist(),
        }
        if self.fitted_to is not None:
            found["fitted_to"] = dict(zip(("first", "last"), self.fitted_to, strict=True))
        return found


def correlations_of(covariance: Matrix) -> Matrix:
    """The correlations of numbers with units of their own; 0 of one without an error, (p, p)."""
    scale = _scale(covariance)
    return np.asarray(covariance / np.outer(scale, scale))


def root_in_own_units(covariance: Matrix) -> Matrix:
    """A square root of a ``covariance`` of numbers with units of their own, shape (p, p)."""
    values, axes = np.linalg.eigh(correlations_of(covariance))
    return np.asarray(_scale(covariance)[:, None] * axes * np.sqrt(np.maximum(values, 0.0)))


def _scale(covariance: Matrix) -> Vector:
    deviations = np.sqrt(np.diag(covariance))
    return np.where(deviations > 0, deviations, 1.0)


def read_uncertainty(declared: UncertaintyKeys | None) -> ParameterUncertainty | None:
    """The key ``uncertainty`` of a model file; None where the file has no such key.

    Raises:
        ModelError: a value is wrong.
    """
    if declared is None:
        return None
    ends = declared.fitted_to
    fitted_to = None if ends is None else (ends.first, ends.last)
    covariance = np.array(declared.covariance, dtype=object)  # rows may have any lengths
    return ParameterUncertainty(declared.names, covariance, fitted_to)


def _checked_covariance(covariance: Matrix, p: int) -> Matrix:
    """The covariance of ``p`` parameters, frozen and exactly symmetric.

    Raises:
        ModelError: not finite, not symmetric or not positive semidefinite.
    """
    key = f"{KEY}.covariance"
    given = finite(key, covariance, (p, p), f"{p} x {p} numbers, one row a name", LARGEST**2)
    for i in np.flatnonzero(np.diag(given) < 0):
        raise ModelError(f"{key}[{i}][{i}]", f"is {given[i, i]:g}; expected a variance, >= 0")
    deviations = np.sqrt(np.diag(given))
    sizes = np.outer(deviations, deviations)
    scale = np.where(sizes > 0, sizes, 1.0)
    even = symmetric(key, given, _ROUNDING * sizes)
    correlated = np.any(np.abs(given) > (1 + _ROUNDING) * sizes)
    if correlated or np.linalg.eigvalsh(given / scale).min(initial=0.0) < -_ROUNDING * p:
        raise ModelError(
            key, "is not positive semidefinite; expected correlations that are possible together"
        )
    return even
