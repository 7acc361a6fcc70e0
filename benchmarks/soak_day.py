# SPDX-License-Identifier: Apache-2.0
"""A simulated day of events, live and offline: ``./dev soak day``.

    ./dev soak day --hours 1 --law minimum-variance

The events of two_mass are given, serialized, to what takes them in in an observer node, each some
time after its stamp, so that one overtakes another now and then. One in a hundred comes twice, one
in a hundred is followed by a corrupt one of another episode. Every second an estimate is made and
serialized. Then the same events go through an observer as a recording does. Memory must stay flat,
and the estimates at the end be equal in every bit.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence

import numpy as np
from rclpy.serialization import serialize_message
from rich.console import Console
from rich.progress import Progress

from benchmarks.memory import occupied
from impact_observer.events import ImpactEvent
from impact_observer.io.messages import MessageLimits
from impact_observer.model import read_model
from impact_observer.observer import Observer, Options, make_observer, replay
from impact_observer.observer.sender_runs import in_order
from impact_observer.plant import Plant, simulate
from impact_observer.ros.event_intake import EventIntake
from impact_observer.ros.message_classes import ros_messages
from impact_observer.ros.serialized import EstimateSerializer
from impact_observer.stamps import NS_PER_S, grid

EPOCH = NS_PER_S
DELAY = 0.3
"""Mean time from a stamp to the arrival of its event, s."""
MOST_GROWTH = 4.0
"""After the first tenth, MB."""


def _received(hours: float) -> list[tuple[int, ImpactEvent]]:
    """Arrivals (ns) and events, in order of arrival."""
    model, draw = read_model("two_mass"), np.random.default_rng(1)
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    end = EPOCH + round(hours * 3600 * NS_PER_S)
    found: list[tuple[int, ImpactEvent]] = []
    for event in simulate(plant, grid(EPOCH, end, 1e-3)).events:
        copies = [event]
        if (chance := draw.random()) < 0.01:
            copies.append(event)
        elif chance < 0.02:
            episode = int(draw.integers(1, 2**32))
            copies.append(ImpactEvent(event.stamp, event.switches, 1, episode, event.epoch))
        delays = draw.exponential(DELAY * NS_PER_S, len(copies)).astype(int).tolist()
        found += [(event.stamp + delay, each) for delay, each in zip(delays, copies, strict=True)]
    return sorted(found, key=lambda each: each[0])


def _live(observer: Observer, received: Sequence[tuple[int, ImpactEvent]]) -> list[float]:
    """Give the events to an observer as a node does; the memory after each tenth, MB."""
    now, memory = [EPOCH], list[float]()
    counts = Counter[str]()
    intake = EventIntake(observer, lambda: now[0], NS_PER_S, MessageLimits(), counts)
    serializer, second = EstimateSerializer(observer.system.coordinates), EPOCH
    with Progress(console=Console(stderr=True)) as progress:
        for k, (arrival, event) in enumerate(progress.track(received, description="events")):
            while second + NS_PER_S <= arrival:
                second += NS_PER_S
                if observer.start is not None:
                    all(serializer.messages(observer.estimate(second)))
            now[0] = arrival
            intake.add(bytes(serialize_message(ros_messages().event(event))))
            while intake.is_busy:
                for _ in intake.slice():
                    pass
            if (k + 1) * 10 // len(received) > len(memory):
                memory.append(occupied())
    return memory


def main(args: Sequence[str] | None = None) -> int:
    """Run the day.

    Returns:
        0; 1 when memory grows, or bits differ.
    """
    parser = argparse.ArgumentParser(prog="./dev soak day", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--hours", type=float, default=24.0, metavar="H")
    parser.add_argument("--law", default="geometric")
    given = parser.parse_args(args)
    received, system = _received(given.hours), read_model("two_mass").system
    live, offline = (make_observer(system, Options(given.law, "random:1")) for _ in range(2))
    memory = _live(live, received)
    for _ in replay(offline, in_order(e for _, e in received), np.empty(0, dtype=np.int64)):
        pass
    stamps = [live.last_event + k * NS_PER_S // 7 for k in range(-20, 20)]
    same = all(
        one.q.tobytes() + one.u.tobytes() + one.covariance.tobytes()
        == other.q.tobytes() + other.u.tobytes() + other.covariance.tobytes()
        for one, other in ((live.estimate(s), offline.estimate(s)) for s in stamps)
    )
    growth = memory[-1] - memory[0]
    print(
        f"{given.law}, {given.hours:g} h, {len(received)} messages: memory"
        f" {', '.join(f'{each:.1f}' for each in memory)} MB, grown by {growth:.2f} MB since the"
        f" first tenth; bits live and offline are {'equal' if same else 'different'}"
    )
    return 0 if same and growth <= MOST_GROWTH else 1


if __name__ == "__main__":
    sys.exit(main())
