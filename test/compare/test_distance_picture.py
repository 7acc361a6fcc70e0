# SPDX-License-Identifier: Apache-2.0
"""Pictures: laws distinct in grey, nothing covered, exact estimates left blank."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from systems import sample

from impact_observer.compare.comparison import Comparison, compare_states
from impact_observer.compare.distance_picture import lyapunov_picture
from impact_observer.draw.pictures import STYLES, Style, styles
from impact_observer.io.bag_part import TimeZero
from impact_observer.io.pairing import samples_of
from impact_observer.observer.event_outcomes import outcomes_of
from impact_observer.stamps import NS_PER_S, grid

STAMPS = grid(NS_PER_S, 31 * NS_PER_S, 20.0)


def fading(law: str, decades: float) -> Comparison:
    """A comparison whose V falls from 1 J by ``decades``."""
    error = np.zeros((STAMPS.size, 4))
    error[:, 2] = np.sqrt(2.0 * 10.0 ** -np.linspace(0.0, decades, STAMPS.size))  # M = 1 kg
    truth, estimates = samples_of(STAMPS, np.zeros_like(error)), samples_of(STAMPS, error)
    return compare_states(sample("two_mass").system, law, truth, estimates, outcomes_of((), ()))


def picture(laws: dict[str, float], *, contacts: int = 2) -> Figure:
    """A picture of curves that fall by so many decades, drawn once so that all has its place."""
    figure = lyapunov_picture(
        {law: fading(law, decades) for law, decades in laws.items()},
        {f"stop {i}": STAMPS[3 :: 40 + i] for i in range(contacts)},
        title="one line\nand another",
        zero=TimeZero(NS_PER_S),
    )
    figure.draw_without_rendering()
    return figure


FIVE = {"open-loop": 0.0, "kinematic": 4.0, "geometric": 5.0, "unilateral": 6.0}
FIVE["minimum-variance"] = 20.0


def luminance(style: Style) -> float:
    """Brightness of a curve on grey paper, 0 to 1 (ITU-R BT.601)."""
    return float(np.dot(to_rgb(style["color"]), [0.299, 0.587, 0.114]))


def test_laws_are_distinct_in_grey() -> None:
    """Two laws differ in dashes or in markers, or in brightness and width."""
    for (one, first), (two, second) in combinations(STYLES.items(), 2):
        dashed = first["linestyle"] != second["linestyle"]
        marked = first.get("marker") != second.get("marker")
        bright = abs(luminance(first) - luminance(second)) > 0.4
        wide = abs(first["linewidth"] - second["linewidth"]) > 0.5
        assert dashed or marked or (bright and wide), f"{one} and {two} look alike"


def test_a_law_that_comes_again_gets_other_markers() -> None:
    """Two bags observed with one law are two curves; two laws of other packages are two curves."""
    found = styles(["geometric", "geometric", "geometric", "mine", "yours", "mine"])
    looks = [(each["color"], str(each["linestyle"]), each.get("marker")) for each in found]
    assert len(set(looks)) == len(looks)
    assert found[0] == styles(["geometric"])[0]


def test_exact_estimates_leave_a_gap() -> None:
    """Zero, which has no logarithm, gives neither a warning nor a line down to nowhere."""
    exact = fading("geometric", 3.0)
    exact.V[200:300] = 0.0
    figure = lyapunov_picture({"geometric": exact}, {}, title="", zero=TimeZero(NS_PER_S))
    drawn = np.asarray(figure.axes[0].lines[0].get_ydata(), dtype=float)
    assert np.flatnonzero(np.isnan(drawn)).tolist() == list(range(200, 300))
    figure.draw_without_rendering()
    low, _ = figure.axes[0].get_ylim()
    assert low > 1e-4


@pytest.mark.slow
def test_very_many_contacts_share_one_row() -> None:
    """Separate rows and legends would leave no room for the curves."""
    few, many = picture({"geometric": 3.0}, contacts=8), picture({"geometric": 3.0}, contacts=30)
    assert len(few.axes[0].lines) == 1 + 8
    assert len(many.axes[0].lines) == 1 + 1
    marks = many.axes[0].lines[1]
    assert marks.get_label() == "impacts at 30 contacts"
    assert np.size(marks.get_xdata()) == sum(STAMPS[3 :: 40 + i].size for i in range(30))


@pytest.mark.parametrize(
    "letters", [*(pytest.param(each, marks=pytest.mark.slow) for each in (30, 60)), 300]
)
def test_long_names_leave_the_curves_their_room(letters: int) -> None:
    """Names of bags go into fewer columns, and lose their middle before the axes get narrow."""
    name = ("recording_of_some_machine_" * 12)[:letters]
    named = {f"geometric {name}{i}": float(i) for i in range(3)}
    figure = picture(named)
    assert figure.axes[0].get_window_extent().width > 0.7 * figure.bbox.width
    shown = figure.axes[0].get_legend_handles_labels()[1]
    assert [label[-1] for label in shown[:3]] == ["0", "1", "2"]
    assert all(label.startswith("geometric recording") for label in shown[:3])
