# SPDX-License-Identifier: Apache-2.0
"""The states of a topic as arrays with one order of coordinates, block by block."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import BagError
from impact_observer.io.interfaces import OBSERVER_STATE
from impact_observer.io.messages import AnyMessage, MessageError, read_estimate, read_joint_state
from impact_observer.io.state_blocks import StateRows, decode, no_rows
from impact_observer.states import Matrix, Stamps


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
        law: name of the law, the same throughout; empty when there is no message.
        last_sequence: sequence number of the last event applied, shape (N,); 0 before the first.
        last_event: stamp of the last event applied, shape (N,), ns; 0 before the first.
        covariance: order (q, u), shape (N, 2n, 2n), NaN where an estimate has none; shape
            (N, 0, 0) unless it was asked for and some estimate has one.
    """

    law: str
    last_sequence: NDArray[np.uint64]
    last_event: Stamps
    covariance: NDArray[np.float64]


class Columns:
    """Collects the messages of one topic and makes blocks of them.

    Messages of one shape are decoded together. Invalid messages and those without a layout are
    read one by one, so that an error names the message.
    """

    def __init__(
        self,
        source: str,
        type_name: str,
        names: Sequence[str] | None,
        deserialize: Callable[[bytes], AnyMessage],
        *,
        covariance: bool = False,
    ) -> None:
        """Collect messages of ``type_name``.

        Args:
            source: bag and topic, named in errors.
            type_name: ``JOINT_STATE`` or ``OBSERVER_STATE``.
            names: of the columns; None for those of the first message.
            deserialize: a message from its bytes.
            covariance: whether estimates are wanted with theirs.
        """
        self._source = source
        self._type = type_name
        self._names = None if names is None else tuple(names)
        self._deserialize = deserialize
        self._covariance = covariance
        self._pending: list[bytes] = []
        self._taken = 0
        self._law: str | None = None

    def __len__(self) -> int:
        """Messages added since the last block."""
        return len(self._pending)

    def add(self, data: Sequence[bytes]) -> None:
        """Add serialized messages."""
        self._pending += data

    def take(self) -> JointStates:
        """A block of the messages added since the last one; of estimates, ``ObserverStates``.

        Raises:
            BagError: a message has no finite position and velocity for every name, its names are
                not the expected ones, or the law has changed.
        """
        block, self._pending = self._pending, []
        if block and self._names is None:
            self._names = self._one(block, 0)[0]
        together, alone = decode(self._type, block)
        parts = [no_rows(len(self._names or ()))]
        for rows in together:
            if rows.valid.all():
                names, _ = self._one(block, int(rows.at[0]))
                parts.append(self._in_columns(names, rows))
            else:
                alone += rows.at.tolist()
        parts += (self._in_columns(*self._one(block, i)) for i in sorted(alone))
        self._taken += len(block)
        return self._block(parts)

    def _block(self, parts: Sequence[StateRows]) -> JointStates:
        """The rows of all parts in the order of the messages, read-only."""
        order = np.argsort(np.concatenate([part.at for part in parts]))
        # Without a covariance the rows are one NaN, broadcast: copies of it would be large.
        if not (self._covariance and any(each.covariance.strides[-1] for each in parts)):
            parts = [each._replace(covariance=each.covariance[:, :0, :0]) for each in parts]
        columns = StateRows(*(np.concatenate(each)[order] for each in zip(*parts, strict=True)))
        for each in columns:
            each.setflags(write=False)
        _, stamps, q, u, sequences, events, covariance = columns
        names, law = self._names or (), self._law or ""
        if self._type != OBSERVER_STATE:
            return JointStates(names, stamps, q, u)
        return ObserverStates(names, stamps, q, u, law, sequences, events, covariance)

    def _one(self, block: Sequence[bytes], i: int) -> tuple[tuple[str, ...], StateRows]:
        """The names and the row of one message, checked."""
        message = self._deserialize(block[i])
        rows = no_rows(len(message.name), 1)
        rows.at[0] = i
        try:
            if self._type == OBSERVER_STATE:
                names, state = read_estimate(message)
                if self._law not in (None, state.law):
                    raise BagError(
                        f"{self._source} changes its law from {self._law} to {state.law}; "
                        "expected one law a topic, such as /observer_<law>/state"
                    )
                self._law = state.law
                rows.stamps[0], rows.q[0], rows.u[0] = state.stamp, state.q, state.u
                rows.last_sequence[0], rows.last_event[0] = state.last_sequence, state.last_event
                if state.covariance.size:
                    rows = rows._replace(covariance=state.covariance[None])
            else:
                joint = read_joint_state(message)
                names = joint.names
                rows.stamps[0], rows.q[0], rows.u[0] = joint.stamp, joint.q, joint.u
        except MessageError as error:
            place = f"{self._source}, message {self._taken + i}"
            raise BagError(f"{place}: {error}") from error
        return names, rows

    def _in_columns(self, found: tuple[str, ...], rows: StateRows) -> StateRows:
        """Rows of messages with the names ``found``, their coordinates in the order wanted."""
        wanted = self._names or ()
        double = sorted({name for name in found if found.count(name) > 1})
        missing = [name for name in wanted if name not in found]
        extra = [name for name in found if name not in wanted]
        for problem, those in (("names twice", double), ("lacks", missing), ("has also", extra)):
            if those:
                raise BagError(
                    f"{self._source} {problem} {', '.join(those)}; "
                    f"expected the coordinates {', '.join(wanted)}"
                )
        if found == wanted:
            return rows
        order = [found.index(name) for name in wanted]
        both = [*order, *(len(order) + i for i in order)]
        covariance = rows.covariance[:, both][:, :, both] if self._covariance else rows.covariance
        return rows._replace(q=rows.q[:, order], u=rows.u[:, order], covariance=covariance)


def joined(blocks: Iterable[JointStates]) -> JointStates:
    """One block from one or several of the same topic."""
    several = [*blocks]
    arrays: dict[str, Any] = {
        each.name: np.concatenate([getattr(block, each.name) for block in several])
        for each in fields(several[0])
        if isinstance(getattr(several[0], each.name), np.ndarray)
    }
    for array in arrays.values():
        array.setflags(write=False)
    return replace(several[-1], **arrays)
