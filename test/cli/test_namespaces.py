# SPDX-License-Identifier: Apache-2.0
"""Commands on a bag with two rigs, selected by ``--namespace``."""

import json
import re
from pathlib import Path

import pytest

pytest.importorskip("rosbags")

from impact_observer.cli.main import main
from impact_observer.io.reader import BagReader
from impact_observer.io.writer import BagWriter

pytestmark = pytest.mark.slow
CHECK = ("--check", "--clock-error", "1e-3")


@pytest.fixture(scope="module")
def rigs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of two plants and their observers, in the namespaces of their models."""
    folder = tmp_path_factory.mktemp("rigs")
    with BagWriter(folder / "rigs") as writer:
        for model in ("two_mass", "three_mass"):
            plant, estimates = str(folder / f"{model}_plant"), str(folder / model)
            simulated = ["simulate", model, "--duration", "4", "--rate", "50", "-o", plant]
            assert main(simulated) == 0
            observed = ["observe", plant, "--ensemble", "1", "--initial-state", "random:1"]
            assert main([*observed, "-o", estimates]) == 0
            with BagReader(estimates) as reader:
                for topic, info in reader.topics.items():
                    name = f"/{model}{topic}"
                    writer.declare(name, type_name=info.type, quality=info.quality)
                for message in reader.raw():
                    writer.write_raw(f"/{model}{message.topic}", message.log_time, message.data)
    return folder / "rigs"


@pytest.mark.parametrize("namespace", ["three_mass", "/three_mass", "/three_mass/"])
def test_a_namespace_selects_a_rig(
    rigs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], namespace: str
) -> None:
    """The figures are those of a bag of that rig alone; a new observer can be run on it."""
    capsys.readouterr()
    assert main(["compare", str(rigs.parent / "three_mass"), "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)
    assert main(["compare", str(rigs), "--namespace", namespace, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == alone
    arguments = ["--namespace", namespace, "--ensemble", "1", "--initial-state", "random:1"]
    assert main(["observe", str(rigs), *arguments, "-o", str(tmp_path / "new")]) == 0
    capsys.readouterr()
    assert main(["compare", str(tmp_path / "new"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == alone


def test_identify_takes_model_and_impacts_of_the_selected_rig(
    rigs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The result for so short a bag is that for the rig alone."""
    for model, said in (("two_mass", "for 4 unknowns"), ("three_mass", "for 6 unknowns")):
        capsys.readouterr()
        assert main(["identify", str(rigs.parent / model), *CHECK]) == 1
        alone = capsys.readouterr().err
        assert said in alone
        assert main(["identify", str(rigs), *CHECK, "--namespace", model]) == 1
        assert capsys.readouterr().err == alone
    assert main(["identify", str(rigs), *CHECK]) == 2
    assert "name the one meant with --namespace" in capsys.readouterr().err


def test_without_a_namespace_the_error_names_the_option(
    rigs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An unknown namespace is an error, too."""
    for arguments, said in (
        ([], r"both fit /plant/model; name the one meant with --namespace\n"),
        (["--namespace", "x"], r"no topic in /x; in the bag: /three_mass/impacts, "),
    ):
        assert main(["compare", str(rigs), *arguments]) in {1, 2}
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert re.search(said, error), error


def test_check_lists_both_rigs(rigs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They are two rigs, of which an observer needs one."""
    assert main(["check", str(rigs)]) == 1
    out = capsys.readouterr().out
    assert "/two_mass/observer: geometric" in out
    assert "/three_mass/observer: geometric" in out
    assert "/three_mass/plant/model and /two_mass/plant/model" in out
