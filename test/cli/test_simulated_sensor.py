# SPDX-License-Identifier: Apache-2.0
"""simulate with a sensor that is not ideal: the contents of the bag, and refused values."""

from pathlib import Path
from typing import Any

import pytest

from impact_observer.cli.main import main
from impact_observer.io.interfaces import IMPACTS
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, model_of
from impact_observer.plant import Plant, SensorModel, simulate, simulate_sensor
from impact_observer.stamps import grid

EPOCH = 1_000_000_000
LAST = 11 * EPOCH
FAULTS: dict[str, Any] = {
    "delay": 0.01,
    "jitter": 0.002,
    "quantisation": 1e-4,
    "dead_time": 0.05,
    "missed": 0.1,
    "spurious": 1.5,
    "mislabelled": 0.2,
    "clock_offset": -0.02,
    "clock_drift": 1e-5,
    "threshold": 0.01,
    "impacts_only": True,
    "transport": 0.5,
}


def options(faults: dict[str, Any]) -> list[str]:
    """Options from arguments of the command line."""
    given = []
    for name, value in faults.items():
        option = f"--{name.replace('_', '-')}"
        given += [option] if value is True else [option, str(value)]
    return given


def test_events_of_the_bag_are_those_of_the_sensor_at_their_reception(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Events are those of ``simulate_sensor`` for the seed; log times are those of reception."""
    bag = tmp_path / "bag"
    arguments = ["simulate", "three_mass", "--duration", "10", "--seed", "5", "-o", str(bag)]
    assert main([*arguments, *options(FAULTS)]) == 0
    said = capsys.readouterr()
    with BagReader(bag) as reader:
        model = model_of(reader)
        arrivals = [raw.log_time for raw in reader.raw([IMPACTS.topic])]
        events = list(reader.events(IMPACTS.topic))
        truth = reader.joint_states("/plant/joint_states")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    run = simulate(plant, grid(EPOCH, LAST, 100.0))
    sensor = SensorModel(**FAULTS)
    expected = simulate_sensor(
        sensor, model.system, run.switchings, epoch=EPOCH, last=LAST, seed=5
    )
    assert events == [each.event for each in expected]
    assert arrivals == [each.arrival for each in expected]
    assert arrivals != [each.stamp for each in events]
    assert (truth.stamps == run.stamps).all()
    assert model.provenance["sensor"] == FAULTS
    assert f"{len(expected)} events of a sensor with delay, jitter" in said.out + said.err


def test_ideal_sensor_is_not_mentioned(tmp_path: Path) -> None:
    """No fault is on by default; provenance names the chosen faults."""
    bag = tmp_path / "bag"
    assert main(["simulate", "two_mass", "--duration", "5", "-o", str(bag)]) == 0
    with BagReader(bag) as reader:
        model = model_of(reader)
        arrivals = [raw.log_time for raw in reader.raw([IMPACTS.topic])]
        stamps = [event.stamp for event in events_in(reader)]
    assert "sensor" not in model.provenance
    assert arrivals == stamps
    assert stamps
