# SPDX-License-Identifier: Apache-2.0
"""new: each template becomes a rig that is checked, simulated, detected and identified."""

import re
from pathlib import Path

import numpy as np
import pytest
from systems import EPOCH, run
from true_impacts import true_impacts

from impact_observer.cli.main import main
from impact_observer.detector import parse_sources
from impact_observer.io.reader import BagReader
from impact_observer.model import read_model
from impact_observer.resources import shared
from impact_observer.stamps import NS_PER_S

TEMPLATES = {each.name: each for each in shared("config/templates").iterdir()}
DURATION = {"ball": "2", "chisel": "0.6", "gear": "1", "shaker": "0.7"}
"""For how long each rig is simulated, s."""

pytestmark = pytest.mark.usefixtures("in_tmp_path")
each_template = pytest.mark.parametrize("template", TEMPLATES)


@each_template
def test_every_file_has_the_name_of_the_rig(template: str) -> None:
    """The files are those of the template; the name stands in them, too."""
    assert main(["new", "my_rig", "--from", template]) == 0
    written = {each.name: each.read_text("utf-8") for each in Path().iterdir()}
    files = {each.name.replace("NAME", "my_rig") for each in TEMPLATES[template].glob("NAME*")}
    assert set(written) == files
    assert files >= {"my_rig.yaml", "my_rig_sensors.yaml", "my_rig.launch.py"}
    assert not any("NAME" in text for text in written.values())
    assert read_model("my_rig.yaml").system.name == "my_rig"


@each_template
def test_the_model_is_one_for_observers(template: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing in the model is doubted, and every restitution has a deviation."""
    assert main(["new", "my_rig", "--from", template]) == 0
    capsys.readouterr()
    assert main(["check-model", "my_rig.yaml"]) == 0
    assert "warning" not in capsys.readouterr().out
    model = read_model("my_rig.yaml")
    assert model.uncertainty is not None
    restitutions = {f"restitution.{each}" for each in model.system.contact_names}
    assert restitutions <= set(model.uncertainty.names)


@each_template
def test_the_sensors_are_those_of_the_model(template: str) -> None:
    """The file of sensors, and what it says of a live rig, have contacts of the model."""
    assert main(["new", "my_rig", "--from", template]) == 0
    contacts = set(read_model("my_rig.yaml").system.contact_names)
    text = Path("my_rig_sensors.yaml").read_text("utf-8")
    live = re.findall(r"^# (- \{.*\})$", text, re.MULTILINE)
    for sources in (text, "\n".join(["sources:", *live]) if live else text):
        assert {each.contact for each in parse_sources(sources, "sensors")} <= contacts


@pytest.mark.slow
@each_template
def test_a_simulated_rig_is_identified(template: str) -> None:
    """A rig whose hits rebound less is simulated; from the impacts the template finds that."""
    assert main(["new", "my_rig", "--from", template]) == 0
    text = Path("my_rig.yaml").read_text("utf-8")
    duller = re.sub(
        r"(?<=restitution: \{value: )[\d.]+", lambda value: f"{0.95 * float(value[0])}", text
    )
    Path("duller.yaml").write_text(duller, "utf-8")
    simulated = ["--duration", DURATION[template], "--jitter", "1e-5", "--seed", "1", "-o", "bag"]
    assert main(["simulate", "duller.yaml", *simulated]) == 0
    fit = ["--free", "restitution", "--clock-error", "1e-5", "-o", "fit.yaml"]
    assert main(["identify", "bag", "--model", "my_rig.yaml", *fit]) == 0
    true, typed, found = (
        np.array([each.restitution for each in read_model(f"{name}.yaml").system.contacts])
        for name in ("duller", "my_rig", "fit")
    )
    assert np.all(np.abs(found - true) < 0.1 * np.abs(typed - true))


@pytest.mark.slow
def test_impacts_of_the_flank_without_a_switch_are_inserted() -> None:
    """Once the motion is found, each impact of the plant there has its instant and speed."""
    assert main(["new", "my_rig", "--from", "gear"]) == 0
    model = read_model("my_rig.yaml")
    simulated = ["--duration", "2", "--rate", "10", "--jitter", "1e-5", "--seed", "1", "-o", "bag"]
    assert main(["simulate", "my_rig.yaml", *simulated]) == 0
    given = ["--law", "minimum-variance", "--clock-error", "1e-5", "-o", "estimate"]
    assert main(["observe", "bag", *given]) == 0
    with BagReader(Path("estimate")) as reader:
        made = [each for each in reader.impact_estimates("/observer/impacts") if not each.sequence]
        epoch = next(reader.events()).epoch
    plant = run(model.system, *model.initial_state(), seconds=1.9)
    truth = true_impacts(model.system, plant.switchings)
    later = {stamp - EPOCH: truth[stamp, name] for stamp, name in truth if name == "back"}
    assert {each.contact for each in made} == {"back"}
    for stamp, speeds in later.items():
        if stamp > NS_PER_S:
            near = min(made, key=lambda each: abs(each.stamp - epoch - stamp))
            assert abs(near.stamp - epoch - stamp) < 50_000
            np.testing.assert_allclose(near[4:6], speeds[:2], rtol=0.01)
    assert len(later) - 3 <= len(made) <= len(later) + 3


@pytest.mark.parametrize("there", ["my_rig.yaml", "my_rig_valve.csv"])
def test_nothing_is_overwritten(there: str, capsys: pytest.CaptureFixture[str]) -> None:
    """An existing file stays, and no other file is left."""
    Path(there).write_text("mine")
    assert main(["new", "my_rig", "--from", "chisel"]) == 2
    error = capsys.readouterr().err
    assert there in error
    assert error.count("\n") == 1
    assert [(path.name, path.read_text()) for path in Path().iterdir()] == [(there, "mine")]


@pytest.mark.parametrize("chosen", [[], ["--from", "hammer"]])
def test_the_templates_are_listed_where_none_is_meant(
    chosen: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """One line has them all."""
    assert main(["new", "my_rig", *chosen]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(template in error for template in ("--from", *TEMPLATES))
