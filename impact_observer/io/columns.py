"""The states of a topic as arrays with one order of coordinates, block by block."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import BagError
from impact_observer.io.interfaces import OBSERVER_STATE
from impact_observer.io.messages import AnyMessage, MessageError, read_estimate, read_joint_state
from impact_observer.io.state_blocks import StateRows, decode
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
    """

    law: str
    last_sequence: NDArray[np.uint64]
    last_event: Stamps


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
    ) -> None:
        """Collect messages of ``type_name``.

        Args:
            source: bag and topic, named in errors.
            type_name: ``JOINT_STATE`` or ``OBSERVER_STATE``.
            names: of the columns; None for those of the first message.
            deserialize: a message from its bytes.
        """
        self._source = source
        self._type = type_name
        self._names = None if names is None else tuple(names)
        self._deserialize = deserialize
        self._orders: dict[tuple[str, ...], list[int]] = {}
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
        together, alone = decode(self._type, block)
        table = _Table(len(block))
        if block and self._names is None:
            self._names = self._one(block, 0)[0]
        for rows in together:
            names, first = self._one(block, int(rows.at[0]))
            # If one of them is invalid, each is read alone, so that an error can name it.
            if rows.valid.all() and _first_row_equals(rows, first):
                table.put(rows, self._order(names))
            else:
                alone += rows.at.tolist()
        for i in sorted(alone):
            names, rows = self._one(block, i)
            table.put(rows, self._order(names))
        self._taken += len(block)
        return self._block(table)

    def _block(self, table: "_Table") -> JointStates:
        """The columns, read-only."""
        names = self._names or ()
        x = table.x.reshape(len(table.stamps), 2 * len(names))
        for each in (x, table.stamps, table.last_sequence, table.last_event):
            each.setflags(write=False)
        q, u = x[:, : len(names)], x[:, len(names) :]
        if self._type != OBSERVER_STATE:
            return JointStates(names, table.stamps, q, u)
        law = self._law or ""
        sequences, events = table.last_sequence, table.last_event
        return ObserverStates(names, table.stamps, q, u, law, sequences, events)

    def _one(self, block: Sequence[bytes], i: int) -> tuple[tuple[str, ...], StateRows]:
        """The names and the row of one message, checked."""
        message = self._deserialize(block[i])
        at, sequence, event = np.array([i]), np.uint64(0), 0
        try:
            if self._type == OBSERVER_STATE:
                names, state = read_estimate(message)
                self._check_law(state.law)
                stamp, q, u = state.stamp, state.q, state.u
                sequence, event = np.uint64(state.last_sequence), state.last_event
            else:
                joint = read_joint_state(message)
                names, stamp, q, u = joint.names, joint.stamp, joint.q, joint.u
        except MessageError as error:
            place = f"{self._source}, message {self._taken + i}"
            raise BagError(f"{place}: {error}") from error
        row = StateRows(
            at,
            np.array([stamp], dtype=np.int64),
            q[np.newaxis],
            u[np.newaxis],
            np.array([sequence], dtype=np.uint64),
            np.array([event], dtype=np.int64),
        )
        return names, row

    def _check_law(self, law: str) -> None:
        """Check that the law is that of the messages before."""
        if self._law not in (None, law):
            raise BagError(
                f"{self._source} changes its law from {self._law} to {law}; "
                "expected one law a topic, such as /observer_<law>/state"
            )
        self._law = law

    def _order(self, found: tuple[str, ...]) -> list[int]:
        """For each column, the index of its coordinate in a message with the names ``found``."""
        if (order := self._orders.get(found)) is not None:
            return order
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
        return self._orders.setdefault(found, [found.index(name) for name in wanted])


class _Table:
    """The columns of a block while they are filled."""

    def __init__(self, size: int) -> None:
        self.stamps = np.zeros(size, dtype=np.int64)
        self.last_sequence = np.zeros(size, dtype=np.uint64)
        self.last_event = np.zeros(size, dtype=np.int64)
        self.x = np.zeros((size, 0))

    def put(self, rows: StateRows, order: list[int]) -> None:
        """Fill in ``rows``, their coordinates in ``order``."""
        if self.x.shape[1] != 2 * len(order):
            self.x = np.zeros((len(self.stamps), 2 * len(order)))
        self.stamps[rows.at] = rows.stamps
        self.x[rows.at] = np.hstack([rows.q[:, order], rows.u[:, order]])
        self.last_sequence[rows.at] = rows.last_sequence
        self.last_event[rows.at] = rows.last_event


def _first_row_equals(rows: StateRows, first: StateRows) -> bool:
    """Whether the layout and ``rosbags`` decode the first message alike."""
    return all(
        np.asarray(ours[0]).tobytes() == np.asarray(theirs[0]).tobytes()
        for ours, theirs in zip(rows, first, strict=True)
    )


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
