# SPDX-License-Identifier: Apache-2.0
"""The command ``check-model MODEL BAG``: which part of the state the impacts determine."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from systems import system

from impact_observer.cli.main import main
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io import BagWriter
from impact_observer.io.messages import bag_messages
from impact_observer.observability import rank_report
from impact_observer.observability.rank import observability
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
    return event_of(stamp, *(Switch(contact) for contact in contacts), episode=episode)


def event_of(stamp: int, *switches: Switch, episode: int = 0) -> ImpactEvent:
    """An event then."""
    epoch = 1_000_000_000
    return ImpactEvent(epoch + stamp * 100_000_000, switches, stamp, episode, epoch)


@pytest.fixture
def decoupled(tmp_path: Path) -> str:
    """A model with a mass that no contact sees."""
    (tmp_path / "decoupled.yaml").write_text(DECOUPLED)
    return str(tmp_path / "decoupled.yaml")


def test_two_mass_is_determined_by_four_impacts(capsys: pytest.CaptureFixture[str]) -> None:
    """A table by the bag's model has a row for each rise and the end, then the conclusions."""
    output = printed(capsys, "two_mass", TWO_MASS)
    assert "two_mass: 22 impacts in 28.189 s, 4 unknown numbers event s contact" in output
    for row in ("1 0.537 stop 1/4 0.723 0 -", "4 5.695 stop 4/4 1.34 0.0826 16.2", "22 28.189"):
        assert row in output
    assert "5 6.5" not in output
    assert "Full rank after 4 impacts, 5.695 s after the start: all 4 numbers" in output
    assert "Least known: -0.31 x1 - 0.37 x2 - 0.045 dx1/dt + 0.88 dx2/dt." in output
    assert "moves the recorded gaps by 0.12 m in all, 12 times less than the best" in output


def test_undetermined_combinations_are_named(
    tmp_path: Path, decoupled: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Combinations are plain words; unknown contacts and other episodes are counted."""
    bag = bag_of(
        tmp_path / "bag",
        impact(9, "stop"),
        impact(4, "stop", "bell", episode=1),
        impact(7, "bell", episode=1),
        impact(11, "stop", episode=1),
        impact(11, "stop", episode=1),
    )
    output = printed(capsys, decoupled, bag)
    assert "The rank is 2 of 4: 2 combinations of the initial state are not determined." in output
    # x2 oscillates with sqrt(7) rad/s for 0.7 s
    assert "gives the same impacts: 1.0 x2, at the end -0.28 x2 - 2.5 dx2/dt 1.0 dx2/dt," in output
    assert "Determined all the same: x1 and dx1/dt." in output
    assert "The bag has 2 episodes: this is the last one." in output
    assert "1 event left out: sent twice" in output
    assert (
        "2 events of contacts that the model does not have, left out: bell; the model has stop."
        in (output)
    )


def test_json_has_all_results(decoupled: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The JSON has results per impact; a value without meaning is null."""
    found = impacts(capsys, decoupled, "--initial-deviation", "0.5")
    assert found["rank"] == 2
    assert found["condition"] is found["impacts_to_full_rank"] is found["seconds_to_full_rank"]
    assert found["condition"] is None
    assert found["unknown"] == [[0, 0.5, 0, 0], [0, 0, 0, 0.5]]
    assert found["states"] == ["x1", "x2", "dx1/dt", "dx2/dt"]
    growth = found["growth"]
    assert {len(values) for values in growth.values()} == {22}
    assert np.shape(growth["singular_values"]) == (22, 4)
    assert growth["stamp_ns"][0] - found["start_stamp_ns"] == round(growth["seconds"][0] * 1e9)
    full = impacts(capsys, "two_mass")
    assert full["impacts_to_full_rank"] == 4
    assert full["condition"] == full["growth"]["condition"][-1] == pytest.approx(12, abs=0.1)
    assert full["growth"]["condition"][:4][:3] == [None, None, None]


@pytest.mark.slow
def test_declared_deviations_stand_beside_exact_parameters(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On exact stamps only the declared deviation blurs; without one there is no such table."""
    text = shared("config/two_mass.yaml").read_text(encoding="utf-8")
    path = tmp_path / "declared.yaml"
    path.write_text(text + "uncertainty: {names: [restitution.stop], covariance: [[1.0e-4]]}\n")
    plain = printed(capsys, "two_mass", TWO_MASS)
    output = printed(capsys, str(path), TWO_MASS)
    assert "parameters exact" not in plain
    assert "deviation of parameters exact as declared unit" in output
    found = impacts(capsys, str(path))["deviations"]
    deviations = {name: np.array(each) for name, each in found.items()}
    assert np.all(deviations["exact"] < 1e-7)
    assert np.all(deviations["declared"] > 1e-5)
    assert np.all(deviations["declared"] < 0.1)


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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["two_mass", "BAG", "--initial-deviation", "1,2"], "expected one number"),
        (["two_mass", "--initial-deviation", "1"], "initial_deviation: given without a BAG"),
        (["hammer_arm", "BAG"], "hammer_arm: a robot"),
    ],
)
def test_wrong_use_is_one_line(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Options that are about impacts need impacts, and a linear model."""
    assert main(["check-model", *(str(TWO_MASS) if w == "BAG" else w for w in words)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error


def test_combination_shows_its_largest_terms() -> None:
    """At most six terms are shown, in SI units, without terms that are small in deviations."""
    model = system(np.eye(4), np.eye(4), np.eye(4), contacts=[([1, 0, 0, 0], 0.0, 0.5)])
    found = observability(model, [impact(3, "c1")])
    assert rank_report.remaining(found, np.ones(8), np.full(8, 1e-12)) == "gone at the end"
    one = np.array([0.7, 0.003, 0, 0, 0, -0.5, 0, 0])
    assert rank_report.combination(found, one) == "0.70 x1 - 0.50 dx2/dt"
    many = np.array([1, -2, 3, 4, 5, 6, 7, 8.0])
    assert rank_report.combination(found, many) == (
        "3.0 x3 + 4.0 x4 + 5.0 dx1/dt + 6.0 dx2/dt + 7.0 dx3/dt + 8.0 dx4/dt and 2 more"
    )


def test_long_growth_is_shown_by_its_ends(capsys: pytest.CaptureFixture[str]) -> None:
    """Eight masses have a stop each; one stop closes for good."""
    contacts = [(row, 0.0, 0.5) for row in np.eye(8)]
    model = system(np.eye(8), np.zeros((8, 8)), np.diag(np.arange(1.0, 9.0)), contacts=contacts)
    events = [impact(k, f"c{k % 8 + 1}") for k in range(1, 17)]
    events.append(event_of(30, Switch("c1", Kind.CLOSE), Switch("c2")))
    events.append(event_of(40, Switch("c1", Kind.OPEN)))
    rank_report.print_observability(observability(model, events))
    output = capsys.readouterr().out
    assert "17 impacts and 1 release in 4.000 s, 16 unknown numbers" in output
    assert "... " in output
    assert "5 more in --json" in output
    assert "c1 opens" in output
    assert len(output.splitlines()) < 24
