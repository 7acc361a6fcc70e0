# SPDX-License-Identifier: Apache-2.0
"""Frequencies that were written in Hz into a model, by the coherence of impacts."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.check.hertz import coherence, frequencies_in_hertz
from impact_observer.cli.main import main

Array = NDArray[np.float64]

DRILL = """
name: drill
bodies: [{{name: hammer, mass: 1.2}}, {{name: bit, mass: 0.8}}]
springs:
  - {{between: [ground, hammer], stiffness: 9000, damping: 12}}
  - {{between: [ground, bit], stiffness: 60000, damping: 20}}
forces: [{{body: hammer, amplitude: 60, frequency: {frequency}}}]
stops: [{{name: hit, between: [hammer, bit], gap: 0.0015, restitution: 0.6}}]
initial_state: {{position: [0, 0], velocity: [0, 0]}}
"""


def repeating(rng: np.random.Generator, periods: int, impacts: int, count: int) -> Array:
    """``count`` impacts, some at each repetition of a motion, in periods of the drive."""
    even = np.arange(impacts) * periods / impacts + rng.normal(0.0, 0.02, impacts)
    phases = even if rng.random() < 0.3 else rng.uniform(0, periods, impacts)
    repetitions = periods * np.arange(count // impacts + 1)
    times = np.sort((phases + repetitions[:, None]).ravel())[:count]
    kept = times[rng.random(times.size) > rng.choice([0.0, 0.1])]
    return np.asarray(kept + rng.normal(0.0, rng.choice([0.0, 0.02]), kept.size))


def bouncing(rng: np.random.Generator, count: int) -> Array:
    """Hits of a ball that bounces high on a shaken table, mostly chaotic, in periods.

    Each flight takes as long as its first speed says, and the table's speed is harmonic.
    """
    kick, restitution = rng.uniform(0.1, 20.0), rng.uniform(0.0, 0.95)
    angle, flight, found = rng.uniform(0, math.tau), rng.uniform(0, 10), list[float]()
    for _ in range(count):
        angle += flight
        found.append(angle / math.tau)
        flight = max(abs(restitution * flight + kick * math.cos(angle)), 0.05)
    return np.array(found)


def test_impacts_at_random_are_coherent_as_by_rayleigh() -> None:
    """The number of impacts times the square of their coherence is exponentially distributed."""
    rng = np.random.default_rng(1)
    sizes = np.array([50 * coherence(rng.uniform(0, 9, 50), 7.0) ** 2 for _ in range(4000)])
    for bound in (0.5, 1.0, 3.0):
        assert np.mean(sizes > bound) == pytest.approx(math.exp(-bound), abs=0.02)


@pytest.mark.parametrize("seed", range(10))
def test_no_right_frequency_is_doubted(seed: int) -> None:
    """In 2000 recordings, of motions that repeat after one to twelve periods, and chaotic ones."""
    rng = np.random.default_rng(seed)
    for _ in range(100):
        omega, count = 10 ** rng.uniform(-1, 3), int(rng.choice([20, 30, 50, 100, 300]))
        periods, impacts = rng.integers(1, 13), rng.integers(1, 9)
        for turns in (repeating(rng, int(periods), int(impacts), count), bouncing(rng, count)):
            assert not frequencies_in_hertz(math.tau / omega * turns, np.array([omega]))


@pytest.mark.parametrize("seed", range(20))
def test_a_frequency_in_hertz_is_found_where_impacts_follow_the_drive(seed: int) -> None:
    """Motions of one or two periods with up to two impacts, the times of which scatter."""
    rng = np.random.default_rng(seed)
    hertz = 10 ** rng.uniform(-1, 3)
    turns = np.arange(100) * rng.choice([1, 2]) + rng.normal(0, 0.05, 100)
    turns = np.concatenate([turns, turns[: 50 * rng.integers(2)] + 0.2])
    assert frequencies_in_hertz(turns / hertz, np.array([hertz])) == [hertz]
    assert not frequencies_in_hertz(turns[:19] / hertz, np.array([hertz]))


def test_a_drive_that_explains_the_impacts_excuses_another_one() -> None:
    """The second drive of a model does nothing; in Hz it is that of the first by chance."""
    rng = np.random.default_rng(5)
    times = np.arange(100) + rng.normal(0, 0.02, 100)
    assert frequencies_in_hertz(times, np.array([1.0])) == [1.0]
    assert not frequencies_in_hertz(times, np.array([1.0, math.tau]))


@pytest.mark.usefixtures("in_tmp_path")
def test_commands_name_a_frequency_in_hertz(capsys: pytest.CaptureFixture[str]) -> None:
    """The commands check, observe and identify, and not with the frequency in rad/s."""
    for name, frequency in (("hz", 22.0), ("right", math.tau * 22)):
        Path(f"{name}.yaml").write_text(DRILL.format(frequency=frequency), encoding="utf-8")
    assert main(["simulate", "right.yaml", "--duration", "2", "-o", "bag"]) == 0
    said = "a frequency of the model drill is 22 rad/s, but impacts are coherent with 2 pi times"
    for name in ("hz", "right"):
        model, fit = f"{name}.yaml", ["--check", "--clock-error", "1e-4", "--duration", "1"]
        for command in (
            ["check", "bag", "--model", model],
            ["observe", "bag", "--model", model, "--rate", "10", "-o", f"observed_{name}"],
            ["identify", "bag", "--model", model, *fit],
        ):
            main(command)
            words = " ".join("".join(capsys.readouterr()).split())
            assert (said in words) is (name == "hz"), command
            assert ("if 22 is in Hz, write 138.230076758" in words) is (name == "hz")
