# SPDX-License-Identifier: Apache-2.0
"""Models with keys that went in 0.4.0: one line each; bags with them can still be read."""

from pathlib import Path

import pytest

from impact_observer.cli.main import main
from impact_observer.errors import ModelError
from impact_observer.model import Model, parse_model, read_model

TEXT = """\
name: old
bodies: [{name: x1, mass: 1}, {name: x2, mass: 1}]
springs: [{between: [ground, x1], stiffness: 10}, {between: [x1, x2], stiffness: 10}]
forces: [{body: x2, amplitude: 4, frequency: 2.5}]
stops: [{name: stop, body: x2, limit: 0.5, side: above, restitution: 0.7}]
"""
FRICTION = "friction: [{name: guide, between: [ground, x1], force: 0.1}]\n"
MATRICES = read_model("two_mass").text()
TABLE = "{speeds: [1, 3], values: [0.7, 0.5]}"
CASES = {
    "friction": TEXT + FRICTION,
    "unit": TEXT + "unit: deg\n",
    "grounds[0].motion.live": TEXT + "grounds: [{name: table, motion: {live: true}}]\n",
    "forces[0].order": TEXT.replace("frequency: 2.5", "order: 1, frequency: 2.5"),
    "stops[0].contact_time": TEXT.replace("0.7}", "0.7, contact_time: 0.01}"),
    "stops[0].velocity_offset": TEXT.replace("0.7}", "0.7, velocity_offset: 0.2}"),
    "stops[0].restitution.speeds": TEXT.replace("0.7}", TABLE + "}"),
    "forcing.harmonics[0].order": MATRICES.replace("- frequency", "- order: 1\n    frequency"),
}
"""A model with each key."""


@pytest.mark.parametrize("key", CASES)
def test_a_key_that_went_is_named_with_the_last_version_that_has_it(key: str) -> None:
    """In one line."""
    with pytest.raises(ModelError, match=r"0\.3\.0") as caught:
        parse_model(CASES[key], "old.yaml")
    assert str(caught.value).startswith(f"old.yaml: {key}: ")


def test_bags_with_keys_that_went_are_exported_plotted_and_observed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Observed and compared by another model alone."""
    text = read_model("two_mass").text() + FRICTION
    bag, result = str(tmp_path / "bag"), str(tmp_path / "result")
    with monkeypatch.context() as patch:
        patch.setattr(Model, "text", lambda *_: text)
        words = ["--duration", "5", "--rate", "10"]
        assert main(["simulate", "two_mass", *words, "-o", bag]) == 0
    assert main(["observe", bag, "-o", result]) == 2
    assert "friction" in capsys.readouterr().err
    assert (
        main(["observe", bag, "--model", "two_mass", "--initial-state", "random:1", "-o", result])
        == 0
    )
    for words in (["export", "-o", "a.csv"], ["plot", "-o", "a.png"]):
        command, *output = [str(tmp_path / w) if "." in w else w for w in words]
        assert main([command, result, *output]) == 0
    capsys.readouterr()
    for words in (["compare"], ["identify", "--free", "gap"]):
        assert main([*words, result]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "friction" in line
        assert "--model" in line
    assert main(["compare", result, "--model", "two_mass"]) == 0
