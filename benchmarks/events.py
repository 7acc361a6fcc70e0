# SPDX-License-Identifier: Apache-2.0
"""What an event costs an observer: in order, late, and with a long history."""

import statistics
from functools import partial
from pathlib import Path

from benchmarks.harness import Benchmark, Contest, DisagreementError, Goal, Metrics
from benchmarks.impacts import each_received, impacts
from impact_observer.model import read_model
from impact_observer.observer import Observer, Options, make_observer

SECONDS = 600.0
"""Of two_mass, which has three impacts in four seconds."""
DEEP = 100
"""Events that come after the late one."""
FIRST = 20
"""Events before anything is measured."""
FOREVER = 1e6
"""A history that keeps all events, s."""
EVENT = "event"
ALONE, TOGETHER = "alone", "ten replicas"


def _observer(law: str = "geometric", history: float = FOREVER) -> Observer:
    return make_observer(read_model("two_mass").system, Options(law=law, history=history))


def prepare(_: Path, law: str) -> Contest:
    """Default options, and events in order."""
    events, system = impacts("two_mass", SECONDS), read_model("two_mass").system

    def ours(_: Path) -> Metrics:
        found = {}
        for name, ensemble in ((ALONE, 1), (TOGETHER, 10)):
            observer = make_observer(system, Options(law=law, ensemble=ensemble))
            found[name] = statistics.median(each_received(observer, events)[FIRST:])
        return found

    work = f"two_mass, n = 2, {law}, default options, median of {len(events) - FIRST} events"
    return Contest(work, ours, units={ALONE: "s", TOGETHER: "s"})


def prepare_late(_: Path) -> Contest:
    """An event that arrives after later ones, or those later ones in order."""
    events = impacts("two_mass", SECONDS)[: FIRST + DEEP + 1]
    late, last = events[FIRST], events[-1].stamp
    before, after = events[:FIRST], events[FIRST + 1 :]
    ordered, disordered = _observer(), _observer()
    each_received(ordered, events)
    each_received(disordered, (*before, *after, late))
    if ordered.estimate(last).q.tobytes() != disordered.estimate(last).q.tobytes():
        raise DisagreementError("a late event ends in another estimate than an event in time")

    def ours(_: Path) -> Metrics:
        observer = _observer()
        each_received(observer, (*before, *after))
        return {EVENT: sum(each_received(observer, [late]))}

    def in_order(_: Path) -> Metrics:
        observer = _observer()
        each_received(observer, (*before, late))
        return {EVENT: sum(each_received(observer, after))}

    work = f"two_mass, one event {DEEP} events deep, or {DEEP} events in order: the same bits"
    return Contest(work, ours, {f"{DEEP} in order": in_order}, units={EVENT: "s"})


def prepare_long(_: Path) -> Contest:
    """Events in order, with the whole history or its last seconds."""
    events = impacts("two_mass", SECONDS)

    def median(_: Path, history: float) -> Metrics:
        observer = _observer(history=history)
        return {EVENT: statistics.median(each_received(observer, events)[-DEEP:])}

    work = f"two_mass, median of the last {DEEP} of {len(events)} events in order"
    ours, short = partial(median, history=FOREVER), partial(median, history=10.0)
    return Contest(work, ours, {"10 s kept": short}, units={EVENT: "s"})


def benchmarks() -> tuple[Benchmark, ...]:
    """The benchmarks of events, with the two main laws."""
    cost = "what does an event cost?"
    nexts = [
        Benchmark(
            f"event_{law.replace('-', '_')}",
            cost,
            partial(prepare, law=law),
            (Goal(most, metric=TOGETHER),),
        )
        for law, most in (("geometric", 30e-6), ("minimum-variance", 80e-6))
    ]
    late = "does a late event cost more than the events that it makes run again?"
    long = "does an event in order cost more with a long history?"
    return (
        *nexts,
        Benchmark(
            "event_late", late, prepare_late, (Goal(1.0, f"{DEEP} in order", EVENT),), rounds=15
        ),
        Benchmark(
            "event_in_order", long, prepare_long, (Goal(1.05, "10 s kept", EVENT),), rounds=15
        ),
    )
