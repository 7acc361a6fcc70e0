# SPDX-License-Identifier: Apache-2.0
"""The start of a fit to a recording of bounces that settle: the smoothed motion.

In bounces that settle, flights are as short as the stamps are wrong. A motion that is switched at
such stamps is far from any that explains the stamps: their order is wrong, and Gauss-Newton steps
from this motion fail. A filter takes one impact after the other, knows which were missed, and
finds parameters, state and instants on its way; smoothed, these are a start from which
the fit takes a few steps.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from impact_observer.errors import BagError, DynamicsError
from impact_observer.events import Contacts, ImpactEvent, Kind, Ruling
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.identify.recorded_impacts import Hit, Recording
from impact_observer.model.free_parameters import is_observed
from impact_observer.model.measurement import Measurement
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer.event_order import EventKey
from impact_observer.observer.samples import SensorSample
from impact_observer.options import Options, highest
from impact_observer.smooth import SmoothedMotion, smoothed_runs
from impact_observer.smooth.account import FLIGHTS
from impact_observer.stamps import from_seconds, seconds_between
from impact_observer.states import Vector

_CROWDED = 0.1
"""Share of hits that follow another at once from which on no fit can begin at the stamps."""


class SmoothedStart(NamedTuple):
    """The start of a fit.

    Attributes:
        recording: what each event was, with the instants of the moments.
        y: initial state and parameters, shape (2n + p,).
    """

    recording: Recording
    y: Vector


def is_crowded(recording: Recording, clock: float) -> bool:
    """Whether many hits follow another of their contact within a few errors of the clock, s."""
    last, hits, soon = dict[int, int](), 0, 0
    width = from_seconds(FLIGHTS * clock)
    for stamp, contacts in recording.hits():
        for i in contacts:
            hits += 1
            soon += i in last and stamp - last[i] < width
            last[i] = stamp
    return soon > _CROWDED * hits


def smoothed_start(
    family: ParametricFamily,
    recording: Recording,
    events: Sequence[ImpactEvent],
    clock: float,
    *,
    trust_events: bool = False,
    measurements: Sequence[Measurement] = (),
    samples: Sequence[SensorSample] = (),
    report: Callable[[str], None],
) -> SmoothedStart | None:
    """The smoothed motion of a recording, its parameters learned; None if the smoother fails.

    Args:
        family: the system and its free parameters.
        recording: its events, none rejected or inserted.
        events: the same events as an observer receives them, and perhaps others.
        clock: standard deviation of a stamp, s, about.
        trust_events: whether none is spurious, and none was missed.
        measurements: what sensors measure beside the impacts.
        samples: of these sensors.
        report: receives how far the smoothing is.

    Raises:
        UsageError: a sensor does not go with the system.
        ImpactLawError: the impact law has no solution at an event.
    """
    known = {(key.stamp, key.sequence) for key in recording.episode.keys}
    own = [each for each in events if (each.stamp, each.sequence) in known]
    end = recording.episode.keys[-1].stamp
    learned = tuple(each for each in family.parameters if is_observed(each.name))
    declared = min(clock, highest("clock_error"))
    options = Options(
        clock_error=declared,
        model_error=0.0,
        dead_time=recording.dead_time,
        mislabelled=recording.mislabelled,
    )
    if trust_events:
        options = replace(options, missed=0.0, spurious=0.0, mislabelled=0.0)
    try:
        *_, motion = smoothed_runs(
            family.system,
            own,
            options,
            measurements=measurements,
            samples=[each for each in samples if each.stamp <= end],
            progress=lambda what, done, total: report(f"{what} {done} of {total}"),
            unknowns=UnknownParameters.of(replace(family, parameters=learned), {})
            if learned
            else None,
            thorough=False,
        )
    except (BagError, DynamicsError):
        return None
    explained = _recording(recording, motion, family)
    as_smoothed = [(each.change.stamp, each.change.hit) for each in motion.account.moments]
    if explained.hits() != as_smoothed:
        return None
    values = {name: value for name, value, _ in motion.parameters}
    theta = [values.get(each.name, each.value) for each in family.parameters]
    state = motion.smoothed.first.mean[: 2 * family.system.n]
    return SmoothedStart(explained, np.concatenate([state, theta]))


def _recording(
    recording: Recording, motion: SmoothedMotion, family: ParametricFamily
) -> Recording:
    """The recording by the account of a smoothed motion, with its instants."""
    episode, account = recording.episode, motion.account
    index = {name: i for i, name in enumerate(family.system.contact_names)}
    keys, inserted = list[EventKey](), set[Hit]()
    instants = dict[tuple[float, Contacts], float]()
    for k, moment in enumerate(account.moments):
        change = moment.change
        keys.append(EventKey(change.stamp, change.sequence, tuple(sorted(change.switches))))
        t = seconds_between(episode.epoch, change.stamp)
        instants[t, change.hit] = t - motion.smoothed.instant(k)[0]
        if moment.is_inserted:
            inserted |= {(change.stamp, i) for i in change.hit}
    rejected = {
        (each.stamp, index[each.contact])
        for each in account.verdicts
        if each.ruling is Ruling.REJECTED and each.contact in index
    }
    used = {(key.stamp, i) for key in keys for i, _ in key.switches}
    struck = {
        (key.stamp, key.sequence): {i for i, kind in key.switches if kind is not Kind.OPEN}
        for key in keys
    }
    left_out, named = set[Hit](), dict[Hit, int]()
    for key in episode.keys:
        hits = {(key.stamp, i) for i, kind in key.switches if kind is not Kind.OPEN} - used
        others = struck.get((key.stamp, key.sequence), set()) - {i for i, _ in key.switches}
        if len(own := hits - rejected) == len(others) == 1:
            named[key.stamp, others.pop()] = own.pop()[1]
        left_out |= own
        false = tuple(each for each in key.switches if (key.stamp, each[0]) in hits & rejected)
        keys += [key._replace(switches=false)] if false else []
    return replace(
        recording.with_outliers(rejected, inserted),
        episode=episode._replace(keys=sorted(keys)),
        settled=frozenset(left_out),
        named=named,
        instants=instants,
    )
