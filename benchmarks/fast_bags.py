# SPDX-License-Identifier: Apache-2.0
"""Bags of a plant with ten impacts a second, so that an hour has 36 000 of them."""

from pathlib import Path

from impact_observer.io.observed_bag import observe_bag
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import write_run
from impact_observer.io.writer import BagWriter, copy_topics
from impact_observer.model import Model, parse_model
from impact_observer.observer import Observer, initial_state, law_named
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import from_seconds, grid

EPOCH = 1_000_000_000
RATE = 1000.0
SECONDS = 60.0
FASTER = 12.75
"""Speed-up over the sample two_mass."""


def fast_model(faster: float = FASTER, size: float = 1.0, restitution: float = 0.7) -> Model:
    """``two_mass`` in other units of time and length."""
    s = faster
    text = f"""
name: fast
coordinates: [x1, x2]
mass: [[1, 0], [0, 1]]
damping: [[{0.2 * s}, {-0.1 * s}], [{-0.1 * s}, {0.1 * s}]]
stiffness: [[{20 * s**2}, {-10 * s**2}], [{-10 * s**2}, {10 * s**2}]]
forcing:
  harmonics: [{{frequency: {2.5 * s}, cosine: [0, {4 * s**2 * size}], sine: [0, 0]}}]
contacts: [{{name: stop, direction: [0, -1], gap: {0.5 * size}, restitution: {restitution}}}]
initial_state: {{position: [{0.1 * size}, {-0.2 * size}], velocity: [{0.5 * s * size}, 0]}}
"""
    return parse_model(text, "fast")


def write_truth(path: Path, seconds: float) -> None:
    """A bag of model, impacts and true states at ``RATE``, as ``simulate`` writes it."""
    model = fast_model()
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), RATE)
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    write_run(path, model, simulate(plant, stamps), seed=0)


def write_impacts(path: Path, truth: Path) -> None:
    """A bag of model and impacts only, as from a rig."""
    with BagReader(truth) as reader, BagWriter(path) as writer:
        copy_topics(reader, writer, [t for t in reader.topics if "joint_states" not in t])


def observe(bag: Path, output: Path, rate: float | None = None) -> None:
    """The default of the command ``observe``: geometric, ten replicas."""
    system = fast_model().system
    with BagReader(bag) as reader:
        observer = Observer(system, law_named("geometric")(system), *initial_state("zero", system))
        observe_bag(reader, observer, output, rate=rate)
