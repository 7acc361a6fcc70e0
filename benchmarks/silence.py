# SPDX-License-Identifier: Apache-2.0
"""Predicted impacts that do not come: how soon a dead sensor is noticed, and how often a live one.

    ./dev bench silence                      # two minutes of each rig
    ./dev bench silence --seconds 320        # 10 000 impacts of the drill

Of each rig the sensor dies once, at half the time and for a quarter of it: after how many impacts
a warning comes, and how long after the first impact that is reported again the estimate is
synchronized. Then the sensor lives, and reports exactly, with jitter, or misses a fifth of the
impacts: before which part of the events there is a false warning.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.filter_cost import RECORDINGS
from benchmarks.impacts import EPOCH
from impact_observer.events import ImpactEvent
from impact_observer.model import Model, read_model
from impact_observer.observer import make_observer
from impact_observer.options import Options
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import from_seconds, grid

RIGS = {"two_mass": 1e-3, "three_mass": 1e-3, "drill": 2e-5}
"""Models, and the jitter of their sensors, s."""
MISSED = 0.2


def model_named(name: str) -> Model:
    """A sample model or the drill."""
    return RECORDINGS[name].model if name in RECORDINGS else read_model(name)


def reported(model: Model, seconds: float, jitter: float, missed: float) -> list[ImpactEvent]:
    """What a sensor reports of a run of the plant: stamps with ``jitter``, some ``missed``."""
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), 1 / seconds)
    run = simulate(Plant(model.system, *model.initial_state(), epoch=EPOCH), stamps)
    random = np.random.default_rng(1)
    kept = [each for each in run.events if random.random() >= missed]
    late = [from_seconds(jitter * each) for each in random.normal(size=len(kept))]
    events = [replace(each, stamp=each.stamp + s) for each, s in zip(kept, late, strict=True)]
    events.sort(key=lambda each: each.stamp)
    return [replace(each, sequence=k + 1) for k, each in enumerate(events)]


def false_warnings(model: Model, events: Sequence[ImpactEvent]) -> int:
    """Before how many of ``events`` there is a warning of silence."""
    observer = make_observer(model.system, Options(law="minimum-variance"), model.elements)
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
    observer = make_observer(model.system, Options(law="minimum-variance"), model.elements)
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a table."""
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
        exact = reported(model, seconds, 0.0, 0.0)
        half = EPOCH + from_seconds(seconds / 2)
        warned, again = dead_sensor(model, exact, half, half + from_seconds(seconds / 4))
        others = (reported(model, seconds, jitter, missed) for missed in (0.0, MISSED))
        false = [false_warnings(model, each) for each in (exact, *others)]
        table.add_row(name, str(len(exact)), str(warned), f"{again:.3g}", *map(str, false))
    Console().print(table)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
