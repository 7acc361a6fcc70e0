# SPDX-License-Identifier: Apache-2.0
"""Comparing the estimates in a bag with its truth, against reading every message."""

from functools import partial
from pathlib import Path

from rosbags.rosbag2 import Reader

from benchmarks.fast_bags import SECONDS, fast_model, observe, write_truth
from benchmarks.harness import Benchmark, Contest, DisagreementError, Goal
from impact_observer.compare.bag_comparison import BagComparison, compare_bag
from impact_observer.io.reader import BagReader


def prepare(folder: Path, seconds: float = SECONDS) -> Contest:
    """Record a bag with truth and estimates; check that every state is compared."""
    bag = folder / "bag"
    write_truth(folder / "truth", seconds)
    observe(folder / "truth", bag)
    (compared,) = _compared(bag).comparisons.values()
    with BagReader(bag) as reader:
        states = reader.topics[reader.truth_topic() or ""].count
    if (found := compared.samples + compared.mismatch.samples) != states:
        raise DisagreementError(f"{found} states compared, {states} in the bag")
    return Contest(
        f"{seconds:g} s, {states} states, {_read(bag)} messages",
        lambda _: _compared(bag),
        {"reading": lambda _: _read(bag)},
    )


def _compared(bag: Path) -> BagComparison:
    with BagReader(bag) as reader:
        return compare_bag(reader, fast_model().system)


def _read(bag: Path) -> int:
    """Read every message with ``rosbags``, serialized."""
    with Reader(bag) as reader:
        return sum(1 for _ in reader.messages())


def benchmark(seconds: float = SECONDS) -> Benchmark:
    """For a bag of so many seconds."""
    question = "what does comparing cost over reading?"
    return Benchmark(
        "compare", question, partial(prepare, seconds=seconds), (Goal(1.3, "reading"),)
    )
