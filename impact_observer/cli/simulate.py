# SPDX-License-Identifier: Apache-2.0
"""Run a plant without ROS: its impacts and its true states go into a bag."""

import argparse
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_option, add_shared, positive, seed
from impact_observer.cli.progress import Progress
from impact_observer.errors import UsageError
from impact_observer.sensor_faults import MEASUREMENT_RATE, SENSOR_FAULTS, USUAL_RATE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from impact_observer.model.multibody import Multibody
    from impact_observer.plant import Run


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add_shared(parser, "rig", "seed", "output")
    add("--duration", metavar="S", type=positive, default=30.0, help="how long, s (default 30)")
    add("--rate", metavar="HZ", type=positive, default=100.0, help="true states, Hz (default 100)")
    add(
        "--random-parameters",
        metavar="SEED",
        type=seed,
        help="draw the plant's parameters from the deviations of the model; the bag has the model"
        " as declared, and the drawn values in its provenance",
    )
    group = parser.add_argument_group("sensor", "its faults; none by default")
    for each in SENSOR_FAULTS:
        add_option(group, each)
    group = parser.add_argument_group("measurements", "what is measured beside the impacts")
    add_shared(group, "measurements")
    add_option(group, MEASUREMENT_RATE)


def run(args: argparse.Namespace) -> int:
    """Simulate a plant and write its bag."""
    import numpy as np

    from impact_observer import plant
    from impact_observer.events import Kind
    from impact_observer.io.recordings import write_run
    from impact_observer.io.simulated_samples import SampleSimulation, simulated_samples
    from impact_observer.io.writer import check_free
    from impact_observer.model import read_model
    from impact_observer.model.measurement import read_measurements
    from impact_observer.model.multibody import multibody_of
    from impact_observer.observer.event_order import impacts_of
    from impact_observer.stamps import NS_PER_S, from_seconds, grid, seconds_between

    check_free(args.output)
    given = {each.name: getattr(args, each.name) for each in SENSOR_FAULTS}
    sensor = plant.SensorModel(**{k: value for k, value in given.items() if value is not None})
    model, epoch, duration = read_model(args.model), NS_PER_S, args.duration
    system = multibody_of(model)
    sensor.check(system, model.sensors)
    true = plant.RandomPlant(system, {})
    if args.random_parameters is not None:
        true = plant.random_plant(model, args.random_parameters)
    stamps = grid(epoch, epoch + from_seconds(duration), args.rate)
    sensors = read_measurements(args.measurements)
    if not sensors and args.measurement_rate is not None:
        wrong = f"{MEASUREMENT_RATE.name}: given without --measurements"
        raise UsageError(f"{wrong}; name a file, or leave it out")
    rate = USUAL_RATE if args.measurement_rate is None else args.measurement_rate
    simulation = SampleSimulation(sensors, true.system, rate, args.seed)
    sampled = simulation.stamps(epoch, int(stamps[-1])) if sensors else stamps[:0]
    with Progress() as progress:

        def show(what: str, stamp: int) -> None:
            progress.step(what, seconds_between(epoch, stamp), duration)

        master = plant.Plant(true.system, *model.initial_state(), epoch=epoch)
        wanted = np.union1d(stamps, sampled)
        done = plant.simulate(master, wanted, progress=partial(show, "simulating"))
        samples = simulated_samples(simulation, done.sampled_at(sampled)) if sensors else []
        done = done.sampled_at(stamps)
        events = write_run(
            args.output,
            model,
            done,
            seed=args.seed,
            sensor=sensor,
            samples=samples,
            types=simulation.types,
            true_parameters=true.values,
            system=system,
            progress=partial(show, f"writing {args.output}"),
        )
        kinds = Counter(kind for *_, kind in impacts_of(done.events))
        words = [system.name, f"{duration:g} s", f"{kinds.total()} impacts"]
        if kinds[Kind.CLOSE]:
            words.append(f"{kinds[Kind.CLOSE]} of them persistent")
        words.append(f"{stamps.size} true states")
        own = ["own errors of contacts"] if model.sensors else []
        if faults := [*sensor.faults, *own]:
            words.append(f"{len(events)} events of a sensor with {', '.join(faults)}")
        if sensors:
            words.append(f"{len(samples)} samples")
        progress.line(f"{args.output}: {', '.join(words)}")
        for line in _remarks(done, true.system, duration):
            progress.line(line)
    return 0


def _remarks(run: "Run", system: "Multibody", seconds: float) -> "Iterator[str]":
    """Remarks on a run of a system over ``seconds``."""
    if line := system.held_force(seconds):
        yield f"warning: {line}"
    for line in system.remarks(run.states):
        yield f"note: {line}"
    if not run.switchings and system.m:
        gap, contact = run.nearest(system)
        yield f"note: no contact closed: smallest gap {gap:.3g} {system.gap_unit}, at {contact}"
