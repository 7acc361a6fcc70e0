"""Ctrl-C leaves a valid bag of the work done so far."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from impact_observer.cli.main import main
from impact_observer.io.reader import BagReader

pytestmark = pytest.mark.slow


def test_an_observer_that_is_interrupted_leaves_a_whole_bag(tmp_path: Path) -> None:
    """One line, exit code 1; the estimates in the bag are the first of the run."""
    plant, output = tmp_path / "plant", tmp_path / "estimates"
    assert (
        main(["simulate", "two_mass", "--duration", "40", "--rate", "1000", "-o", str(plant)]) == 0
    )
    command = [sys.executable, "-m", "impact_observer", "observe", str(plant), "-o", str(output)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 30
    file = output / "estimates_0.mcap"
    while not (file.is_file() and file.stat().st_size > 2**20) and time.monotonic() < until:
        time.sleep(0.01)  # until a first chunk is there
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=30)
    assert process.returncode == 1
    assert error == f"impact-observer: interrupted; {output} holds what was done until then\n"
    with BagReader(output) as reader:
        states = reader.observer_states("/observer/state")
        truth = reader.joint_states("/plant/joint_states")
    assert 0 < states.stamps.size < 40001
    np.testing.assert_array_equal(states.stamps, truth.stamps[: states.stamps.size])
    assert main(["compare", str(output)]) == 0
