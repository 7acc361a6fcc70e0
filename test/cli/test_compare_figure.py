# SPDX-License-Identifier: Apache-2.0
"""compare --figure: from a model to the picture of V over time."""

import json
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from impact_observer.cli.main import main
from impact_observer.draw import pictures
from impact_observer.observer.laws import BUILT_IN

QUICK = ("--figure", "two_mass", "--duration", "3")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures, in place of files."""
    found: list[Figure] = []
    monkeypatch.setattr(pictures, "save", lambda figure, _path: found.append(figure))
    return found


def curves(figure: Figure) -> list[str]:
    """Labels of the curves of V."""
    labels = [str(line.get_label()) for line in figure.axes[0].lines]
    return [label for label in labels if not label.startswith("impacts at")]


def test_the_default_is_the_papers_two_laws(
    drawn: list[Figure], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Kinematic grey, geometric black; the tables are printed, too."""
    assert main(["compare", *QUICK, "--plot", str(tmp_path / "v.png")]) == 0
    (figure,) = drawn
    assert curves(figure) == ["kinematic", "geometric"]
    colours = [line.get_color() for line in figure.axes[0].lines[:2]]
    assert colours == ["0.58", "black"]
    (title,) = [text.get_text() for text in figure.texts]
    assert "two_mass" in title
    assert "V/V0" in capsys.readouterr().out


def test_all_laws_are_one_curve_each(drawn: list[Figure], tmp_path: Path) -> None:
    """Every installed law of linear models has a curve."""
    plot = ("--laws", "all", "--plot", str(tmp_path / "v.pdf"))
    assert main(["compare", *QUICK, *plot]) == 0
    (figure,) = drawn
    assert curves(figure) == list(BUILT_IN)


@pytest.mark.slow
def test_metrics_are_those_of_a_simulated_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The commands simulate and compare --laws give the same numbers, to the last bit."""
    bag = str(tmp_path / "bag")
    laws = ("--laws", "open-loop,geometric", "--initial-state", "random:2", "--json")
    assert main(["simulate", "two_mass", "--duration", "3", "-o", bag]) == 0
    capsys.readouterr()
    assert main(["compare", *QUICK, *laws]) == 0
    figure = json.loads(capsys.readouterr().out)
    assert main(["compare", bag, *laws]) == 0
    assert json.loads(capsys.readouterr().out) == figure
    assert list(figure) == ["open-loop", "geometric"]
    assert figure["geometric"]["V_ratio"] < figure["open-loop"]["V_ratio"]
