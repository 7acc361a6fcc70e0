# SPDX-License-Identifier: Apache-2.0
"""Keeps items with stamps too far ahead of the clock until the clock is near enough."""

import bisect
from typing import Generic, TypeVar

_Item = TypeVar("_Item")


class AheadOfClock(Generic[_Item]):
    """Items in the order of their stamps; items of one stamp in the order of arrival."""

    def __init__(self, most: int) -> None:
        """Keep at most ``most`` items: those with the least stamps."""
        self._most = most
        self._items: list[tuple[int, int, _Item]] = []
        self._number = 0

    def __len__(self) -> int:
        """Number of items that are kept."""
        return len(self._items)

    def keep(self, stamp: int, item: _Item) -> _Item | None:
        """Keep ``item`` for ``stamp`` (ns).

        Returns:
            The item with the largest stamp if there is no room for it; else None.
        """
        self._number += 1
        bisect.insort(self._items, (stamp, self._number, item))
        return self._items.pop()[2] if len(self._items) > self._most else None

    def take_next(self, latest: int) -> _Item | None:
        """Remove and return the first item if its stamp is at most ``latest`` (ns); else None."""
        if self._items and self._items[0][0] <= latest:
            return self._items.pop(0)[2]
        return None

    def clear(self) -> None:
        """Forget all items."""
        self._items.clear()
