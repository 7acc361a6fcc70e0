# SPDX-License-Identifier: Apache-2.0
"""State messages read or made many at a time.

The messages of one shape (names, law, closed contacts) differ only in numbers, at the same places.
These places are found by walking through one message (OMG CDR, little endian). They hold for every
message with the same bytes elsewhere. Messages without such a layout are left to ``rosbags``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.io.interfaces import JOINT_STATE, OBSERVER_STATE
from impact_observer.stamps import MAX_STAMP, NS_PER_S
from impact_observer.states import Matrix, Stamps

_START = 4
"""Size of the header of a serialized message; alignment counts from its end."""
_LITTLE_ENDIAN = b"\x00\x01"


class StateRows(NamedTuple):
    """The contents of state messages of one shape.

    Attributes:
        at: positions of the messages in their block, shape (k,).
        stamps: ns, shape (k,).
        q: coordinates in the order of the message, shape (k, n).
        u: velocities, shape (k, n).
        last_sequence: of the last event, shape (k,); zeros for joint states.
        last_event: its stamp, ns, shape (k,); zeros for joint states.
        covariance: order (q, u), shape (k, 2n, 2n); NaN where a message has none.
    """

    at: NDArray[np.intp]
    stamps: Stamps
    q: NDArray[np.float64]
    u: NDArray[np.float64]
    last_sequence: NDArray[np.uint64]
    last_event: Stamps
    covariance: NDArray[np.float64]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which of them are finite and have stamps that a message may carry, shape (k,)."""
        finite = np.isfinite(self.q).all(axis=1) & np.isfinite(self.u).all(axis=1)
        stamped = (self.stamps > 0) & (self.stamps <= MAX_STAMP)
        events = (self.last_event >= 0) & (self.last_event <= MAX_STAMP)
        return np.asarray(finite & stamped & events)


