# SPDX-License-Identifier: Apache-2.0
"""Bags as other recorders make them: every command takes each."""

import json
from pathlib import Path

import pytest
from foreign_bags import FORMS

from impact_observer.cli.main import main
from impact_observer.io import BagReader


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of two_mass over four seconds, with impacts, truth and model."""
    path = tmp_path_factory.mktemp("recording") / "own"
    given = ["--duration", "4", "--rate", "10", "-o", str(path)]
    assert main(["simulate", "two_mass", *given]) == 0
    return path


@pytest.fixture(scope="module")
def observed(recording: Path) -> list[bytes]:
    """The estimates on the bag as this package wrote it."""
    return estimates(recording, recording.parent / "observed")


def estimates(bag: Path, output: Path) -> list[bytes]:
    """The messages that ``observe`` makes of a bag."""
    assert main(["observe", str(bag), "--ensemble", "1", "-o", str(output)]) == 0
    with BagReader(output) as reader:
        return [raw.data for raw in reader.raw(["/observer/state"])]


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_every_command_takes_every_form(
    recording: Path,
    observed: list[bytes],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    form: str,
) -> None:
    """Estimates are equal to the last bit, counts and times are equal, and there is no warning."""
    bag = FORMS[form](recording, tmp_path / form)
    results = []
    for each in (recording, bag):
        assert main(["check", str(each), "--json"]) == 0
        results.append(json.loads(capsys.readouterr().out))
    assert results[1]["findings"] == []
    results = [each["content"] for each in results]
    for key in ("start", "end", "messages", "impacts", "episodes", "model"):
        assert results[0][key] == results[1][key], key
    assert results[1]["storage"] == ("mcap" if "mcap" in form else "sqlite3")
    assert estimates(bag, tmp_path / "observed") == observed
