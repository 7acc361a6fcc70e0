# SPDX-License-Identifier: Apache-2.0
"""compare --laws: the law is one parameter, and every law is compared on the same bag."""

import json
from pathlib import Path

import pytest

from impact_observer.cli.main import main
from impact_observer.compare.bag_comparison import compare_bag
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import model_of
from impact_observer.observer import Options, make_observer
from impact_observer.observer.laws import BUILT_IN
from impact_observer.resources import shared


@pytest.fixture(scope="module")
def plant_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with six seconds of two_mass and four impacts."""
    bag = tmp_path_factory.mktemp("laws") / "plant"
    arguments = ["simulate", "two_mass", "--duration", "6", "--rate", "10", "-o", str(bag)]
    assert main(arguments) == 0
    return bag


def observed(bag: Path, output: Path, law: str) -> Path:
    """Observe ``bag`` with ``law`` into another bag."""
    arguments = ["--law", law, "--initial-state", "random:1", "--ensemble", "1", "-o", str(output)]
    assert main(["observe", str(bag), *arguments]) == 0
    return output


def compared(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, dict[str, object]]:
    """The output of ``compare --json``."""
    capsys.readouterr()
    assert main(["compare", *arguments, "--json"]) == 0
    found: dict[str, dict[str, object]] = json.loads(capsys.readouterr().out)
    return found


@pytest.mark.slow
def test_laws_run_on_a_bag_equal_those_observed_into_bags(
    plant_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every error of every law is equal to the bit, and every printed figure too."""
    bags = [observed(plant_bag, tmp_path / law, law) for law in BUILT_IN]
    with BagReader(plant_bag) as reader:
        system = model_of(reader).system
        observers = [
            make_observer(system, Options(law, "random:1", ensemble=1)) for law in BUILT_IN
        ]
        made = compare_bag(reader, system, observers).comparisons
    for bag in bags:
        with BagReader(bag) as reader:
            recorded = compare_bag(reader, system).comparisons["/observer"]
        assert made[bag.name].error.tobytes() == recorded.error.tobytes()
        assert made[bag.name].stamps.tobytes() == recorded.stamps.tobytes()
    in_memory = compared(capsys, str(plant_bag), "--laws", "all", "--initial-state", "random:1")
    assert list(in_memory) == list(BUILT_IN)
    assert in_memory == compared(capsys, *map(str, bags))


@pytest.mark.slow
def test_laws_are_compared_beside_the_estimates_in_the_bag(
    plant_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recorded one is named by its topic where the law alone is ambiguous."""
    bag = str(observed(plant_bag, tmp_path / "recorded", "geometric"))
    assert list(compared(capsys, bag, "--laws", "kinematic")) == ["geometric", "kinematic"]
    found = compared(capsys, bag, "--laws", "geometric,kinematic,geometric")
    assert list(found) == ["geometric /observer", "geometric", "kinematic"]
    assert found["geometric"]["V_start"] != found["geometric /observer"]["V_start"]


def test_impacts_of_other_contacts_are_no_comparison(
    plant_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line names the bag, the law, and the contacts that the model has."""
    model = tmp_path / "other.yaml"
    text = shared("config/two_mass.yaml").read_text("utf-8")
    model.write_text(text.replace("name: stop", "name: anvil"), encoding="utf-8")
    arguments = ["compare", str(plant_bag), "--laws", "kinematic", "--model", str(model)]
    assert main(arguments) == 1
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert "plant: kinematic: no event could be applied" in errors[0]
    assert "contacts are anvil" in errors[0]


def test_deviations_of_the_model_are_said_once_a_bag(
    plant_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """That the model was fitted to these impacts; not among figures."""
    text = shared("config/two_mass.yaml").read_text(encoding="utf-8")
    model = tmp_path / "model.yaml"
    with BagReader(plant_bag) as reader:
        last = max(each.stamp for each in reader.events())
    model.write_text(
        text + "uncertainty: {names: [restitution.stop], covariance: [[4.0e-4]],"
        f" fitted_to: {{first: 0, last: {last}}}}}\n"
    )
    arguments = ["compare", str(plant_bag), "--laws", "all", "--model", str(model)]
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum("the model was fitted to these impacts" in line for line in lines) == 1
    assert main([*arguments, "--json"]) == 0
    output = capsys.readouterr()
    assert "fitted" in output.err
    assert "fitted" not in output.out
