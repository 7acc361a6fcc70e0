# SPDX-License-Identifier: Apache-2.0
"""Commands on a bag with two rigs."""

from pathlib import Path

import pytest

pytest.importorskip("rosbags")

from impact_observer.cli.main import main
from impact_observer.io.reader import BagReader
from impact_observer.io.writer import BagWriter

pytestmark = pytest.mark.slow


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


@pytest.mark.parametrize("words", [["compare"], ["identify", "--free", "gap"]])
def test_a_command_needs_a_bag_of_one_rig(
    rigs: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """The error names the topics of both."""
    capsys.readouterr()
    assert main([*words, str(rigs)]) == 2
    error = capsys.readouterr().err
    assert "/two_mass/plant/model both fit /plant/model; expected a bag of the topics" in error
    assert error.count("\n") == 1


def test_check_lists_both_rigs(rigs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They are two rigs, of which an observer needs one."""
    assert main(["check", str(rigs)]) == 1
    out = capsys.readouterr().out
    assert "/two_mass/observer: geometric" in out
    assert "/three_mass/observer: geometric" in out
    assert "/three_mass/plant/model and /two_mass/plant/model" in out
