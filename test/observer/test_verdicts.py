# SPDX-License-Identifier: Apache-2.0
"""Verdicts on true, spurious, missed and mislabelled impacts, and their revisions."""

from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from systems import EPOCH, observer, run, sample

from impact_observer.events import ImpactEvent, Remark, Ruling, Switch, Verdict
from impact_observer.model import System
from impact_observer.observer import Observer
from impact_observer.observer.event_outcomes import outcomes_of
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
NEAR = 2
"""How near to its true stamp a missed impact is inserted in the end, ns."""
MOVED = 2000
"""By which an inserted impact may move without a revised verdict, ns."""
Rulings = dict[tuple[int, int, str], Ruling]


@cache
def truth(name: str, seconds: float) -> tuple[System, Array, Run]:
    """A sample, where its plant starts, and what it does."""
    model = sample(name)
    start = model.initial_state()
    whole = run(model.system, *start, seconds=seconds, rate=1.0)
    return model.system, np.concatenate(start), whole


def with_faults(
    events: Sequence[ImpactEvent],
    seed: int,
    *,
    names: tuple[str, ...],
    missed: float = 0.0,
    rate: float = 0.0,
    since: float = 0.0,
    until: float,
) -> tuple[list[ImpactEvent], set[int]]:
    """Events with faults, and the numbers of the spurious ones; none before ``since``, s."""
    rng = np.random.default_rng(seed)
    late = EPOCH + round(since * NS_PER_S)
    kept = [
        (each.stamp, each.switches, False)
        for each in events
        if rng.random() >= missed or each.stamp < late
    ]
    for at in rng.uniform(since, until, rng.poisson(rate * (until - since))).tolist():
        stamp, name = EPOCH + round(at * NS_PER_S), names[rng.integers(len(names))]
        kept.append((stamp, (Switch(name),), True))
    ordered = sorted(kept, key=lambda each: each[0])
    reported = [ImpactEvent(s, w, k + 1, 0, EPOCH) for k, (s, w, _) in enumerate(ordered)]
    return reported, {k + 1 for k, (_, _, wrong) in enumerate(ordered) if wrong}


def watching(name: str, seconds: float, seed: int, **declared: float) -> Observer:
    """An observer with a wrong initial state."""
    model, start, _ = truth(name, seconds)
    x = start + np.random.default_rng(seed).normal(size=start.size)
    everything: dict[str, Any] = {"clock_error": 0.0, **declared}
    uncertainty = Uncertainty(**everything)
    return observer(
        model, "minimum-variance", x, uncertainty=uncertainty, epoch=EPOCH, history=1e4
    )


def final(verdicts: Iterable[Verdict]) -> Rulings:
    """The last ruling on everything, without insertions that were withdrawn."""
    last = {
        (each.stamp, each.sequence, each.contact): each.ruling
        for each in verdicts
        if each.ruling is not Ruling.DUPLICATE
    }
    return {k: ruling for k, ruling in last.items() if k[1] or ruling is Ruling.INSERTED}


def likeliest(watcher: Observer) -> Rulings:
    """The same, by the likeliest hypothesis after the last event."""
    assert watcher.timeline is not None
    notes = watcher.timeline.entries[-1].belief.noted
    names = watcher.system.contact_names
    return {
        (n.stamp, 0 if n.is_inserted else n.event[1], names[n.contact]): n.ruling for n in notes
    }


LOCKED = {"two_mass": 12.0, "three_mass": 14.0}
"""When the estimate has converged, s."""


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("two_mass", 1),
        pytest.param("two_mass", 2, marks=pytest.mark.slow),
        pytest.param("three_mass", 1, marks=pytest.mark.slow),
    ],
)
def test_rulings_are_right_once_the_estimate_has_converged(name: str, seed: int) -> None:
    """Spurious: rejected. True: applied. Missed: inserted where it was, within 2 ns."""
    seconds, since = 30.0, LOCKED[name]
    model, _, whole = truth(name, seconds)
    reported, spurious = with_faults(
        whole.events,
        seed,
        names=model.contact_names,
        missed=0.2,
        rate=0.25,
        since=since,
        until=seconds,
    )
    watcher = watching(name, seconds, seed)
    rulings = final(verdict for each in reported for verdict in watcher.receive(each))
    late = EPOCH + round(since * NS_PER_S)
    keys = [key for key in rulings if key[1] and key[0] >= late]
    assert len(spurious) >= 2
    for key in keys:
        assert rulings[key] is (Ruling.REJECTED if key[1] in spurious else Ruling.APPLIED)
    stamps = {each.stamp for each in reported if each.sequence not in spurious}
    missed = [
        (each.stamp, switch.contact)
        for each in whole.events
        for switch in each.switches
        if each.stamp not in stamps and each.stamp < reported[-1].stamp
    ]
    inserted = sorted((key[0], key[2]) for key in rulings if not key[1] and key[0] >= late)
    assert missed
    assert [contact for _, contact in inserted] == [contact for _, contact in missed]
    differences = [found - true for (found, _), (true, _) in zip(inserted, missed, strict=True)]
    assert np.max(np.abs(differences)) <= NEAR


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_mislabelled_impacts_are_named_once_the_estimate_has_converged(seed: int) -> None:
    """The verdict on an impact of another contact is APPLIED and names that contact."""
    _, _, whole = truth("three_mass", 30.0)
    rng = np.random.default_rng(seed)
    watcher, wrong, rulings = watching("three_mass", 30.0, seed), {}, {}
    for each in whole.events:
        (switch,) = each.switches
        if each.stamp > EPOCH + 14 * NS_PER_S and rng.random() < 0.4:
            wrong[each.sequence] = switch.contact
            other = "left" if switch.contact == "right" else "right"
            switch = Switch(other)
        reported = ImpactEvent(each.stamp, (switch,), each.sequence, 0, EPOCH)
        for verdict in watcher.receive(reported):
            rulings[verdict.sequence] = verdict
    assert len(wrong) >= 2
    rulings.pop(0, None)  # what was inserted at first
    named = [
        verdict.ruling is Ruling.APPLIED
        and verdict.reason.removeprefix("revised: ").startswith(
            f"mislabelled: it hit {wrong[sequence]}" if sequence in wrong else ""
        )
        for sequence, verdict in rulings.items()
    ]
    assert np.mean(named) > 0.9


