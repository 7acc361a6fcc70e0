# SPDX-License-Identifier: Apache-2.0
"""Charts of block characters: readable without colours; `rich` has none."""

import math
from collections.abc import Sequence

BLOCKS = " ▁▂▃▄▅▆▇█"
ASCII_BLOCKS = " .:-=+*#@"
"""The same for terminals that print ASCII only."""


def from_first(values: Sequence[float | None]) -> Sequence[float | None]:
    """``values`` from the first on that is not None."""
    first = next((i for i, value in enumerate(values) if value is not None), len(values))
    return values[first:]


def decades(values: Sequence[float | None]) -> tuple[int, int]:
    """The powers of ten below and above the positive ``values``, at least one decade."""
    logarithms = [math.log10(value) for value in values if value is not None and value > 0]
    if not logarithms:
        return 0, 1
    low = math.floor(min(logarithms))
    return low, max(math.ceil(max(logarithms)), low + 1)


def bars(
    values: Sequence[float | None], width: int, rows: int = 1, *, levels: str = BLOCKS
) -> list[str]:
    """A chart of positive values on a logarithmic scale, filled from below.

    Args:
        values: in time; None stays blank. What is not positive is drawn as the least.
        width: columns; values are stretched over them, or the last in each column is drawn.
        rows: height.
        levels: characters from empty to full.

    Returns:
        ``rows`` texts of ``width`` characters, the highest first.
    """
    if not values:
        return [" " * width] * rows
    low, high = decades(values)
    steps = len(levels) - 1
    heights = []
    for column in range(width):
        start = column * len(values) // width
        stop = max((column + 1) * len(values) // width, start + 1)
        there = [value for value in values[start:stop] if value is not None]
        if not there:
            heights.append(0)
            continue
        value = max(there[-1], 10.0**low)
        part = (math.log10(value) - low) / (high - low)
        heights.append(max(round(part * rows * steps), 1))
    return [
        "".join(levels[min(max(height - row * steps, 0), steps)] for height in heights)
        for row in reversed(range(rows))
    ]
