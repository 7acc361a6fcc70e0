# SPDX-License-Identifier: Apache-2.0
"""The command itself: help, errors of one line, exit codes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from systems import jammed

from impact_observer import __version__
from impact_observer.cli.main import COMMANDS, main
from impact_observer.io import BagReader
from impact_observer.io.recordings import model_of

ROOT = Path(__file__).parents[2]


def model_file(folder: Path, old: str, new: str) -> Path:
    """The sample two_mass with a mistake in it."""
    text = (ROOT / "config" / "two_mass.yaml").read_text()
    assert old in text
    path = folder / "broken.yaml"
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize("command", COMMANDS)
def test_every_subcommand_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The help says what the subcommand does, and names its options."""
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    assert "usage: impact-observer" in capsys.readouterr().out


def test_version_is_that_of_the_manifest(capsys: pytest.CaptureFixture[str]) -> None:
    """package.xml and the package agree."""
    with pytest.raises(SystemExit):
        main(["--version"])
    assert __version__ in capsys.readouterr().out
    assert f"<version>{__version__}</version>" in (ROOT / "package.xml").read_text()


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("mass:      [[1, 0], [0, 1]]", "mass: [[1, 0.1], [0, 1]]", "mass: is not symmetric"),
        ("restitution: 0.7", "restitution: -0.7", "contacts[0].restitution: -0.7 found"),
        ("gap: 0.5", "gap: .nan", "contacts[0].gap: nan found"),
        ("gap: 0.5, ", "", "contacts[0].gap: is missing"),
        ("[[20, -10], [-10, 10]]", "[[20, -10]]", "stiffness"),
        ("stiffness:", "stifness:", "stifness: is not known here"),
        ("[[1, 0], [0, 1]]", "[[1.0e+308, 0], [0, 1]]", "mass[0][0]: 1e+308 found"),
        ("[[1, 0], [0, 1]]", "[[1.0e-300, 0], [0, 1.0e-300]]", "mass: is not positive definite"),
        ("[0.1, -0.2]", "[1.0e+20, -0.2]", "initial_state.position[0]: 1e+20 found"),
        ("initial_state:", "provenance:", "initial_state: is missing"),
    ],
)
def test_a_mistake_in_a_model_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, key: str
) -> None:
    """The line names the file and the key; there is no traceback and no bag."""
    path = model_file(tmp_path, old, new)
    bag = tmp_path / "bag"
    assert main(["simulate", str(path), "-o", str(bag)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1
    assert printed.err.startswith(f"impact-observer: {path}: {key}")
    assert not bag.exists()


@pytest.mark.parametrize("value", ["-1e-3", "-.001", "-0.001"])
def test_negative_number_is_accepted_behind_its_option(tmp_path: Path, value: str) -> None:
    """Negative numbers are accepted in any notation."""
    bag = tmp_path / "bag"
    given = ["--clock-offset", value, "--duration", "1", "-o", str(bag)]
    assert main(["simulate", "two_mass", *given]) == 0
    with BagReader(bag) as reader:
        assert model_of(reader).provenance["sensor"] == {"clock_offset": -0.001}


def test_a_demo_checks_its_parameters_before_it_makes_anything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A value outside the nodes' table is one line with exit code 2; no folder is made."""
    pytest.importorskip("rclpy")
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--realtime-factor", "1e9", "-o", "x"]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert "parameter realtime_factor" in errors[0]
    assert not (tmp_path / "x").exists()


def test_impact_without_a_solution_is_one_line_and_exit_code_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line names the time and both stops, which have no play between them."""
    model = tmp_path / "jammed.yaml"
    model.write_text(jammed(0.8, 0.5, velocity=1), encoding="utf-8")
    assert main(["simulate", str(model), "-o", str(tmp_path / "bag")]) == 1
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert "at 1.000000000 s: contacts 'floor', 'ceiling': Newton's impact law" in errors[0]


@pytest.mark.parametrize(("given", "wanted"), [(None, "1"), ("3", "3")])
def test_matrices_have_one_thread_unless_the_environment_has_more(
    monkeypatch: pytest.MonkeyPatch, given: str | None, wanted: str
) -> None:
    """Commands and nodes have equal bits; several threads would wait on a busy machine."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", given or "")
    if given is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    with pytest.raises(SystemExit):
        main(["--version"])
    assert os.environ["OPENBLAS_NUM_THREADS"] == wanted


def test_help_imports_nothing_heavy() -> None:
    """Nor what takes longer, so that help is there at once."""
    code = (
        "import argparse, sys; from impact_observer.cli.main import COMMANDS, main\n"
        "for name in COMMANDS:\n"
        "    try: main([name, '--help'])\n"
        "    except SystemExit: pass\n"
        "print(*sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"numpy", "scipy", "pandas", "matplotlib", "rclpy", "rosbags", "ruamel", "soundfile"}
    assert not heavy & {*done.stderr.split()}
