# SPDX-License-Identifier: Apache-2.0
"""Bags whose models have keys that went in 0.4.0."""

from pathlib import Path

import pytest

from impact_observer.cli.main import main
from impact_observer.model import Model, read_model

FRICTION = "friction: [{name: guide, between: [ground, x1], force: 0.1}]\n"


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
    (line,) = capsys.readouterr().err.splitlines()
    assert "friction" in line
    assert "0.3.0" in line
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
