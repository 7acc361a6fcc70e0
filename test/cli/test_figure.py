# SPDX-License-Identifier: Apache-2.0
"""figure: from a model to the picture."""

import json
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from impact_observer.cli.main import main
from impact_observer.draw import pictures
from impact_observer.observer.laws import BUILT_IN
from impact_observer.resources import shared

QUICK = ("--duration", "6", "--rate", "20")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures, in place of files."""
    found: list[Figure] = []

    def keep(figure: Figure, path: Path, *, about: str = "") -> None:
        assert path.name
        assert about
        found.append(figure)

    monkeypatch.setattr(pictures, "save", keep)
    return found


def curves(figure: Figure) -> list[str]:
    """Labels of the curves of V."""
    labels = [str(line.get_label()) for line in figure.axes[0].lines]
    return [label for label in labels if not label.startswith("impacts at")]


def test_the_default_is_the_papers_two_laws(drawn: list[Figure], tmp_path: Path) -> None:
    """Kinematic grey, geometric black; the title names the model and the initial state."""
    assert main(["figure", "two_mass", *QUICK, "-o", str(tmp_path / "v.png")]) == 0
    (figure,) = drawn
    assert curves(figure) == ["kinematic", "geometric"]
    colours = [line.get_color() for line in figure.axes[0].lines[:2]]
    assert colours == ["0.58", "black"]
    (title,) = [text.get_text() for text in figure.texts]
    for word in ("two_mass", "random:1", "our model and numbers", "Baumann and Leine"):
        assert word in title


def test_all_laws_are_one_curve_each(drawn: list[Figure], tmp_path: Path) -> None:
    """Every installed law has a curve; --paper is a column wide, with the title in a caption."""
    output = str(tmp_path / "v.pdf")
    assert main(["figure", "two_mass", "--laws", "all", "--paper", *QUICK, "-o", output]) == 0
    (figure,) = drawn
    assert curves(figure) == list(BUILT_IN)
    assert figure.get_figwidth() < 3.5
    assert not figure.texts


@pytest.mark.parametrize(
    ("ending", "magic"),
    [("png", b"\x89PNG"), ("SVG", b"<?xml"), pytest.param("pdf", b"%PDF", marks=pytest.mark.slow)],
)
def test_the_file_extension_selects_the_format(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], ending: str, magic: bytes
) -> None:
    """An older picture is replaced, and the table is printed."""
    output = tmp_path / f"v.{ending}"
    output.write_bytes(b"an older one")
    assert main(["figure", "bouncing_ball", "--duration", "2", "-o", str(output), "--force"]) == 0
    assert output.read_bytes().startswith(magic)
    assert b"our model and numbers" in output.read_bytes() or ending == "pdf"
    table = capsys.readouterr().out
    assert "V/V0" in table
    assert "kinematic" in table
    assert "bouncing_ball has a rigid-body mode" in table
    assert str(output) in table


@pytest.mark.slow
def test_metrics_in_json_are_those_of_a_simulated_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The commands simulate and compare --laws give the same numbers, to the last bit."""
    output, bag = str(tmp_path / "v.svg"), str(tmp_path / "bag")
    laws = ("--laws", "open-loop,geometric", "--initial", "random:2")
    assert main(["simulate", "two_mass", *QUICK, "-o", bag]) == 0
    capsys.readouterr()
    assert main(["figure", "two_mass", *QUICK, *laws, "-o", output, "--json"]) == 0
    drawn = json.loads(capsys.readouterr().out)
    assert main(["compare", bag, *laws, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == drawn
    assert list(drawn) == ["open-loop", "geometric"]
    assert drawn["geometric"]["V_ratio"] < drawn["open-loop"]["V_ratio"]


def test_what_cannot_be_drawn_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error comes before any simulation."""
    model = tmp_path / "startless.yaml"
    lines = shared("config/two_mass.yaml").read_text("utf-8").splitlines()
    kept = [line for line in lines if not line.startswith("initial_state")]
    model.write_text("\n".join(kept), encoding="utf-8")
    picture = str(tmp_path / "v.png")
    wrong = {
        "initial_state: is missing; a plant needs one": (str(model), "-o", picture),
        "law 'quick': not installed": ("two_mass", "--laws", "quick", "-o", picture),
        "expected a name": ("two_mass", "-o", "v.gif"),
        "make it first": ("two_mass", "-o", str(tmp_path / "no" / "v.png")),
        "initial state 'here'": ("two_mass", "--initial", "here", "-o", picture),
        "laws: none named": ("two_mass", "--laws", "", "-o", picture),
    }
    for said, arguments in wrong.items():
        assert main(["figure", *arguments]) == 2
        errors = capsys.readouterr().err.strip().splitlines()
        assert len(errors) == 1
        assert said in errors[0]
    assert not Path(picture).exists()
