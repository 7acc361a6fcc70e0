# SPDX-License-Identifier: Apache-2.0
"""Predicted impacts that do not come: how soon a dead sensor is noticed, and how often a live one.

    ./dev bench silence                      # two minutes of each rig, and sample bags
    ./dev bench silence --seconds 320        # 10 000 impacts of the drill

Of each rig the sensor dies once, at half the time and for a quarter of it: after how many impacts
a warning comes, and how long after the first impact that is reported again the estimate is
synchronized. Then the sensor lives, and reports exactly, with jitter, or misses a fifth of the
impacts: before which part of the events there is a false warning.

Then sample bags, most with faults, are observed with every fault and error declared zero: how many
estimates are off by more than three standard deviations, and how many are synchronized though off
by more than 0.05 in any component.
"""

import argparse
import math
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.filter_cost import RECORDINGS
from benchmarks.impacts import EPOCH
from impact_observer.events import ImpactEvent
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, model_of
from impact_observer.kernel._kernel import TINY
from impact_observer.model import Model, read_model
from impact_observer.observer import make_observer
from impact_observer.observer.replay import replay
from impact_observer.options import Options
from impact_observer.plant import Plant, simulate
from impact_observer.plant.sensor import IDEAL, SensorModel, simulate_sensor
from impact_observer.resources import shared
from impact_observer.stamps import from_seconds
from impact_observer.states import Estimate

RIGS = {"two_mass": 1e-3, "three_mass": 1e-3, "drill": 2e-5}
"""Models, and the jitter of their sensors, s."""
MISSED = 0.2
FAULTY = ("jitter", "missed", "spurious", "missed_and_spurious", "mislabelled")
"""Sample bags of sensors with faults."""
FAULTLESS = Options(
    law="minimum-variance",
    clock_error=0.0,
    missed=0.0,
    spurious=0.0,
    mislabelled=0.0,
    model_error=0.0,
)
FAR = 0.05
"""Error of an estimate that is not synchronized with its plant, m or m/s."""


def model_named(name: str) -> Model:
    """A sample model or the drill."""
    return RECORDINGS[name].model if name in RECORDINGS else read_model(name)


def reported(model: Model, seconds: float, sensor: SensorModel) -> list[ImpactEvent]:
    """What a sensor reports of a run of the plant, in the order of arrival."""
    last = EPOCH + from_seconds(seconds)
    run = simulate(Plant(model.system, *model.initial_state(), epoch=EPOCH), np.array([last]))
    sent = simulate_sensor(sensor, model.system, run.switchings, epoch=EPOCH, last=last, seed=1)
    return [each.event for each in sent]


def false_warnings(model: Model, events: Sequence[ImpactEvent]) -> int:
    """Before how many of ``events`` there is a warning of silence."""
    observer = make_observer(model, Options(law="minimum-variance"))
    found = 0
    for event in events:
        if observer.start is not None and event.stamp > observer.start:
            found += bool(observer.silence(event.stamp - 1))
        observer.receive(event)
    return found


def dead_sensor(
    model: Model, events: Sequence[ImpactEvent], since: int, until: int
) -> tuple[int, float]:
    """Impacts of a sensor that is dead from ``since`` to ``until`` (ns) before a warning.

    Also the seconds until the estimate is synchronized again; infinity where it never is.
    """
    observer = make_observer(model, Options(law="minimum-variance"))
    dead, warned, returned = 0, 0, 0
    for event in events:
        if since <= event.stamp < until:
            dead += 1
            if not warned and observer.silence(event.stamp + 1):
                warned = dead
            continue
        if event.stamp >= until and not returned:
            returned = event.stamp
        observer.receive(event)
        if returned and observer.estimate(event.stamp).synchronized:
            return warned, (event.stamp - returned) / 1e9
    return warned, math.inf


class Judged:
    """Estimates of a sample bag with true states, with every fault and error declared zero.

    Attributes:
        distances: largest error of any component of each estimate, m or m/s.
        errors: the same in standard deviations.
        synchronized: whether each estimate is.
        misfit: the warning of each estimate.
    """

    def __init__(self, bag: str) -> None:
        """Observe the sample ``bag`` at the stamps of its true states."""
        with BagReader(shared("bags") / bag) as reader:
            model, events = model_of(reader, None), events_in(reader)
            topic = reader.truth_topic()
            assert topic is not None, "true states"
            truth = reader.joint_states(topic)
        observer = make_observer(model, FAULTLESS)
        states = dict(zip(truth.stamps.tolist(), np.hstack([truth.q, truth.u]), strict=True))
        replayed = replay(observer, events, np.array(sorted(states)))
        estimates = [each for each in replayed if isinstance(each, Estimate)]
        size = 2 * model.system.n
        deviations = [np.sqrt(np.diag(np.reshape(e.covariance, (size,) * 2))) for e in estimates]
        errors = [np.abs(np.concatenate([e.q, e.u]) - states[e.stamp]) for e in estimates]
        pairs = zip(errors, deviations, strict=True)
        self.distances = np.array([each.max() for each in errors])
        self.errors = np.array([np.max(e / np.maximum(d, TINY)) for e, d in pairs])
        self.synchronized = np.array([each.synchronized for each in estimates])
        self.misfit = [each.misfit for each in estimates]


def bags_table() -> Table:
    """What becomes of sample bags whose faults are declared to be none."""
    table = Table("bag", "estimates", "over 3 deviations", "wrongly synchronized", "warned")
    for bag in ("two_mass", *FAULTY):
        judged = Judged(bag)
        wrong = judged.synchronized & (judged.distances > FAR)
        over, warned = np.sum(judged.errors > 3), sum(map(bool, judged.misfit))
        counts = (len(judged.misfit), over, np.sum(wrong), warned)
        table.add_row(bag, *map(str, counts))
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="./dev bench silence", description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0, help="of each run")
    seconds = parser.parse_args(arguments).seconds
    table = Table(
        "rig",
        "impacts",
        "dead: warned after",
        "again after, s",
        "false: exact",
        "jitter",
        "missed",
    )
    for name, jitter in RIGS.items():
        model = model_named(name)
        exact = reported(model, seconds, IDEAL)
        half = EPOCH + from_seconds(seconds / 2)
        warned, again = dead_sensor(model, exact, half, half + from_seconds(seconds / 4))
        sensors = (SensorModel(jitter=jitter, missed=missed) for missed in (0.0, MISSED))
        others = (reported(model, seconds, sensor) for sensor in sensors)
        false = [false_warnings(model, each) for each in (exact, *others)]
        table.add_row(
            name, str(len(exact)), str(warned or "never"), f"{again:.3g}", *map(str, false)
        )
    Console().print(table, bags_table())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