def assert_same(one: Rulings, other: Rulings) -> None:
    """The same rulings; stamps of inserted impacts may differ a little."""
    for found, wanted in zip(sorted(one.items()), sorted(other.items()), strict=True):
        (stamp, *rest), ruling = found
        assert (*rest, ruling) == (*wanted[0][1:], wanted[1])
        assert abs(stamp - wanted[0][0]) <= (0 if rest[0] else MOVED)


@cache
def run_of(seed: int, *, late: bool = False) -> tuple[Observer, list[ImpactEvent], list[Verdict]]:
    """Twelve seconds of two_mass from a certain start, with faults from the first impact on."""
    _, _, whole = truth("two_mass", 30.0)
    events = [each for each in whole.events if each.stamp < EPOCH + 12 * NS_PER_S]
    reported, _ = with_faults(events, seed, names=("stop",), missed=0.25, rate=0.2, until=12.0)
    if late:
        reported.append(reported.pop(len(reported) // 2))
    watcher = watching("two_mass", 30.0, seed)
    return watcher, reported, [verdict for each in reported for verdict in watcher.receive(each)]


@pytest.mark.slow
@pytest.mark.parametrize("late", [False, True])
def test_last_verdicts_are_those_of_the_likeliest_hypothesis(late: bool) -> None:
    """On every event and on every insertion, also with late events."""
    for seed in range(3):
        watcher, _, verdicts = run_of(seed, late=late)
        assert_same(final(verdicts), likeliest(watcher))


@pytest.mark.slow
def test_revised_verdict_says_so_and_is_counted() -> None:
    """By ``revises`` and its reason; ``remarks`` counts revisions."""
    count = 0
    for seed in range(3):
        watcher, _, verdicts = run_of(seed)
        issued: dict[tuple[int, int], Verdict] = {}
        for each in verdicts:
            key = (each.stamp, each.sequence)
            assert each.revises == each.reason.startswith("revised: ")
            if each.revises and each.ruling is not Ruling.INSERTED:
                assert each.ruling is not issued[key].ruling or each.reason != issued[key].reason
            issued[key] = each
        revised = sum(each.revises for each in verdicts)
        assert watcher.remarks[Remark.REVISED] == revised
        count += revised
    assert count > 0


@pytest.mark.slow
def test_outcomes_are_those_of_the_final_verdicts() -> None:
    """``outcomes_of`` goes by the last verdict on each event and on what was inserted."""
    differs = 0
    for seed in range(3):
        _, _, verdicts = run_of(seed)
        used = {key[0] for key, ruling in final(verdicts).items() if ruling is not Ruling.REJECTED}
        assert outcomes_of((), verdicts).instants.tolist() == sorted(used)
        first = {
            each.stamp for each in verdicts if each.ruling in (Ruling.APPLIED, Ruling.INSERTED)
        }
        differs += first != used
    assert differs > 0


def test_no_verdict_is_issued_twice() -> None:
    """In a long run with a short history: each event has one verdict, except revisions."""
    model, start, whole = truth("two_mass", 60.0)
    watcher = observer(
        model,
        "minimum-variance",
        start,
        uncertainty=Uncertainty(clock_error=0.0),
        epoch=EPOCH,
        history=2.0,
    )
    verdicts = [verdict for each in whole.events for verdict in watcher.receive(each)]
    assert len(verdicts) == len(whole.events)
    assert not any(each.revises for each in verdicts)


@pytest.mark.parametrize("history", [2.5, 3.0, 6.0])
def test_late_event_repeats_no_verdict_on_the_forgotten_past(history: float) -> None:
    """Its verdicts reach no further back than the history."""
    model, start, whole = truth("two_mass", 20.0)
    given = {"uncertainty": Uncertainty(clock_error=0.0), "epoch": EPOCH, "history": history}
    watcher = observer(model, "minimum-variance", start, **given)
    events = [*whole.events]
    events[8:11] = [*events[9:11], events[8]]
    verdicts = [verdict for each in events for verdict in watcher.receive(each)]
    assert watcher.remarks[Remark.LATE] == 1
    first = [each.sequence for each in verdicts if each.sequence and not each.revises]
    assert first == [each.sequence for each in events]


def test_verdict_on_an_applied_impact_has_its_innovation() -> None:
    """In standard deviations, small where it was applied; -1 for what was inserted."""
    _, _, verdicts = run_of(1)
    for each in verdicts:
        if each.ruling is Ruling.APPLIED and not each.reason:
            assert 0 <= each.innovation < 6
        elif each.ruling is Ruling.INSERTED:
            assert each.innovation == -1
