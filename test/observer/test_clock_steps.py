# SPDX-License-Identifier: Apache-2.0
"""The sensor's clock steps: all later stamps are off by the same duration."""

from dataclasses import replace
from functools import cache

import numpy as np
from systems import EPOCH, run, sample

from impact_observer.events import ImpactEvent
from impact_observer.observer import make_observer
from impact_observer.options import Options
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S, from_seconds

STEP = EPOCH + 30 * NS_PER_S
"""When the clock steps."""


@cache
def whole_run(name: str) -> Run:
    """A minute of a sample model."""
    model = sample(name)
    return run(model.system, *model.initial_state(), seconds=60.0, rate=50.0)


def stepped(name: str, by: float, jitter: float = 0.0) -> list[ImpactEvent]:
    """Its events by a clock that is ahead by ``by`` s from ``STEP`` on; stamps jitter, s."""
    events, random = whole_run(name).events, np.random.default_rng(3)
    late = [(each.stamp >= STEP) * by + jitter * random.normal() for each in events]
    return [
        replace(each, stamp=each.stamp + from_seconds(dt))
        for each, dt in zip(events, late, strict=True)
    ]


def test_late_events_of_a_stepped_clock_change_nothing() -> None:
    """Events that come in another order give the same estimates in every bit."""
    events, model = stepped("two_mass", -0.1), sample("two_mass")
    swapped = [*events]
    for k in range(0, len(events) - 1, 2):
        swapped[k], swapped[k + 1] = swapped[k + 1], swapped[k]
    stamps = whole_run("two_mass").stamps[1500::100].tolist()
    made = []
    for some in (events, swapped):
        observer = make_observer(model, Options(law="minimum-variance", history=20.0))
        for each in some:
            observer.receive(each)
        made.append([observer.estimate(stamp) for stamp in stamps if stamp > STEP + 10 * NS_PER_S])
    for one, other in zip(*made, strict=True):
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.covariance, other.covariance)
