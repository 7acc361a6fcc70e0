# SPDX-License-Identifier: Apache-2.0
"""The picture of a recording."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from plots import recording

from impact_observer.draw.plot.impact_marks import Mark
from impact_observer.draw.plot.picture import MOST_ROWS, mark_rows_of, recording_picture
from impact_observer.draw.plot.quantities import quantities_of
from impact_observer.draw.plot.series import PlotContent, Series
from impact_observer.events import Ruling


def labels(figure: Figure) -> list[str]:
    """The legend's texts."""
    return [each.get_text() for each in figure.legends[0].get_texts()]


def test_a_panel_for_each_quantity_in_two_columns_or_one() -> None:
    """A narrow picture has one column; units are on the axes."""
    wide, narrow = recording_picture(recording()), recording_picture(recording(), width=4.0)
    assert len(wide.axes) == 4 + 1 + 2  # panels, deviations, marks in both columns
    assert len(narrow.axes) == 4 + 1 + 1
    assert wide.axes[0].get_ylabel() == "x0\n[m or rad]"
    assert {axes.get_xlim() for axes in wide.axes} == {(0.0, 2.0)}
    assert narrow.get_figheight() > wide.get_figheight()


def test_range_is_that_of_the_lines_and_not_of_the_bands() -> None:
    """An estimate that is very uncertain at first does not flatten the motion."""
    axes = recording_picture(recording()).axes[0]
    low, high = axes.get_ylim()
    assert -0.5 < low < 0.0
    assert 2.0 < high < 2.5
    (band,) = [each for each in axes.collections if isinstance(each, PolyCollection)]
    assert band.get_paths()[0].get_extents().height == pytest.approx(402.0)


def test_deviations_have_a_panel_with_a_logarithmic_scale() -> None:
    """A line for each quantity, which stays visible where a band does not; zeros are left out."""
    truth, estimate = recording().series
    deviations = np.array(estimate.deviations)
    deviations[:, 0], deviations[0, 1] = np.geomspace(1.0, 1e-9, len(deviations)), 0.0
    content = replace(recording(), series=(truth, replace(estimate, deviations=deviations)))
    (axes,) = (
        each for each in recording_picture(content).axes if "deviation" in each.get_ylabel()
    )
    assert axes.get_yscale() == "log"
    first, second, *others = (np.asarray(each.get_ydata(), float) for each in axes.get_lines())
    np.testing.assert_array_equal(first, deviations[:, 0])
    assert np.flatnonzero(np.isnan(second)).tolist() == [0]
    assert len(others) == len(content.quantities) - 2
    legend = axes.get_legend()
    assert legend is not None
    shown = [each.get_text() for each in legend.get_texts()]
    assert shown == [each.label for each in content.quantities]
    plain = recording_picture(recording(deviation=np.nan))
    assert all(each.get_yscale() == "linear" for each in plain.axes)


def test_legend_has_what_is_drawn_and_nothing_else() -> None:
    """A plot without deviations has no band, a plot without insertions no such mark."""
    drawn = labels(recording_picture(recording()))
    assert drawn == [
        "truth",
        "minimum-variance",
        "± 2 standard deviations",
        "impact, applied",
        "inserted, as missed",
    ]
    plain = recording(deviation=np.nan, marks={Mark("stop"): np.array([1.0])})
    assert labels(recording_picture(plain)) == ["truth", "minimum-variance", "impact"]


def test_truth_with_few_samples_is_dots_as_lines_between_them_would_be_wrong() -> None:
    """The bag has true states at 2 Hz and estimates at 50 Hz."""
    dense = recording()
    line, *_ = recording_picture(dense).axes[0].get_lines()
    assert line.get_linestyle() == "-"
    truth, estimate = dense.series
    few = replace(
        truth,
        seconds=truth.seconds[::4],
        values=truth.values[::4],
        deviations=truth.deviations[::4],
        samples=truth.samples // 4,
    )
    drawn = recording_picture(replace(dense, series=(few, estimate))).axes[0].get_lines()
    assert (drawn[0].get_linestyle(), drawn[0].get_marker()) == ("None", "o")
    assert drawn[1].get_linestyle() != "None"


def test_a_long_way_from_a_wrong_start_is_cut_off_and_said() -> None:
    """Values with a wide band are cut off, or a twentieth without bands; the truth is inside."""
    t = np.linspace(0.0, 10.0, 101)[:, None]
    motion, wrong = np.cos(7 * t), 50 * np.exp(-4 * t)
    quantities = tuple(quantities_of(["x"], None).values())[:1]

    def axes_of(estimate: np.ndarray, deviation: np.ndarray, *, truth: bool = True) -> Axes:
        none = np.full(t.shape, np.nan)
        drawn = [Series("truth", "", t, motion, none, 101)] if truth else []
        drawn.append(Series("law", "law", t, estimate, deviation, 101))
        content = PlotContent("rig", quantities, tuple(drawn), {}, 0.0, 10.0)
        return recording_picture(content).axes[0]

    none = np.full(t.shape, np.nan)
    known = [axes_of(motion + wrong, wrong, truth=each) for each in (True, False)]
    for axes in (*known, axes_of(motion + wrong, none)):
        low, high = axes.get_ylim()
        assert -1.6 < low < -1
        assert 1 < high < 8
        (said,) = [each.get_text() for each in axes.texts]
        assert said.startswith("cut off: -")
        assert said.endswith(" to 51")
    for truth in (False, True):
        axes = axes_of(motion if truth else motion + wrong, none, truth=truth)
        assert [*axes.texts] == []
        assert axes.get_ylim()[1] > np.max(motion if truth else motion + wrong)


def test_many_rows_of_marks_become_one_an_estimate() -> None:
    """Estimates that decided differently keep a row of their own."""
    marks = {
        Mark(f"stop{i}", law, Ruling.APPLIED): np.array([float(i)])
        for i in range(MOST_ROWS)
        for law in ("a", "b")
    }
    rows = mark_rows_of(recording(marks=marks))
    assert list(rows) == ["impacts, a", "impacts, b"]
    assert rows["impacts, a"][Ruling.APPLIED].tolist() == list(map(float, range(MOST_ROWS)))


def test_long_names_of_rows_leave_a_narrow_picture_its_width() -> None:
    """A narrow picture has names above the marks, a wide one beside the marks."""
    marks = {Mark("stop", f"a long name of estimate {k}"): np.array([1.0]) for k in range(2)}
    for width, least, short in ((2.0, 0.5, True), (3.5, 0.7, False)):
        figure = recording_picture(recording(marks=marks), width=width)
        figure.draw_without_rendering()
        assert all(axes.get_position().width > least for axes in figure.axes)
        assert [each.get_text() for each in figure.axes[-1].texts] == list(
            mark_rows_of(recording(marks=marks))
        )
        assert (figure.axes[4].get_xlabel() == "time [s]") == short
    assert not recording_picture(recording(marks=marks)).axes[-1].texts


def test_what_is_left_out_is_said() -> None:
    """The picture says how many coordinates are left out."""
    drawn = recording_picture(recording(left_out=12))
    assert "12 coordinates" in drawn.get_supxlabel()
