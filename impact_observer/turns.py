# SPDX-License-Identifier: Apache-2.0
"""Turns within long computations: a node publishes estimates while an event is being applied."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_wanting: list[Callable[[], None]] = []
"""Who wants turns; the last one has them."""


def give_turn() -> None:
    """Let whoever wants turns have one; to be called every few milliseconds."""
    if _wanting:
        callback = _wanting.pop()
        try:
            callback()
        finally:
            _wanting.append(callback)


@contextmanager
def turns_given_to(callback: Callable[[], None]) -> Iterator[None]:
    """Within the block, long computations call ``callback`` again and again.

    They do not within ``callback`` itself.
    """
    _wanting.append(callback)
    try:
        yield
    finally:
        _wanting.remove(callback)
