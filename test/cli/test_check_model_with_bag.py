# SPDX-License-Identifier: Apache-2.0
"""The command ``check-model MODEL BAG``: which part of the state the impacts determine."""

import json
from pathlib import Path
from typing import Any

import pytest

from impact_observer.cli.main import main
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import BagWriter
from impact_observer.io.messages import bag_messages
from impact_observer.resources import shared

TWO_MASS = shared("bags/two_mass")
DECOUPLED = """
name: decoupled
bodies: [{name: x1, mass: 1}, {name: x2, mass: 1}]
springs: [{between: [ground, x1], stiffness: 10}, {between: [ground, x2], stiffness: 7}]
stops: [{name: stop, body: x1, limit: 0.3, side: above, restitution: 0.7}]
"""


def printed(capsys: pytest.CaptureFixture[str], model: str, bag: Path, *words: str) -> str:
    """Output of the command without line ends."""
    capsys.readouterr()
    assert main(["check-model", model, str(bag), *words]) == 0
    return " ".join(capsys.readouterr().out.split())


def impacts(capsys: pytest.CaptureFixture[str], model: str, *words: str) -> dict[str, Any]:
    """What the impacts of the bag two_mass determine, by the JSON."""
    found = json.loads(printed(capsys, model, TWO_MASS, "--json", *words))
    return dict(found["impacts"])


def bag_of(path: Path, *events: ImpactEvent) -> Path:
    """A bag with nothing but events."""
    make = bag_messages()
    with BagWriter(path) as writer:
        for each in events:
            writer.write("/impacts", each.stamp, make.event(each))
    return path


def impact(stamp: int, *contacts: str, episode: int = 0) -> ImpactEvent:
    """An impact ``stamp`` tenths of a second after the epoch, 1 s."""
    epoch, switches = 1_000_000_000, tuple(Switch(contact) for contact in contacts)
    return ImpactEvent(epoch + stamp * 100_000_000, switches, stamp, episode, epoch)


@pytest.fixture
def decoupled(tmp_path: Path) -> str:
    """A model with a mass that no contact sees."""
    (tmp_path / "decoupled.yaml").write_text(DECOUPLED)
    return str(tmp_path / "decoupled.yaml")


def test_two_mass_is_determined_by_four_impacts(capsys: pytest.CaptureFixture[str]) -> None:
    """The least known combination is named with its numbers."""
    output = printed(capsys, "two_mass", TWO_MASS)
    assert "22 impacts in 28.189 s" in output
    assert "Full rank after 4 impacts, 5.695 s" in output
    assert "-0.31 x1 - 0.37 x2 - 0.045 dx1/dt + 0.88 dx2/dt" in output


def test_undetermined_combinations_are_named(
    tmp_path: Path, decoupled: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """With what is left of them at the end; only the last episode counts."""
    bag = bag_of(
        tmp_path / "bag",
        impact(9, "stop"),
        impact(4, "stop", "bell", episode=1),
        impact(7, "bell", episode=1),
        impact(11, "stop", episode=1),
        impact(11, "stop", episode=1),
    )
    output = printed(capsys, decoupled, bag)
    assert "2 of 4" in output
    # x2 oscillates with sqrt(7) rad/s for 0.7 s
    assert "1.0 x2, at the end -0.28 x2 - 2.5 dx2/dt 1.0 dx2/dt," in output


def test_json_has_all_results(decoupled: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A value without meaning is null."""
    found = impacts(capsys, decoupled, "--initial-deviation", "0.5")
    assert found["rank"] == 2
    assert found["condition"] is found["impacts_to_full_rank"] is found["seconds_to_full_rank"]
    assert found["condition"] is None
    assert found["unknown"] == [[0, 0.5, 0, 0], [0, 0, 0, 0.5]]
    assert found["states"] == ["x1", "x2", "dx1/dt", "dx2/dt"]
    full = impacts(capsys, "two_mass")
    assert full["impacts_to_full_rank"] == 4
    assert full["condition"] == pytest.approx(12, abs=0.1)


def test_bag_without_impacts_of_the_model_is_an_error_of_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error names both sides, and the exit code is 1."""
    bag = bag_of(tmp_path / "bag", impact(3, "bell"))
    assert main(["check-model", "two_mass", str(bag)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert f"{bag}: contains no impact of the model's contacts (stop); " in error
    assert "bell" in error
