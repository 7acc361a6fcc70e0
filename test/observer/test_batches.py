# SPDX-License-Identifier: Apache-2.0
"""Batches of events, and estimates that are asked for while a batch is worked on."""

from itertools import chain

import numpy as np

from impact_observer.events import ImpactEvent, Switch, Verdict
from impact_observer.model import read_model
from impact_observer.observer import Observer, Options, make_observer
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S, grid
from impact_observer.states import Estimate

EPOCH = 1_000_000_000
SILENCE = 20 * NS_PER_S
"""After which an event takes long."""


def observer_after_silence() -> tuple[Observer, list[ImpactEvent]]:
    """An observer that has had some impacts, and those that come after a silence."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    impacts = simulate(plant, grid(EPOCH, EPOCH + 8 * NS_PER_S, 1.0)).events
    observer = make_observer(model, Options(law="minimum-variance"))
    for each in impacts:
        observer.receive(each)
    stamps = [EPOCH + SILENCE + k * NS_PER_S for k in range(2)]
    return observer, [ImpactEvent(each, (Switch("stop"),), epoch=EPOCH) for each in stamps]


def test_predictions_may_be_asked_for_while_a_batch_is_worked_on() -> None:
    """They are those of before the event, and change neither the event's effect nor each other."""
    observer, late = observer_after_silence()
    other, _ = observer_after_silence()
    stamp = EPOCH + SILENCE + NS_PER_S
    seen, before, rulings = list[Estimate](), other.estimate(stamp), list[Verdict]()
    for step in observer.receiving(late):
        if not step:
            seen.append(observer.estimate(stamp))
        for _, verdicts in step:
            rulings += verdicts
    wanted = [each for event in late for each in other.receive(event)]
    assert [each[:5] for each in rulings] == [each[:5] for each in wanted]
    assert len(seen) == len(late)
    assert np.array_equal(seen[0].q, before.q)
    mine, theirs = observer.estimate(stamp), other.estimate(stamp)
    assert mine.q.tobytes() == theirs.q.tobytes()
    assert mine.covariance.tobytes() == theirs.covariance.tobytes()


def test_events_of_a_batch_that_is_given_up_may_be_given_again() -> None:
    """Late events without a verdict are no duplicates when they come again."""
    observer, other = observer_after_silence()[0], observer_after_silence()[0]
    late = [
        ImpactEvent(EPOCH + k * 10_000_000, (Switch("stop"),), 100 + k, epoch=EPOCH)
        for k in range(1, 5)
    ]
    work = observer.receiving(late)
    assert next(work) == []
    work.close()  # type: ignore[attr-defined]
    again = dict(chain.from_iterable(observer.receiving(late)))
    wanted = dict(chain.from_iterable(other.receiving(late)))
    assert [v[0].ruling for v in again.values()] == [v[0].ruling for v in wanted.values()]
    stamp = EPOCH + 9 * NS_PER_S
    assert observer.estimate(stamp).q.tobytes() == other.estimate(stamp).q.tobytes()
