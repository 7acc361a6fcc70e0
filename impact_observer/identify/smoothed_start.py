# SPDX-License-Identifier: Apache-2.0
"""The start of a fit where a fit of all impacts as reported explains nothing: the smoothed motion.

With parameters that are wrong and impacts that were missed, a search for outliers rejects right
impacts. In bounces that settle, flights are as short as the stamps are wrong: the order of stamps
is wrong, and Gauss-Newton steps from a motion that is switched at such stamps fail. A filter takes
one impact after the other, finds missed detections and false positives, parameters, state and
instants on its way; smoothed, these are a start from which the fit takes a few steps.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from impact_observer.errors import BagError, DynamicsError
from impact_observer.events import Contacts, ImpactEvent, Kind, Ruling
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.identify.first_guess import state_of_least_gaps
from impact_observer.identify.recorded_impacts import Hit, Recording
from impact_observer.model import System
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
_BEGINNING = 12
"""Events that are smoothed first; then half as many more each time, if a motion explains them."""
_OF_A_FLIGHT = 8
"""Samples of a sensor in the time between two events that are enough for a start."""


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


def enough_samples(samples: Sequence[SensorSample], events: int) -> list[SensorSample]:
    """Evenly chosen samples of each sensor, as many as a start needs between two of ``events``.

    The fit from the start uses all samples. Of a sample the filter takes a hundred times as long.
    """
    kept = list[SensorSample]()
    for sensor in sorted({each.sensor for each in samples}):
        own = [each for each in samples if each.sensor == sensor]
        kept += own[:: max(len(own) // (_OF_A_FLIGHT * max(events, 1)), 1)]
    return sorted(kept, key=lambda each: each.stamp)


def smoothed_start(
    family: ParametricFamily,
    recording: Recording,
    events: Sequence[ImpactEvent],
    clock: float | None,
    widest: float,
    *,
    change: Vector,
    share: float = 1.0,
    trust_events: bool = False,
    measurements: Sequence[Measurement] = (),
    samples: Sequence[SensorSample] = (),
    report: Callable[[str], None],
) -> SmoothedStart | None:
    """The smoothed motion of a recording, its parameters learned; None if the smoother fails.

    More and more events are smoothed, since to smooth events that no motion explains takes a
    hundred times as long as to smooth others.

    Args:
        family: the system and its free parameters.
        recording: its events, none rejected or inserted.
        events: the same events as an observer receives them, and perhaps others.
        clock: standard deviation of a stamp, s, about; None to learn it.
        widest: usual distance of stamps from the motion above which the motion is no start, s.
        change: of the family's values, at which the filter begins, shape (p,).
        share: of the usual deviations, how far each parameter may be from its given value.
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
    learned = tuple(each for each in family.parameters if is_observed(each.name))
    declared = -1.0 if clock is None else min(clock, highest("clock_error"))
    system, unknowns = family.system_at(family.nominal + change), None
    if learned:
        usual = UnknownParameters.of(
            ParametricFamily(system, learned), {}, uncertainty=recording.prior
        )
        unknowns = replace(usual, covariance=usual.covariance * share**2)
    options = Options(
        clock_error=declared,
        model_error=0.0,
        dead_time=recording.dead_time,
        mislabelled=recording.mislabelled,
    )
    if trust_events:
        options = replace(options, missed=0.0, spurious=0.0, mislabelled=0.0)

    def smoothed(count: int) -> SmoothedMotion | None:
        """The smoothed motion of the first events, if there is one."""
        first = own[:count]
        try:
            *_, motion = smoothed_runs(
                system,
                first,
                options,
                measurements=measurements,
                samples=[each for each in samples if each.stamp <= first[-1].stamp],
                progress=lambda what, done, total: report(f"{what} {done} of {total}"),
                unknowns=unknowns,
                thorough=False,
            )
        except (BagError, DynamicsError):
            return None
        return motion

    count = min(_BEGINNING, len(own))
    motion = smoothed(count)
    while motion is not None and count < len(own):
        if _shift_of(motion) > widest:
            return None
        count = min(count + count // 2, len(own))
        motion = smoothed(count)
    if motion is None:
        return None
    explained = _recording(recording, motion, family)
    as_smoothed = [(each.change.stamp, each.change.hit) for each in motion.account.moments]
    if explained.hits() != as_smoothed:
        return None
    values = {name: value for name, value, _ in motion.parameters}
    found = change + [values.get(each.name, each.value) for each in family.parameters]
    theta: Vector = np.clip(found, *family.bounds)
    state = motion.smoothed.first.mean[: 2 * family.system.n]
    if early := first_hits_from_inside(explained, family.system_at(theta), state):
        explained = explained.with_outliers(explained.rejected - early, explained.inserted)
        at_rest = np.concatenate([np.zeros_like(state), theta])
        return SmoothedStart(explained, state_of_least_gaps(explained.problem(family), at_rest)[0])
    return SmoothedStart(explained, np.concatenate([state, theta]))


def first_hits_from_inside(recording: Recording, system: System, state: Vector) -> set[Hit]:
    """The first hits, if rejected, of the stops inside which a motion begins.

    The filter rejects a first hit that its prior makes improbable. The motion that is left passes
    the stop from inside at the instant of this hit.

    Args:
        recording: as the smoothed motion explains the events.
        system: of the model.
        state: (q, u) of the motion at the start, shape (2n,).
    """
    inside = system.penetrated(state[: system.n])
    first = min((stamp for stamp, contacts in recording.hits() if contacts), default=0)
    return {hit for hit in recording.rejected if hit[1] in inside and hit[0] < first}


def _shift_of(motion: SmoothedMotion) -> float:
    """The median distance of the stamps of reported impacts from a motion, s."""
    reported = [k for k, each in enumerate(motion.account.moments) if not each.is_inserted]
    return float(np.median([abs(motion.smoothed.instant(k)[0]) for k in reported]))


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
