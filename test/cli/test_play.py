# SPDX-License-Identifier: Apache-2.0
"""play: its arguments, before anything is published."""

import argparse
import io
import sys
from pathlib import Path

import pytest

from impact_observer.cli import play
from impact_observer.cli.main import main


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("/a:=/b", ("/a", "/b")),
        ("impacts:=rig/impacts", ("/impacts", "/rig/impacts")),
        ("/rig_2/x:=y_", ("/rig_2/x", "/y_")),
    ],
)
def test_remapping_is_of_absolute_names(text: str, names: tuple[str, str]) -> None:
    """However they are written."""
    assert play.remapping(text) == names


@pytest.mark.parametrize(
    "text", ["/a", ":=", "/a:=", ":=/b", "/a=/b", "/a:=/b:=/c", "/a//b:=/c", "/2:=/b", "/a:=/b c"]
)
def test_remapping_that_is_none_is_named(text: str) -> None:
    """With what is expected."""
    with pytest.raises(argparse.ArgumentTypeError, match=r"found; expected FROM:=TO"):
        play.remapping(text)


def test_a_mistake_in_a_file_of_qualities_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before ROS is imported."""
    path = tmp_path / "qos.yaml"
    path.write_text("/impacts: {depth: many}\n")
    assert main(["play", "bag", "--qos", str(path)]) == 2
    error = capsys.readouterr().err
    assert error == (
        f"impact-observer: {path}: /impacts: depth is 'many'; expected a whole number, 0 or more\n"
    )


def test_a_bag_cannot_begin_paused_where_no_key_is_read(
    sample_bag: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    ros_environment: dict[str, str],
) -> None:
    """It could not be resumed."""
    assert ros_environment
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    assert main(["play", str(sample_bag), "--start-paused"]) == 2
    assert "start-paused: needs a terminal" in capsys.readouterr().err


@pytest.mark.parametrize(("key", "wanted"), play._KEYS.items())
def test_every_key_has_an_action_of_the_player(key: str, wanted: str) -> None:
    """Other keys have none."""
    from impact_observer.io.play_schedule import Control

    class Typing:
        def pressed(self) -> list[str]:
            return [key, "z"]

    assert play.controls_of(Typing()) == [Control[wanted]]  # type: ignore[arg-type]
