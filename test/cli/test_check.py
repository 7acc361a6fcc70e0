# SPDX-License-Identifier: Apache-2.0
"""The command ``check``: whether an observer can use a bag."""

import argparse
import json
import re
import sys
from pathlib import Path

import pytest
from faulty_bags import GOOD, STOP, S, write

from impact_observer.cli import check
from impact_observer.cli.main import main
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent
from impact_observer.io import BagReader
from impact_observer.resources import shared

LATER = [ImpactEvent(event.stamp, STOP, event.sequence + 1, 1, S) for event in GOOD]
NOT_FIRST = "the first sequence number is 2: what was before is not here"


pytestmark = pytest.mark.usefixtures("in_tmp_path")


def test_a_valid_bag_has_no_finding(capsys: pytest.CaptureFixture[str]) -> None:
    """The last line says so."""
    write()
    assert main(["check", "bag"]) == 0
    assert capsys.readouterr().out.endswith("\n\nbag: an observer can use it (no findings)\n")


@pytest.mark.parametrize("sample", ["two_mass", "three_mass", "clock_offset", "quantisation"])
def test_sample_bags_have_no_findings(sample: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The bags with sensor faults have no findings, either."""
    assert main(["check", str(shared(f"bags/{sample}"))]) == 0
    assert capsys.readouterr().out.endswith("an observer can use it (no findings)\n")


def test_json_has_every_part_of_a_finding(capsys: pytest.CaptureFixture[str]) -> None:
    """The JSON has the printed line, too."""
    write(LATER[:1])
    assert main(["check", "bag", "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    assert results.pop("content")["messages"] == 9
    assert results == {
        "path": "bag",
        "usable": True,
        "readable": True,
        "topics": {"/impacts": 1, "/plant/joint_states": 7, "/plant/model": 1},
        "findings": [
            {
                "severity": "note",
                "thing": "/impacts",
                "found": NOT_FIRST,
                "wanted": "",
                "remedy": "",
                "line": f"/impacts: {NOT_FIRST}",
            }
        ],
    }


def test_on_a_terminal_lines_are_folded_beside_their_severity(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No word is cut off, and the column below the severity is empty."""
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "50")
    monkeypatch.setenv("TERM", "xterm")
    write(LATER)
    assert main(["check", "bag"]) == 0
    plain = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    assert plain.splitlines()[-3:] == [
        "note  /impacts: the first sequence number is 2:",
        "      what was before is not here",
        "bag: an observer can use it (1 note)",
    ]


def test_wrong_use_is_one_line_and_exit_code_2(capsys: pytest.CaptureFixture[str]) -> None:
    """The cases are no bag, half of --salvage, and an unknown model."""
    write()
    for given, expected in (
        (["nowhere"], "nowhere: does not exist"),
        (["bag", "--salvage"], "bag: --salvage and -o belong together"),
        (["bag", "-o", "new"], "bag: --salvage and -o belong together"),
        (["bag", "--model", "nothing"], "nothing: no such file"),
        (["bag", "--salvage", "-o", "bag"], "bag: exists already"),
    ):
        assert main(["check", *given]) == 2
        (error,) = capsys.readouterr().err.splitlines()
        assert error.startswith(f"impact-observer: {expected}")
    parser = argparse.ArgumentParser()
    check.add_arguments(parser)
    with pytest.raises(UsageError, match="belong together"):
        check.run(parser.parse_args(["bag", "--salvage"]))


@pytest.mark.slow
def test_salvage_prints_the_messages_of_each_topic(capsys: pytest.CaptureFixture[str]) -> None:
    """Counts are printed in words and as figures; the new bag has every message."""
    write()
    Path("bag/metadata.yaml").unlink()
    assert main(["check", "bag", "--salvage", "-o", "new"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "/impacts: 5 messages, up to 6.000000000 s",
        "/plant/joint_states: 7 messages, up to 7.000000000 s",
        "/plant/model: 1 message, up to 1.000000000 s",
        "new: 13 messages; now impact-observer check new",
    ]
    assert main(["check", "bag", "--salvage", "-o", "again", "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    assert results["topics"] == {"/impacts": 5, "/plant/joint_states": 7, "/plant/model": 1}
    assert results["losses"] == []
    with BagReader("new") as reader:
        assert list(reader.events()) == GOOD