def no_rows(n: int, size: int = 0) -> StateRows:
    """``size`` rows of ``n`` coordinates, all zeros."""
    return StateRows(
        np.zeros(size, dtype=np.intp),
        np.zeros(size, dtype=np.int64),
        np.zeros((size, n)),
        np.zeros((size, n)),
        np.zeros(size, dtype=np.uint64),
        np.zeros(size, dtype=np.int64),
        np.broadcast_to(np.nan, (size, 2 * n, 2 * n)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Where the numbers of a state message are, as offsets in bytes.

    Attributes:
        n: number of coordinates.
        stamp: of the header.
        q: of the first coordinate.
        u: of the first velocity.
        covariance: None where there is none.
        last_sequence: None for joint states.
        last_event: None for joint states.
        fixed: the bytes that make the shape, shape (size,).
    """

    n: int
    stamp: int
    q: int
    u: int
    covariance: int | None
    last_sequence: int | None
    last_event: int | None
    fixed: NDArray[np.bool_]


class _Walk:
    """Walks through the bytes of one message."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = _START
        self.fixed = np.zeros(len(data), dtype=np.bool_)
        self.fixed[:_START] = True

    def number(self, size: int, count: int = 1) -> int:
        """Pass ``count`` numbers of ``size`` bytes; the offset of the first."""
        if count:
            self._at += (_START - self._at) % size
        begin = self._at
        self._at += size * count
        if self._at > len(self._data):
            raise ValueError
        return begin

    def length(self) -> int:
        """Pass a length, which is part of the shape."""
        begin = self.number(4)
        self.fixed[begin : begin + 4] = True
        return int.from_bytes(self._data[begin : begin + 4], "little")

    def string(self) -> None:
        """Pass a text, which is part of the shape."""
        size = self.length()
        begin = self.number(1, size)
        self.fixed[begin : begin + size] = True

    def strings(self) -> int:
        """Pass a sequence of texts; their number."""
        count = self.length()
        for _ in range(count):
            self.string()
        return count

    def floats(self) -> tuple[int, int]:
        """Pass a sequence of float64; the offset of the first, and their number."""
        count = self.length()
        return self.number(8, count), count


def layout_of(type_name: str, data: bytes) -> Layout | None:
    """The layout of a message and of all others of its shape; None where it has none.

    Args:
        type_name: ``JOINT_STATE`` or ``OBSERVER_STATE``.
        data: the message, serialized.
    """
    if type_name not in {JOINT_STATE, OBSERVER_STATE} or data[:2] != _LITTLE_ENDIAN:
        return None
    walk, sequence, event = _Walk(data), None, None
    covariance, entries = 0, 0
    try:
        stamp = walk.number(4, 2)
        walk.string()
        if type_name == OBSERVER_STATE:
            walk.string()
        n = walk.strings()
        (q, positions), (u, velocities) = walk.floats(), walk.floats()
        if type_name == OBSERVER_STATE:
            covariance, entries = walk.floats()
            walk.strings()  # closed
            walk.number(8)  # convergence
            walk.number(1)  # synchronized
            walk.number(8)  # clock offset
            sequence, event = walk.number(8), walk.number(4, 2)
    except ValueError:
        return None
    if not positions == velocities == n or entries not in {0, 4 * n * n}:
        return None
    return Layout(n, stamp, q, u, covariance if entries else None, sequence, event, walk.fixed)


def decode(type_name: str, block: Sequence[bytes]) -> tuple[list[StateRows], list[int]]:
    """Decode the state messages that have a layout. Values are not checked: ``StateRows.valid``.

    Args:
        type_name: ``JOINT_STATE`` or ``OBSERVER_STATE``.
        block: messages, serialized.

    Returns:
        The rows of each shape, and the positions of the messages without a layout.
    """
    found: list[StateRows] = []
    left = np.arange(len(block))
    sizes = np.fromiter(map(len, block), dtype=np.intp, count=len(block))
    without: list[int] = []
    while left.size:
        first = int(left[0])
        layout = layout_of(type_name, block[first])
        if layout is None:
            without.append(first)
            left = left[1:]
            continue
        same = left[sizes[left] == sizes[first]]
        data = np.frombuffer(b"".join(block[i] for i in same), dtype=np.uint8)
        data = data.reshape(same.size, -1)
        fits = (data[:, layout.fixed] == data[0, layout.fixed]).all(axis=1)
        found.append(_rows(layout, data[fits], same[fits]))
        left = np.setdiff1d(left, same[fits], assume_unique=True)
    return found, without


def encode(
    type_name: str, example: bytes, stamps: Stamps, q: Matrix, u: Matrix
) -> list[bytes] | None:
    """Copies of a state message with other stamps and states; None where it has no layout.

    Args:
        type_name: ``JOINT_STATE`` or ``OBSERVER_STATE``.
        example: the message, serialized.
        stamps: of each, ns, shape (k,), which a message can carry.
        q: coordinates, shape (k, n), finite.
        u: velocities, shape (k, n), finite.
    """
    layout = layout_of(type_name, example)
    if layout is None or layout.n != q.shape[1]:
        return None
    data = np.tile(np.frombuffer(example, dtype=np.uint8), (stamps.size, 1))
    time = np.stack(np.divmod(stamps, NS_PER_S), axis=1).astype("<u4")
    for begin, values in ((layout.stamp, time), (layout.q, q), (layout.u, u)):
        raw = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).view(np.uint8)
        data[:, begin : begin + raw.shape[1]] = raw
    together, size = data.tobytes(), len(example)
    return [together[at : at + size] for at in range(0, len(together), size)]


def _rows(layout: Layout, data: NDArray[np.uint8], at: NDArray[np.intp]) -> StateRows:
    """The numbers of messages of one layout, shape (k, size)."""
    rows = no_rows(layout.n, len(data))._replace(
        at=at,
        stamps=_times(data, layout.stamp),
        q=_numbers(data, layout.q, 8 * layout.n).view("<f8"),
        u=_numbers(data, layout.u, 8 * layout.n).view("<f8"),
    )
    if layout.covariance is not None:
        end, side = layout.covariance + 32 * layout.n**2, 2 * layout.n
        numbers = data[:, layout.covariance : end].view("<f8")  # not copied: few readers want it
        rows = rows._replace(covariance=numbers.reshape(-1, side, side))
    if layout.last_sequence is None or layout.last_event is None:
        return rows
    return rows._replace(
        last_sequence=_numbers(data, layout.last_sequence, 8).view("<u8").ravel(),
        last_event=_times(data, layout.last_event),
    )


def _numbers(data: NDArray[np.uint8], begin: int, size: int) -> NDArray[np.uint8]:
    return np.ascontiguousarray(data[:, begin : begin + size])


def _times(data: NDArray[np.uint8], begin: int) -> Stamps:
    """Stamps of ``builtin_interfaces/Time``; -1 where the nanoseconds are 1e9 or more."""
    seconds = _numbers(data, begin, 4).view("<i4").ravel().astype(np.int64)
    nanoseconds = _numbers(data, begin + 4, 4).view("<u4").ravel().astype(np.int64)
    return np.where(nanoseconds < NS_PER_S, seconds * NS_PER_S + nanoseconds, -1)
