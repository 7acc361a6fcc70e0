# SPDX-License-Identifier: Apache-2.0
"""plot: a bag as a picture or a page."""

from pathlib import Path

import pytest

from impact_observer.cli.main import main

HEADS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF", ".html": b"<!DOCTYPE html>"}


@pytest.mark.slow
@pytest.mark.parametrize("suffix", HEADS)
def test_ending_says_what_is_made(
    sample_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    """A picture or a page, and one line about it."""
    output = tmp_path / f"motion{suffix}"
    assert main(["plot", str(sample_bag), "-o", str(output)]) == 0
    assert output.read_bytes().startswith(HEADS[suffix])
    assert capsys.readouterr().out == f"picture: {output}, 0.000 to 0.500 s of {sample_bag}\n"


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["-o", "a.gif"], "expected a name that ends in .png, .svg, .pdf, .html, .htm"),
        (["-o", "nowhere/a.png"], "nowhere; make it first"),
        (["-o", "a.html", "--select", "x9"], "--select x9: nothing of that name"),
        (["-o", "a.html", "--width", "900"], "--width 900: expected 2 to 60 inches"),
        (["-o", "a.html", "--observers", "nobody"], "observer /nobody: not in"),
        (["-o", "a.html", "--start", "99"], "from 99 s to the end after the epoch"),
    ],
)
def test_wrong_use_is_one_line(
    sample_bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    expected: str,
) -> None:
    """The failed command leaves no file."""
    _, name, *others = arguments
    output = tmp_path / name
    assert main(["plot", str(sample_bag), "-o", str(output), *others]) != 0
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert expected in line
    assert not output.exists()


def test_foreign_recording_without_a_model_has_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The picture has coordinates and velocities; the error names them instead of gaps."""
    from impact_observer.io import BagWriter, JointState
    from impact_observer.io.messages import bag_messages

    path, make = tmp_path / "rig", bag_messages()
    with BagWriter(path) as writer:
        writer.declare("/plant/joint_states")
        for k in range(1, 5):
            state = JointState(k, ("arm",), [0.1 * k], [0.0])  # type: ignore[arg-type]
            writer.write("/plant/joint_states", k, make.joint_state(state))
    assert main(["plot", str(path), "-o", str(tmp_path / "a.svg")]) == 0
    assert "arm" in (tmp_path / "a.svg").read_text()
    assert main(["plot", str(path), "-o", str(tmp_path / "a.html"), "--select", "stop"]) == 2
    assert "one of q_arm, u_arm" in capsys.readouterr().err
