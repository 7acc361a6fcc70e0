# SPDX-License-Identifier: Apache-2.0
"""The arguments of ``play``, before anything is published."""

import argparse

import pytest

from impact_observer.cli import play


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("/a:=/b", ("/a", "/b")),
        ("impacts:=rig/impacts", ("/impacts", "/rig/impacts")),
        ("/rig_2/x:=y_", ("/rig_2/x", "/y_")),
    ],
)
def test_a_remapping_gives_absolute_names(text: str, names: tuple[str, str]) -> None:
    """Names are absolute, with and without the first slash."""
    assert play.remapping(text) == names


@pytest.mark.parametrize("text", ["/a", ":=", "/a:=", "/a=/b", "/a:=/b:=/c", "/a//b:=/c"])
def test_a_wrong_remapping_is_named(text: str) -> None:
    """The error says what was expected."""
    with pytest.raises(argparse.ArgumentTypeError, match=r"found; expected FROM:=TO"):
        play.remapping(text)
