# SPDX-License-Identifier: Apache-2.0
"""The picture of a sweep: units, laws, runs that never settle."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from impact_observer.draw.pictures import save
from impact_observer.errors import UsageError
from impact_observer.model import read_model
from impact_observer.sweep.case_runs import Outcome
from impact_observer.sweep.model_variants import model_variants
from impact_observer.sweep.plan import PlantSetup, Sweep, sensors_of
from impact_observer.sweep.summary import groups_of
from impact_observer.sweep.summary_picture import against_of, sweep_picture

LAWS = ("geometric", "unilateral")


def swept(
    faults: Mapping[str, Sequence[float | bool]], off: Mapping[str, Sequence[float]]
) -> Sweep:
    """A sweep of two masses with two runs of two laws."""
    model = read_model("two_mass")
    return Sweep(
        PlantSetup(model.text()), LAWS, sensors_of(faults), model_variants(model, off), runs=2
    )


def drawn(sweep: Sweep, times: Sequence[float | None], against: str | None = None) -> Figure:
    """Picture of a sweep whose cases settle at ``times`` in turn."""
    outcomes = [
        Outcome(k, settling_time=times[k % len(times)], V_ratio=0.1) for k in range(sweep.size)
    ]
    return sweep_picture(sweep, groups_of(sweep, outcomes), against=against)


@pytest.mark.slow
def test_each_law_is_a_line_with_a_band_over_what_was_swept(tmp_path: Path) -> None:
    """Points are in the order of the swept values, not of their input; axes have units."""
    sweep = swept({"jitter": [1e-2, 0.0, 1e-4]}, {})
    figure = drawn(sweep, [1.0, 3.0, 2.0, 4.0, 5.0, 7.0])
    upper, lower = figure.axes
    assert lower.get_xlabel() == "jitter [s]"
    assert upper.get_ylabel() == "settling time (V < 0.01 V0) [s]"
    assert lower.get_ylabel() == "not settled [%]"
    assert [line.get_label() for line in upper.lines] == [*LAWS]
    for line in upper.lines:
        assert np.asarray(line.get_xdata()).tolist() == [0.0, 1e-4, 1e-2]
        assert np.asarray(line.get_ydata()).tolist() == [3.0, 6.0, 2.0]
    looks = {(line.get_linestyle(), line.get_marker()) for line in upper.lines}
    assert len(looks) == len(LAWS)
    assert len(upper.collections) == len(LAWS)
    assert lower.get_xscale() == "symlog"
    save(figure, tmp_path / "sweep.png")
    assert (tmp_path / "sweep.png").stat().st_size > 0


def test_runs_that_never_settle_are_above_all_times() -> None:
    """Unsettled runs have a zone of their own above, and a share below."""
    upper, lower = drawn(swept({"missed": [0.0, 0.2]}, {}), [2.0, 4.0, None, None]).axes
    words = [label.get_text() for label in upper.get_yticklabels()]
    assert words[-1] == "never"
    for line in upper.lines:
        settled, never = np.asarray(line.get_ydata())
        assert settled == 3.0
        assert never == upper.get_yticks()[-1] > 4.0
    for line in lower.lines:
        np.testing.assert_array_equal(line.get_ydata(), [0.0, 100.0])
    words = [label.get_text() for label in drawn(swept({}, {}), [2.0]).axes[0].get_yticklabels()]
    assert "never" not in words


@pytest.mark.slow
def test_other_quantities_make_panels() -> None:
    """Each combination has a panel; --against selects the quantity on the axis."""
    sweep = swept({"dead_time": [0.0, 0.1]}, {"gap": [0.4, 0.5, 0.6]})
    figure = drawn(sweep, [1.0])
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert titles == [f"observer's gap {value} m" for value in ("0.4", "0.5", "0.6")]
    figure = drawn(sweep, [1.0], "gap")
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert titles == ["dead time 0 s", "dead time 0.1 s"]
    assert figure.axes[-1].get_xlabel() == "observer's gap [m]"
    assert against_of(sweep, "dead-time") == "sensor_dead_time"
    figure = drawn(sweep, [1.0], "law")
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert len(titles) == 6
    assert titles[0] == "dead time 0 s, observer's gap 0.4 m"


def test_without_anything_swept_laws_are_side_by_side() -> None:
    """A point each, with the quartiles."""
    upper, lower = drawn(swept({}, {}), [1.0, 3.0]).axes
    assert [label.get_text() for label in lower.get_xticklabels()] == [*LAWS]
    assert [float(np.asarray(line.get_ydata())[0]) for line in upper.lines] == [2.0, 2.0]


def test_a_fault_that_is_there_or_not_has_words_on_its_axis() -> None:
    """The words of the axis are no and yes."""
    lower = drawn(swept({"impacts_only": [False, True]}, {}), [1.0]).axes[1]
    assert [label.get_text() for label in lower.get_xticklabels()] == ["no", "yes"]


def test_an_axis_that_is_not_swept_is_refused() -> None:
    """Too many panels are refused, too."""
    sweep = swept({"jitter": [0.0, 1e-3], "missed": [0.1]}, {})
    with pytest.raises(UsageError, match=r"--against missed: has not several values.*jitter"):
        against_of(sweep, "missed")
    crowded = swept({"jitter": [0.0, 1e-3]}, {"gap": [0.3 + 0.05 * k for k in range(7)]})
    with pytest.raises(UsageError, match="7 combinations"):
        against_of(crowded, None)
    assert against_of(crowded, "gap") == "off_gap"
