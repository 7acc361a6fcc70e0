# SPDX-License-Identifier: Apache-2.0
"""The states of a topic as arrays with one order of coordinates."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import BagError
from impact_observer.io.messages import (
    AnyMessage,
    JointState,
    MessageError,
    read_estimate,
    read_joint_state,
)
from impact_observer.states import Estimate, Matrix, Stamps


@dataclass(frozen=True, slots=True, eq=False)
class JointStates:
    """The states of one topic, in bag order.

    Attributes:
        names: the coordinates' names, in the order of the columns.
        stamps: when each state holds, shape (N,), ns.
        q: coordinates, shape (N, n), m or rad.
        u: velocities, shape (N, n), m/s or rad/s.
    """

    names: tuple[str, ...]
    stamps: Stamps
    q: Matrix
    u: Matrix


@dataclass(frozen=True, slots=True, eq=False)
class ObserverStates(JointStates):
    """The estimates of one observer, in bag order.

    Attributes:
        law: name of the law, the same throughout; empty without any message.
        last_sequence: sequence number of the last event applied, shape (N,); 0 before the first.
        last_event: stamp of the last event applied, shape (N,), ns; 0 before the first.
        covariance: order (q, u), shape (N, 2n, 2n), NaN for an estimate without covariance; shape
            (N, 0, 0) if covariances were not asked for or no estimate has one.
    """

    law: str
    last_sequence: NDArray[np.uint64]
    last_event: Stamps
    covariance: NDArray[np.float64]


def deviations_in(block: JointStates) -> NDArray[np.float64]:
    """Standard deviations of coordinates and velocities, shape (rows, 2n); NaN without."""
    if isinstance(block, ObserverStates) and block.covariance.size:
        variances = np.diagonal(block.covariance, axis1=1, axis2=2)
        # Rounding may leave a variance slightly below zero.
        return np.asarray(np.sqrt(np.where(variances < 0, 0.0, variances)))
    return np.full((block.stamps.size, 2 * len(block.names)), np.nan)


class StateCollector:
    """Collects the messages of one topic and makes arrays of them."""

    def __init__(
        self,
        source: str,
        names: Sequence[str] | None,
        *,
        estimates: bool,
        covariance: bool = False,
    ) -> None:
        """Begin without messages.

        Args:
            source: bag and topic, named in errors.
            names: of the columns; None for the names of the first message.
            estimates: whether the messages are ``ObserverState``; else ``JointState``.
            covariance: whether the covariances of estimates are kept.
        """
        self._source = source
        self._names = None if names is None else tuple(names)
        self._has_estimates = estimates
        self._keeps_covariance = covariance
        self._law = ""
        self._taken = 0
        self._rows: list[tuple[JointState | Estimate, list[int]]] = []

    def __len__(self) -> int:
        """Returns the number of messages since the last call of ``take``."""
        return len(self._rows)

    def append(self, message: AnyMessage) -> None:
        """Append a message.

        Raises:
            BagError: the message has no finite position and velocity for every name, its names are
                not the expected ones, or the law has changed.
        """
        state: JointState | Estimate
        try:
            if self._has_estimates:
                names, state = read_estimate(message)
            else:
                state = read_joint_state(message)
                names = state.names
        except MessageError as error:
            place = f"{self._source}, message {self._taken + len(self._rows)}"
            raise BagError(f"{place}: {error}") from error
        if isinstance(state, Estimate):
            if self._law not in ("", state.law):
                raise BagError(
                    f"{self._source} changes its law from {self._law} to {state.law}; "
                    "expected one law a topic, such as /observer_<law>/state"
                )
            self._law = state.law
        self._rows.append((state, self._order(names)))

    def take(self) -> JointStates:
        """Returns the messages since the last call; estimates are ``ObserverStates``."""
        rows, self._rows = self._rows, []
        self._taken += len(rows)
        names, count = self._names or (), len(rows)
        stamps = np.array([state.stamp for state, _ in rows], dtype=np.int64)
        q = np.array([state.q[order] for state, order in rows]).reshape(count, len(names))
        u = np.array([state.u[order] for state, order in rows]).reshape(count, len(names))
        if not self._has_estimates:
            return _read_only(JointStates(names, stamps, q, u))
        estimates = [(state, order) for state, order in rows if isinstance(state, Estimate)]
        return _read_only(
            ObserverStates(
                names,
                stamps,
                q,
                u,
                self._law,
                np.array([each.last_sequence for each, _ in estimates], dtype=np.uint64),
                np.array([each.last_event for each, _ in estimates], dtype=np.int64),
                self._covariances(estimates),
            )
        )

    def _covariances(self, rows: Sequence[tuple[Estimate, list[int]]]) -> NDArray[np.float64]:
        """The covariances in the order of the names; NaN for an estimate without covariance."""
        has_some = self._keeps_covariance and any(each.covariance.size for each, _ in rows)
        side = 2 * len(self._names or ()) if has_some else 0
        covariance = np.full((len(rows), side, side), np.nan)
        for i, (each, order) in enumerate(rows if has_some else ()):
            if each.covariance.size:
                both = [*order, *(len(order) + k for k in order)]
                covariance[i] = each.covariance[np.ix_(both, both)]
        return covariance

    def _order(self, names: tuple[str, ...]) -> list[int]:
        """Returns the places of the wanted names among those of a message."""
        if names == self._names:
            return list(range(len(names)))
        if self._names is None:
            self._names = names
        wanted = self._names
        double = sorted({name for name in names if names.count(name) > 1})
        missing = [name for name in wanted if name not in names]
        extra = [name for name in names if name not in wanted]
        for problem, those in (("names twice", double), ("lacks", missing), ("has also", extra)):
            if those:
                raise BagError(
                    f"{self._source} {problem} {', '.join(those)}; "
                    f"expected the coordinates {', '.join(wanted)}"
                )
        return [names.index(name) for name in wanted]


def joined(blocks: Iterable[JointStates]) -> JointStates:
    """Returns one block made of one or several of the same topic."""
    several = [*blocks]
    arrays: dict[str, Any] = {
        each.name: np.concatenate([getattr(block, each.name) for block in several])
        for each in fields(several[0])
        if isinstance(getattr(several[0], each.name), np.ndarray)
    }
    return _read_only(replace(several[-1], **arrays))


def _read_only(states: JointStates) -> JointStates:
    """Returns ``states`` after its arrays are made read-only."""
    for each in fields(states):
        if isinstance(array := getattr(states, each.name), np.ndarray):
            array.setflags(write=False)
    return states
