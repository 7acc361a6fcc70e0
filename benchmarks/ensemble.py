# SPDX-License-Identifier: Apache-2.0
"""An event with very many replicas, against one matrix product of the same size."""

import statistics
import time
from itertools import islice
from pathlib import Path

import numpy as np

from benchmarks.harness import Benchmark, Contest, DisagreementError, Goal, Metrics
from benchmarks.impacts import EPOCH, each_received, impacts
from impact_observer.model import read_model
from impact_observer.observer import Options, make_observer

REPLICAS = 100_000
SECONDS = 300.0
TURN = 5
"""Events, or products, whose median is taken."""
EVENT = "event"
PEER = "one product"


def prepare(_: Path) -> Contest:
    """An ensemble that continues from event to event, round after round."""
    system = read_model("three_mass").system
    observer = make_observer(system, Options(ensemble=REPLICAS, epoch=EPOCH, history=1.0))
    alone = make_observer(system, Options(ensemble=1, epoch=EPOCH))
    events = iter(impacts("three_mass", SECONDS))
    for event in islice(events, TURN):
        for each in (observer, alone):
            each.receive(event)
        many, one = (each.estimate(event.stamp) for each in (observer, alone))
        if not np.allclose(many.q, one.q, rtol=0, atol=1e-12):
            raise DisagreementError("the estimate depends on the other replicas")
    x, phi = np.ones((REPLICAS, 2 * system.n)), np.eye(2 * system.n)

    def ours(_: Path) -> Metrics:
        return {EVENT: statistics.median(each_received(observer, islice(events, TURN)))}

    def product(_: Path) -> Metrics:
        taken: list[float] = []
        while len(taken) < TURN:
            begin = time.perf_counter()
            x @ phi
            taken.append(time.perf_counter() - begin)
        return {EVENT: statistics.median(taken)}

    n = 2 * system.n
    work = f"three_mass, {REPLICAS} replicas, motion and impact; ({REPLICAS}, {n}) @ ({n}, {n})"
    return Contest(work, ours, {PEER: product}, units={EVENT: "s"})


BENCHMARK = Benchmark(
    "ensemble", "what do very many replicas cost?", prepare, (Goal(3.0, PEER, EVENT),)
)
