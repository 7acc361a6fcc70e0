# SPDX-License-Identifier: Apache-2.0
"""The states of a topic as arrays with one order of coordinates."""

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import BagError
from impact_observer.states import Estimate, Matrix, Stamps


@dataclass(frozen=True, slots=True, eq=False)
class RecordedStates:
    """The states on one topic, in bag order: true ones, or estimates.

    Attributes:
        names: the coordinates' names, in the order of the columns.
        stamps: when each state holds, shape (N,), ns.
        x: coordinates and velocities (q, u), shape (N, 2n), SI units.
        deviations: their standard deviations, shape (N, 2n); NaN where there is no covariance.
        law: name of the law, the same throughout; empty without one.
        last_sequence: sequence number of the last event applied, shape (N,); 0 before the first.
        last_event: stamp of the last event applied, shape (N,), ns; 0 before the first, and that
            of the state itself where a message does not have one.
    """

    names: tuple[str, ...]
    stamps: Stamps
    x: Matrix
    deviations: Matrix
    law: str
    last_sequence: NDArray[np.uint64]
    last_event: Stamps

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for each in fields(self):
            if isinstance(values := getattr(self, each.name), np.ndarray):
                values.setflags(write=False)

    @property
    def q(self) -> Matrix:
        """Coordinates, shape (N, n), m or rad."""
        return self.x[:, : len(self.names)]

    @property
    def u(self) -> Matrix:
        """Velocities, shape (N, n), m/s or rad/s."""
        return self.x[:, len(self.names) :]


def state_arrays(
    states: Iterable[tuple[tuple[str, ...], Estimate]], names: Sequence[str] | None, source: str
) -> RecordedStates:
    """States, each with the names of its coordinates, as arrays.

    Args:
        states: in any order of coordinates.
        names: of the columns; None for the names of the first state.
        source: bag and topic, named in errors.

    Raises:
        BagError: other names than those of the columns, or a law that changes.
    """
    wanted = None if names is None else tuple(names)
    stamps, events, sequences = array("q"), array("q"), array("Q")
    x, deviations, law = array("d"), array("d"), ""
    orders = dict[tuple[str, ...], NDArray[np.intp]]()
    for own, each in states:
        wanted = own if wanted is None else wanted
        if (order := orders.get(own)) is None:
            order = orders[own] = _order(own, wanted, source)
        if law not in ("", each.law):
            raise BagError(
                f"{source} changes its law from {law} to {each.law};"
                " expected one law a topic, such as /observer_<law>/state"
            )
        law = each.law
        stamps.append(each.stamp)
        events.append(each.last_event)
        sequences.append(each.last_sequence)
        x.frombytes(np.concatenate([each.q, each.u])[order].tobytes())
        if each.covariance.size:  # rounding may leave a variance slightly below zero
            variances = np.diagonal(each.covariance)[order].clip(0.0)
            deviations.frombytes(np.sqrt(variances).tobytes())
        else:
            deviations.extend([np.nan] * order.size)
    columns = 2 * len(wanted or ())
    return RecordedStates(
        wanted or (),
        np.array(stamps, dtype=np.int64),
        np.array(x).reshape(len(stamps), columns),
        np.array(deviations).reshape(len(stamps), columns),
        law,
        np.array(sequences, dtype=np.uint64),
        np.array(events, dtype=np.int64),
    )


def _order(own: tuple[str, ...], wanted: tuple[str, ...], source: str) -> NDArray[np.intp]:
    """The places of the ``wanted`` coordinates, and of their velocities, among a state's own."""
    double = sorted({name for name in own if own.count(name) > 1})
    missing = [name for name in wanted if name not in own]
    extra = [name for name in own if name not in wanted]
    for problem, found in (("names twice", double), ("lacks", missing), ("has also", extra)):
        if found:
            expected = f"expected the coordinates {', '.join(wanted)}"
            raise BagError(f"{source} {problem} {', '.join(found)}; {expected}")
    order = np.array([own.index(name) for name in wanted], dtype=np.intp)
    return np.concatenate([order, len(own) + order])
