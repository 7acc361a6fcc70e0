# SPDX-License-Identifier: Apache-2.0
"""Bags written here, as the MCAP project's own tools see them."""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags")

from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory

from impact_observer.cli.main import main
from impact_observer.io.reader import BagReader

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A plant's bag, and an observer's with revised verdicts."""
    folder = tmp_path_factory.mktemp("bags")
    plant, estimates = folder / "plant", folder / "estimates"
    faults = ["--missed", "0.2", "--spurious", "0.2", "--seed", "1"]
    simulated = ["simulate", "three_mass", "--duration", "6", "--rate", "20", *faults]
    assert main([*simulated, "-o", str(plant)]) == 0
    observed = ["observe", str(plant), "--law", "minimum-variance", "--ensemble", "1"]
    assert main([*observed, "-o", str(estimates)]) == 0
    return [plant, estimates]


def file_of(bag: Path) -> Path:
    """The one MCAP file of a bag."""
    (file,) = bag.glob("*.mcap")
    return file


def same(theirs: Any, ours: Any) -> bool:  # noqa: ANN401 (messages of two libraries)
    """Whether two decoded values are equal."""
    if hasattr(theirs, "__slots__") and not isinstance(theirs, (str, bytes)):
        return all(same(getattr(theirs, k), getattr(ours, k)) for k in theirs.__slots__)
    if isinstance(theirs, (list, tuple)):
        return len(theirs) == len(ours) and all(map(same, theirs, ours))
    return bool(theirs == ours)


def test_mcap_ros2_reads_what_rosbags_reads(bags: list[Path]) -> None:
    """Both libraries read the same fields of every message of every topic."""
    for bag in bags:
        with file_of(bag).open("rb") as stream, BagReader(bag) as reader:
            ours: dict[str, Iterator[tuple[int, object]]] = {
                topic: reader.messages(topic) for topic in reader.topics
            }
            count = 0
            decoded = make_reader(stream, decoder_factories=[DecoderFactory()])
            for _, channel, message, value in decoded.iter_decoded_messages():
                log_time, own = next(ours[channel.topic])
                assert log_time == message.log_time
                assert same(value, own), f"{channel.topic} at {log_time}"
                count += 1
            assert count == reader.message_count > 100


def test_log_times_never_go_back_in_a_file(bags: list[Path]) -> None:
    """Log times ascend in the order of the file, for players that do not sort."""
    for bag in bags:
        with file_of(bag).open("rb") as stream:
            in_file = NonSeekingReader(stream).iter_messages(log_time_order=False)
            times = [message.log_time for _, _, message in in_file]
        assert times == sorted(times)


@pytest.mark.skipif(shutil.which("mcap") is None, reason="the MCAP project's `mcap` is not here")
def test_mcap_doctor_finds_nothing(bags: list[Path]) -> None:
    """The doctor gives neither an error nor a warning."""
    for bag in bags:
        command = ["mcap", "doctor", "--strict-message-order", str(file_of(bag))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert done.stdout + done.stderr == ""
