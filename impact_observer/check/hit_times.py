# SPDX-License-Identifier: Apache-2.0
"""Whether the times of impacts suit a model and a filter: wrong units, bounces that settle."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from impact_observer.check.hertz import frequencies_in_hertz
from impact_observer.check.undamped_modes import UndampedModes
from impact_observer.draw.reports import counted
from impact_observer.errors import BagError
from impact_observer.events import ImpactEvent, Kind
from impact_observer.io import interfaces
from impact_observer.io.reader import BagReader
from impact_observer.model import System
from impact_observer.model.robot_description import RobotDescription
from impact_observer.stamps import LATE_EPOCH, NS_PER_S, odd_epoch, seconds_between
from impact_observer.states import Vector

FAST = 5_000_000
"""Interval of two hits of a contact below which the contact may be bouncing, ns: the dead time
of a switch in the detector."""
_MANY, _SHARE = 50, 0.25
"""Least number of fast hits, and least share of all hits, that count as settling bounces."""
_PERIODS = 30.0
"""Periods of the slowest motion that may pass between two impacts, as a rule."""
_HOPELESS = 3.0
"""Factor of ``longest_interval`` above which no filter is tried."""
_SPEED = 30.0
"""Fastest speed at which a flight under a constant force may begin, as a rule, m/s."""
_VAGUE = 0.1
"""Least clock error that is doubted, in median times between impacts."""
_UNITS = (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
_ENOUGH = 5000
"""First events of a bag that are looked at."""


class HitTimes:
    """The times between impacts, in constant memory.

    Attributes:
        hits: impacts and closings.
        fast: hits that follow another hit of the same contact in less than ``FAST``.
        early: events of hits that are stamped before their epoch.
        odd_epoch: a doubt about the epoch of the first hit; empty without a doubt.
    """

    def __init__(self, events: Iterable[ImpactEvent] = ()) -> None:
        """Begin with some ``events``."""
        self.hits = self.fast = self.early = 0
        self.odd_epoch = ""
        self._last, self._of_contact = 0, dict[str, int]()
        self._lengths = Counter[int]()
        self._zero, self._times = 0, defaultdict[str, list[float]](list)
        for each in events:
            self.add_event(each)

    def add_event(self, event: ImpactEvent) -> None:
        """Add an event.

        The first event of another run of the sender has no predecessor.
        """
        hit = [each.contact for each in event.switches if each.kind is not Kind.OPEN]
        if not hit:
            return
        if not self.hits:
            self.odd_epoch = odd_epoch(event.epoch, event.stamp)
            self._zero = event.stamp
        self.early += event.stamp < event.epoch
        if 0 < self._last < event.stamp:
            self._lengths[(event.stamp - self._last).bit_length()] += 1
        for contact in hit:
            if self.hits < _ENOUGH:
                since = seconds_between(event.epoch or self._zero, event.stamp)
                self._times[contact].append(since)
            self.hits += 1
            self.fast += 0 < event.stamp - self._of_contact.get(contact, 0) < FAST
            self._of_contact[contact] = event.stamp
        self._last = event.stamp

    @property
    def median(self) -> float:
        """Median time between impacts of any contacts, s; 0 without impacts.

        The median is rounded down, by less than half.
        """
        half = self._lengths.total() / 2
        for length in sorted(self._lengths):
            half -= self._lengths[length]
            if half <= 0:
                return float(2 ** (length - 1)) / NS_PER_S
        return 0.0

    @property
    def most_hit(self) -> Vector:
        """Times since the epoch of the first hits of the contact that is hit most often, s."""
        return np.array(max(self._times.values(), key=len, default=[]))


def doubts(
    bag: Path,
    times: HitTimes,
    system: System | RobotDescription,
    *,
    has_covariance: bool,
    clock_error: float = 0.0,
) -> Iterator[str]:
    """Warnings about times of impacts that are unlikely for a model or costly for a filter.

    Args:
        bag: path of the bag with the impacts.
        times: times of the impacts.
        system: the model.
        has_covariance: whether a filter is to use the impacts. A filter takes longer with bounces,
            and with the impacts that the filter inserts in a long silence.
        clock_error: declared for the filter, s.

    Raises:
        BagError: far more time passes between impacts than the model makes likely, and a filter
            is to use the impacts.
    """
    if line := too_slow(times, system):
        if has_covariance and times.median > _HOPELESS * longest_interval(system):
            raise BagError(f"{bag}: {line} Nothing is estimated: it would take long and be wrong")
        yield line
    if times.odd_epoch:
        yield times.odd_epoch
    elif times.early:
        yield f"{counted(times.early, 'event')} stamped before the epoch: {LATE_EPOCH}"
    if has_covariance and (line := settling(times)):
        yield line
    if isinstance(system, System):
        yield from in_hertz(times, system)
    below = 2 * times.median
    if has_covariance and 0 < _VAGUE * below < clock_error:
        yield (
            f"a clock error of {clock_error:g} s is declared, and half of the times between"
            f" impacts are below {below:.2g} s: such stamps hardly say which impact is which;"
            " --clock-error is the standard deviation of a stamp in s, and is estimated if it is"
            " left out"
        )


def first_times(reader: BagReader, epoch: int) -> HitTimes:
    """The times of the first impacts of a bag; ``epoch`` (ns) is that of events without one."""
    topic = reader.find(interfaces.IMPACTS)
    events = () if topic is None else islice(reader.events(topic), _ENOUGH)
    return HitTimes(replace(each, epoch=each.epoch or epoch) for each in events)


def settling(times: HitTimes) -> str:
    """The remedy for many hits that are settling bounces; empty for other hits."""
    if times.fast < _MANY or times.fast <= _SHARE * times.hits:
        return ""
    return (
        f"{times.fast} of the first {times.hits} hits follow another in less than"
        f" {FAST / 1e6:g} ms, as bounces that settle: where stamps have errors, minimum-variance"
        " takes milliseconds each."
        " geometric is fast. So is keeping the first of each row (dead_time of the detector,"
        f" --dead-time {FAST / NS_PER_S:g} of simulate), if the observer"
        " is given that dead time too (--dead-time)"
    )


def in_hertz(times: HitTimes, system: System) -> Iterator[str]:
    """A warning for each frequency of a model that is probably in Hz.

    Where live signals or samples force a rig, nothing is said: they may make the impacts.
    """
    moving = [system.own_forcing, *([] if system.frame is None else [system.frame.grounds.motion])]
    if system.live is not None or any(each.sampled is not None for each in moving):
        return
    harmonics = [each.frequency[np.any([*each.cosine.T, *each.sine.T], axis=0)] for each in moving]
    for omega in frequencies_in_hertz(times.most_hit, np.unique(np.concatenate(harmonics))):
        right = math.tau * omega
        yield (
            f"a frequency of the model {system.name} is {omega:g} rad/s, but impacts are coherent"
            f" with 2 pi times this number, {right:.6g} rad/s, and with no multiple of {omega:g}"
            f" rad/s: if {omega:g} is in Hz, write {right:.12g}"
        )


def too_slow(times: HitTimes, system: System | RobotDescription) -> str:
    """A warning if impacts come far less often than the model makes likely; empty otherwise."""
    longest, median = longest_interval(system), times.median
    if median <= longest:
        return ""
    unit = next((name for name, size in _UNITS if size * median <= longest), "")
    remedy = f"are the times in {unit} (import --time-unit {unit}), or is" if unit else "is"
    return (
        f"more than {median:.2g} s pass between impacts; by its frequencies and constant forces"
        f" the model {system.name} makes less than {longest:.2g} s likely: {remedy} it the"
        " model of another rig?"
    )


def longest_interval(system: System | RobotDescription) -> float:
    """Longest likely time between impacts, s; infinite if the model does not bound the time.

    The time is 30 periods of the slowest mode or excitation. If bodies fly, the time is at least
    the duration of a flight under their constant forces that begins at 30 m/s. Robots have none.
    """
    if isinstance(system, RobotDescription):
        return math.inf
    if system.live is not None or system.forcing.sampled is not None:
        return math.inf
    modes = UndampedModes.of_system(system)
    frequencies = [*np.sqrt(modes.squares), *system.forcing.frequency]
    periods = [2 * math.pi / each for each in frequencies if each > 0]
    longest = _PERIODS * max(periods, default=0.0)
    if modes.rigid.size:
        pull = np.abs(modes.gap_acceleration(system))
        if not np.any(pull > 0):
            return math.inf
        longest = max(longest, 2 * _SPEED / float(np.max(pull)))
    return longest or math.inf
