# SPDX-License-Identifier: Apache-2.0
"""The command ``urdf``."""

from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from systems import chain

from impact_observer.cli.main import main
from impact_observer.draw.scene.scene import Scene
from impact_observer.draw.urdf_text import urdf_text
from impact_observer.model import read_model


def test_the_model_is_printed_with_its_initial_state(capsys: pytest.CaptureFixture[str]) -> None:
    """The scene has room for it."""
    assert main(["urdf", "two_mass"]) == 0
    model = read_model("two_mass")
    scene = Scene.of_system(model.system, [model.initial_state()[0]])
    assert capsys.readouterr().out == urdf_text(scene)


def test_file_is_written_and_what_is_left_out_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Omissions are on standard error, so that the URDF can be piped."""
    model = chain(30)
    lines = [f"bodies: [{', '.join(f'{{name: {c}, mass: 1}}' for c in model.coordinates)}]"]
    path = tmp_path / "long.yaml"
    path.write_text("\n".join(["name: long", *lines]), encoding="utf-8")
    output = tmp_path / "long.urdf"
    assert main(["urdf", str(path), "-o", str(output)]) == 0
    assert "the first 24 of 30 bodies" in capsys.readouterr().err
    assert len(ET.parse(output).getroot().findall("joint")) == 24


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["two_mass", "--frame", "x1"], "frame 'x1': a coordinate has this name"),
        (["two_mass", "-o", "no/such/folder/x.urdf"], "no folder no/such/folder; make it first"),
        (["two_masses"], "two_masses"),
        (["two_mass", "--amplitude", "1e300"], "--amplitude 1e+300: expected at most 1e+06"),
        (["two_mass", "--row", "9" * 12], "--row 1e+12: expected at most 1000"),
    ],
)
def test_what_cannot_be_described_is_one_line(
    arguments: list[str], problem: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The exit code is 2."""
    assert main(["urdf", *arguments]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert problem in line
