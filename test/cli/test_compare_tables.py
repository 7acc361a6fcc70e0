# SPDX-License-Identifier: Apache-2.0
"""The text that ``compare`` prints: names literally, warnings, and remarks on V."""

import shutil
from pathlib import Path

import pytest

pytest.importorskip("rosbags")

from impact_observer.cli.main import main
from impact_observer.resources import shared


@pytest.fixture(scope="module")
def observed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with three seconds of a plant and an estimate."""
    folder = tmp_path_factory.mktemp("tables")
    plant, estimates = folder / "plant", folder / "estimates"
    assert main(["simulate", "two_mass", "--duration", "3", "-o", str(plant)]) == 0
    assert main(["observe", str(plant), "--initial-state", "random:1", "-o", str(estimates)]) == 0
    return estimates


def test_names_of_bags_are_printed_literally(
    observed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Brackets and colons in names are no markup."""
    names = ["[red]first", ":smile: second"]
    bags = [shutil.copytree(observed, tmp_path / name) for name in names]
    capsys.readouterr()
    assert main(["compare", *map(str, bags)]) == 0
    said = capsys.readouterr().out
    assert "geometric [red]first" in said
    assert "geometric :smile: second" in said


def test_impacts_of_a_contact_that_is_not_the_models_are_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The warning is that of check: a law cannot use such impacts."""
    words = ["simulate", "three_mass", "--duration", "3", "-o", str(tmp_path / "plant")]
    assert main(words) == 0
    other = shared("config").joinpath("three_mass.yaml").read_text(encoding="utf-8")
    model = tmp_path / "other.yaml"
    model.write_text(other.replace("left", "port"), encoding="utf-8")
    capsys.readouterr()
    given = ["--laws", "geometric", "--model", str(model)]
    assert main(["compare", str(tmp_path / "plant"), *given]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "left has impacts, and three_mass no such contact" in said


def test_distances_that_are_rounding_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An observer that starts from the truth, and one that does not."""
    plant = str(tmp_path / "plant")
    assert main(["simulate", "bouncing_ball", "--duration", "0.3", "-o", plant]) == 0
    for start, is_named in (("1,1e-16", True), ("1,0.1", False)):
        bag = str(tmp_path / start)
        assert main(["observe", plant, "--epoch", "1", "--initial-state", start, "-o", bag]) == 0
        capsys.readouterr()
        assert main(["compare", bag]) == 0
        assert ("V end of geometric is rounding" in capsys.readouterr().out) is is_named
