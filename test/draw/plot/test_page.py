# SPDX-License-Identifier: Apache-2.0
"""The page of a recording."""

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plots import SECONDS, recording

from impact_observer.draw.plot.impact_marks import Mark
from impact_observer.draw.plot.page import check_plotly, page_figure, write_page
from impact_observer.draw.plot.series import Dots, PlotContent
from impact_observer.errors import UsageError

pytest.importorskip("plotly")


def traces(content: PlotContent, row: int) -> list[Any]:
    """The traces of a row of the page, from the top: 1 has the marks, 2 the first quantity."""
    axis = "x" if row == 1 else f"x{row}"
    return [each for each in page_figure(content).data if each.xaxis == axis]


def test_page_has_the_numbers_of_each_quantity() -> None:
    """The page has truth, estimate, and the estimate's band of two deviations on either side."""
    content = recording(deviation=0.25)
    band, truth, estimate = traces(content, 3)
    assert (truth.name, estimate.name) == ("truth", "minimum-variance")
    for curve in (truth, estimate):
        np.testing.assert_array_equal(curve.x, SECONDS)
        np.testing.assert_array_equal(curve.y, SECONDS)
    np.testing.assert_array_equal(np.asarray(band.y)[:21], SECONDS + 0.5)
    np.testing.assert_array_equal(np.asarray(band.y)[:20:-1], SECONDS - 0.5)
    assert len(traces(recording(deviation=np.nan), 3)) == 2
    titles = [axis.title.text for axis in page_figure(content).select_yaxes()]
    assert titles[1:] == [each.label for each in content.quantities]


def test_impacts_are_in_rows_by_their_verdict() -> None:
    """Each contact has a row; each verdict is once in the legend."""
    marks = {**recording().marks, Mark("wall", "minimum-variance"): np.array([0.75])}
    applied, inserted, reported = traces(recording(marks=marks), 1)
    assert (applied.name, inserted.name) == ("impact, applied", "inserted, as missed")
    assert (list(applied.x), list(inserted.x)) == ([0.5, 1.0], [1.5])
    assert [set(each.y) for each in (applied, inserted, reported)] == [{0}, {0}, {1}]
    axis = page_figure(recording(marks=marks)).layout.yaxis
    assert axis.ticktext == ("stop", "wall")


def test_page_has_the_samples_of_sensors_as_dots() -> None:
    """Dots are in the panel of the measured quantity, the sensor's name in the legend."""
    name = recording().quantities[1].name
    samples = Dots("encoder", np.array([0.5, 1.0]), np.array([0.25, -3.0]))
    content = recording(dots={name: (samples,)})
    assert [len(traces(content, row)) for row in (2, 3, 4, 5)] == [3, 4, 3, 3]
    *_, dots = traces(content, 3)
    assert (dots.name, dots.mode) == ("samples: encoder", "markers")
    assert (list(dots.x), list(dots.y)) == ([0.5, 1.0], [0.25, -3.0])


def test_page_needs_no_network(tmp_path: Path) -> None:
    """The script is in the page, and no tag names another file; an interrupted page is no file."""
    write_page(recording(left_out=3), tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "plotly.js v" in text
    assert not re.search(r"<(script|link|img|iframe)[^>]*\b(src|href)=", text)
    assert "3 coordinates that move less are not drawn" in text
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


def test_names_cannot_end_the_script_of_the_page(tmp_path: Path) -> None:
    """A bag of a stranger may have any names."""
    marks = {Mark("</script><script>alert(1)//<b>"): np.array([1.0])}
    write_page(recording(marks=marks), tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert "<title>rig &lt;1&gt;</title>" in text


def test_page_without_plotly_names_the_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line names the formats that need no further package."""
    monkeypatch.setitem(sys.modules, "plotly", None)
    with pytest.raises(UsageError, match=r"pip install plotly, or write a \.png, \.svg or \.pdf"):
        check_plotly(tmp_path / "page.html")
