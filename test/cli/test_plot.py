# SPDX-License-Identifier: Apache-2.0
"""plot: the motion in a bag as a picture."""

from pathlib import Path

import numpy as np
import pytest

from impact_observer.cli.main import main
from impact_observer.io import BagWriter, JointState
from impact_observer.io.messages import bag_messages

HEADS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


@pytest.mark.slow
@pytest.mark.parametrize("suffix", HEADS)
def test_ending_says_what_is_made(
    sample_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    """A picture, and one line about it."""
    output = tmp_path / f"motion{suffix}"
    assert main(["plot", str(sample_bag), "-o", str(output)]) == 0
    assert output.read_bytes().startswith(HEADS[suffix])
    assert capsys.readouterr().out == f"picture: {output}, 0.000 to 0.500 s of {sample_bag}\n"


def test_a_foreign_recording_of_many_coordinates_has_a_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a model, an epoch and impacts; the line says what is left out."""
    path, make = tmp_path / "rig", bag_messages()
    with BagWriter(path) as writer:
        for k in range(1, 5):
            q = np.linspace(0.0, 0.1 * k, 10)
            state = JointState(k, tuple(f"arm{i}" for i in range(10)), q, np.zeros(10))
            writer.write("/plant/joint_states", k, make.joint_state(state))
    assert main(["plot", str(path), "-o", str(tmp_path / "a.svg")]) == 0
    text = (tmp_path / "a.svg").read_text()
    assert "arm9" in text
    assert "arm0" not in text
    assert "2 coordinates" in capsys.readouterr().out
