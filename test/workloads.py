# SPDX-License-Identifier: Apache-2.0
"""Something short that each command does, for tests that go through all of them."""

from pathlib import Path

from impact_observer.cli.main import main
from impact_observer.resources import shared

HOSTILE = "\x1b]0;owned\x07\x1b[2J"
"""A name that would set the title of a terminal, and clear it."""
OUT = "out"
"""In arguments: the file or folder that the command makes."""
OFFLINE = {
    "new": ["rig", "--from", "ball"],
    "check-model": ["two_mass", "{bag}"],
    "fit": ["{csv}", "two_mass", "-o", OUT, "--epoch", "1"],
    "identify": ["{bag}", "--free", "restitution", "-o", "out.yaml"],
    "simulate": ["two_mass", "--duration", "3", "--rate", "100", "-o", OUT],
    "detect": ["{switch}", "--contact", "stop", "--topic", "/switch", "-o", OUT],
    "import": ["{csv}", "--model", "two_mass", "-o", OUT],
    "observe": ["{bag}", "-o", OUT],
    "smooth": ["{bag}", "-o", OUT],
    "compare": ["{bag}", "--plot", "out.svg"],
    "sweep": ["two_mass", "--duration", "0.5", "--runs", "1", "--jobs", "1", "-o", "out.parquet"],
    "plot": ["{bag}", "-o", "out.svg"],
    "export": ["{bag}", "--what", "events", "-o", "out.csv"],
    "check": ["{bag}"],
}
"""What is run of each command without ROS."""
WITH_ROS = {
    "demo": ["--duration", "600", "--realtime-factor", "1", "-o", OUT + HOSTILE],
    "play": ["{bag}", "--loop"],
    "record": ["--topics", "/impacts", "-o", OUT + HOSTILE],
    "watch": [],
}
"""The same of those that need ROS, for as long as a test wants."""


def make_inputs(folder: Path) -> dict[str, str]:
    """What the commands read, by its name in their arguments."""
    plant, bag, table = folder / "plant", folder / "bag", folder / "impacts.csv"
    simulated = ["simulate", "two_mass", "--duration", "12", "--rate", "5", "-o", str(plant)]
    assert main(simulated) == 0
    assert main(["observe", str(plant), "--initial-state", "random:1", "-o", str(bag)]) == 0
    assert main(["export", str(plant), "--what", "events", "-o", str(table)]) == 0
    return {"bag": str(bag), "switch": str(shared("bags/switch")), "csv": str(table)}
