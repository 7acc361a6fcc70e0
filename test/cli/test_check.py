# SPDX-License-Identifier: Apache-2.0
"""The command ``check``: whether an observer can use a bag."""

import json

import pytest
from faulty_bags import write

from impact_observer.cli.main import main
from impact_observer.resources import shared

NO_TRUTH = "carries no truth (/plant/joint_states)"


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
    write(truth=[])
    assert main(["check", "bag", "--json"]) == 0
    results = json.loads(capsys.readouterr().out)
    assert results.pop("content")["messages"] == 6
    assert results == {
        "path": "bag",
        "usable": True,
        "readable": True,
        "topics": {"/impacts": 5, "/plant/model": 1},
        "findings": [
            {
                "severity": "note",
                "thing": "bag",
                "found": NO_TRUTH,
                "wanted": "",
                "remedy": "observe needs --rate",
                "line": f"bag: {NO_TRUTH}; observe needs --rate",
            }
        ],
    }
