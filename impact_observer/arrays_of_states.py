# SPDX-License-Identifier: Apache-2.0
"""States of a motion as arrays, with their deviations."""

from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from impact_observer.states import Estimates, Matrix, Vector

if TYPE_CHECKING:
    from collections.abc import Iterable


class StateArrays(NamedTuple):
    """States at S instants.

    Attributes:
        names: of coordinates and velocities, length 2n.
        seconds: since the epoch, shape (S,), s.
        states: (q, u), shape (S, 2n), SI units.
        deviations: standard deviations, shape (S, 2n); NaN of a law without a covariance.
    """

    names: tuple[str, ...]
    seconds: Vector
    states: Matrix
    deviations: Matrix

    @classmethod
    def of(
        cls, names: tuple[str, ...], estimates: "Iterable[Estimates]", epoch: int
    ) -> "StateArrays":
        """The arrays of ``estimates``; ``epoch`` is their time zero, ns."""
        found = [each for some in estimates for each in some]
        stamps = np.array([each.stamp - epoch for each in found], dtype=np.int64)
        rows = np.zeros((len(found), len(names)))
        deviations = np.full(rows.shape, np.nan)
        for row, each in zip(rows, found, strict=True):
            row[:] = np.append(each.q, each.u)
        for row, each in zip(deviations, found, strict=True):
            if each.covariance.size:
                row[:] = np.sqrt(np.diag(each.covariance))
        return cls(names, np.asarray(stamps * 1e-9), rows, deviations)

    def plot(self) -> Any:  # noqa: ANN401 - a Figure; few need matplotlib
        """A figure of coordinates and velocities over time, with bands of two deviations."""
        figure = import_module("matplotlib.figure").Figure
        chart = figure(figsize=(8.0, 1.6 * len(self.names)), layout="constrained")
        every = np.ravel(chart.subplots(len(self.names), sharex=True))
        for axes, name, x, s in zip(
            every, self.names, self.states.T, self.deviations.T, strict=True
        ):
            axes.fill_between(self.seconds, x - 2 * s, x + 2 * s, color="0.8")
            axes.plot(self.seconds, x, color="black", linewidth=0.8)
            axes.set_ylabel(name)
        every[-1].set_xlabel("time [s]")
        return chart
