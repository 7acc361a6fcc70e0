"""Run a plant without ROS: its impacts and its true states go into a bag."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_option, positive, seed, stamp
from impact_observer.errors import UsageError
from impact_observer.integrators import DEFAULT_STEP, EVENT_DRIVEN, INTEGRATORS, MOREAU, described
from impact_observer.sensor_faults import SENSOR_FAULTS

if TYPE_CHECKING:
    from impact_observer.plant import SensorModel


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("model", metavar="MODEL", help="a model file, or a sample: two_mass, ...")
    parser.add_argument(
        "--duration", metavar="S", type=positive, default=30.0, help="how long, s (default 30)"
    )
    parser.add_argument(
        "--rate", metavar="HZ", type=positive, default=100.0, help="true states, Hz (default 100)"
    )
    parser.add_argument(
        "--seed", metavar="N", type=seed, default=0, help="of everything random (default 0)"
    )
    parser.add_argument(
        "--epoch",
        metavar="S",
        type=stamp,
        default=1_000_000_000,
        help="stamp of t = 0 (default 1)",
    )
    parser.add_argument(
        "--integrator",
        choices=INTEGRATORS,
        default=EVENT_DRIVEN,
        help="exact from event to event, or Moreau's time stepping (default event-driven)",
    )
    parser.add_argument(
        "--step",
        metavar="S",
        type=positive,
        help=f"length of the steps of moreau, s (default {DEFAULT_STEP:g})",
    )
    parser.add_argument(
        "-o", "--output", metavar="BAG", type=Path, required=True, help="the folder to make"
    )
    _add_sensor_arguments(parser)


def _add_sensor_arguments(parser: argparse.ArgumentParser) -> None:
    """Add an option for every fault of the sensor; all are off by default."""
    group = parser.add_argument_group("sensor", "its faults; none by default")
    for each in SENSOR_FAULTS:
        add_option(group, each)


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    from impact_observer.plant import SensorModel

    given = {each.name: getattr(args, each.name) for each in SENSOR_FAULTS}
    return simulate(
        args.model,
        args.output,
        args.duration,
        args.rate,
        seed=args.seed,
        epoch=args.epoch,
        integrator=args.integrator,
        step=args.step,
        sensor=SensorModel(**{name: value for name, value in given.items() if value is not None}),
    )


def simulate(
    model: str | Path,
    output: Path,
    duration: float,
    rate: float,
    *,
    seed: int = 0,
    epoch: int = 1_000_000_000,
    integrator: str = EVENT_DRIVEN,
    step: float | None = None,
    sensor: "SensorModel | None" = None,
) -> int:
    """Simulate a plant and write its bag.

    Args:
        model: a model file or a sample's name.
        output: the bag to make.
        duration: s.
        rate: of the true states, Hz.
        seed: of the sensor, recorded in the bag; the plant itself draws nothing at random.
        epoch: stamp of ``t = 0``, ns.
        integrator: ``event-driven`` or ``moreau``.
        step: length of the steps of ``moreau``, s; None for the default.
        sensor: faults of the sensor; None for none.

    Returns:
        0.

    Raises:
        UsageError, ModelError: the arguments cannot be used.
        ImpactLawError: the impact law has no solution.
        DynamicsError: the forcing ends before the duration.
        BagError: the bag cannot be written.
    """
    from impact_observer import plant
    from impact_observer.cli.progress import Progress
    from impact_observer.io.recordings import write_run
    from impact_observer.io.writer import check_free
    from impact_observer.model import read_model
    from impact_observer.stamps import from_seconds, grid, seconds_between

    check_free(output)
    if step is not None and integrator != MOREAU:
        raise UsageError(f"step: {step:g} s given; only the integrator {MOREAU} takes steps")
    step = DEFAULT_STEP if step is None else step
    sensor = sensor or plant.IDEAL
    read = read_model(model)
    sensor.check(read.system)
    stamps = grid(epoch, epoch + from_seconds(duration), rate)
    with Progress() as progress:

        def show(impact: int) -> None:
            progress.step("simulating", seconds_between(epoch, impact), duration, "s")

        master = plant.make_plant(
            read.system, *read.initial_state(), epoch=epoch, integrator=integrator, step=step
        )
        done = plant.simulate(master, stamps, progress=show)
        progress.show(f"writing {output}")
        how = described(integrator, step)
        events = write_run(output, read, done, seed=seed, integrator=how, sensor=sensor)
        of_sensor = f", {events} events of a sensor with {', '.join(sensor.faults)}"
        progress.line(
            f"{output}: {read.system.name}, {duration:g} s, {len(done.impacts)} impacts,"
            f" {stamps.size} true states{of_sensor if sensor.faults else ''}"
        )
    return 0
