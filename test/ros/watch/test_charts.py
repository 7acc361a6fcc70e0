# SPDX-License-Identifier: Apache-2.0
"""Charts of block characters."""

import pytest

from impact_observer.ros.watch.charts import ASCII_BLOCKS, BLOCKS, bars, decades, from_first


def test_a_chart_spans_whole_decades() -> None:
    """At least one; zeros and what is not from_first do not count."""
    assert decades([None, 3.0, 0.02, 0.0]) == (-2, 1)
    assert decades([5.0]) == (0, 1)
    assert decades([1.0]) == (0, 1)
    assert decades([1e-3, 1e-3]) == (-3, -2)
    assert decades([]) == decades([None, 0.0, -1.0]) == (0, 1)


def test_equal_ratios_are_equal_heights() -> None:
    """One row has eight levels over the decades; the least one is seen too."""
    assert bars([1.0, 10.0, 100.0], 3) == ["▁▄█"]
    eight = [10.0**k for k in range(9)]
    assert bars(eight, 9) == ["▁▁▂▃▄▅▆▇█"]


def test_rows_are_filled_from_below() -> None:
    """Two rows have sixteen levels."""
    assert bars([1.0, 10.0, 100.0], 3, 2) == ["  █", "▁██"]
    assert bars([1.0, 10.0**1.5, 100.0], 3, 2) == [" ▄█", "▁██"]


def test_values_are_stretched_or_the_last_of_each_column_is_drawn() -> None:
    """Whatever their number; the newest is always at the right end."""
    assert bars([1.0, 100.0], 6) == ["▁▁▁███"]
    many = [1.0] * 50 + [100.0] * 49 + [10.0]
    assert bars(many, 4) == ["▁▁█▄"]


@pytest.mark.parametrize("rows", [1, 3])
def test_what_is_not_known_is_blank_and_zero_is_the_least(rows: int) -> None:
    """V of a perfect estimate has no logarithm; it is there all the same."""
    lowest = bars([None, 0.0, 1.0, 10.0], 4, rows)[-1]
    assert lowest[:2] == " ▁"
    assert bars([], 5, rows) == ["     "] * rows
    assert bars([None, None], 2, rows) == ["  "] * rows


def test_charts_are_for_terminals_without_blocks_too() -> None:
    """As many characters from empty to full."""
    assert bars([1.0, 10.0, 100.0], 3, levels=ASCII_BLOCKS) == [".=@"]
    assert len(ASCII_BLOCKS) == len(BLOCKS) == 9
    assert ASCII_BLOCKS.isascii()


def test_a_chart_begins_with_the_first_known_value() -> None:
    """So that a young one is not drawn at the edge."""
    assert from_first([None, None, 1.0, None, 2.0]) == [1.0, None, 2.0]
    assert list(from_first([None])) == []
