# SPDX-License-Identifier: Apache-2.0
"""Choice of the options with which a detector finds the impacts in a signal."""

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import special

from impact_observer.detector import Source
from impact_observer.detector.peak import RINGING
from impact_observer.errors import BagError, DynamicsError, ImpactLawError, UsageError
from impact_observer.model import Model
from impact_observer.plant import Plant
from impact_observer.stamps import NS_PER_S, from_seconds, seconds_between
from impact_observer.states import Stamps, Vector

_MOST = 400
"""Impacts of the model that are simulated."""
_SHORTEST = 0.1
"""Intervals between impacts that are shorter, relative to their median, are of one bunch."""
_SOFT = 0.1
"""Speed of an impact, over the fastest one of its contact, below which it is of a chatter."""
_QUANTILE = 0.05
"""Share of the intervals of the model that may be shorter than its shortest usual interval."""
_INTERVAL = 0.02
"""Shortest usual interval where the model tells none, s."""
_DEAD = 0.125
"""Dead time, relative to the shortest usual interval."""
_NOISE = 3.0
"""Least height of a peak, in standard deviations of the noise."""
_SILENT = 0.01
"""Least height of a peak over the largest one, where silence is exact."""
_QUIET = 0.2
"""Share of the windows, a dead time long each, that hold noise alone."""
_LOUD = 0.5
"""Least height of the peaks whose ringing is measured, relative to the largest one."""
_MARGIN = 1.25
"""Threshold in the ringing after a peak, over the usual ringing."""
_LEAST_FALL = 0.25
"""Least fall of the logarithm of a ringing within the shortest usual interval."""
_GAP = 1.25
"""Least ratio of heights of peaks that follow each other by size, which noise has not."""
_CLEAR = 0.75
"""Time after a peak with nothing but ringing, relative to the shortest usual interval."""
_PRIOR = 0.5
"""What the logarithm of impacts found over impacts expected costs, in logarithms of ratios."""
_SURPLUS = 1.25
"""Ratio of peaks above the noise and impacts expected up to which all of them are impacts."""
_ABOVE = 1.1
"""Threshold over the largest of as many samples of white noise."""
_RANGE = 2.0
"""Ratio, or inverse ratio, of impacts found and expected that leaves a doubt."""
_SHOWN = 2
"""Peaks that are kept as refused, for each impact."""
_BASELINE = 1.0
"""Time constant of the mean that is subtracted where the signal has an offset, s."""


@dataclass(frozen=True, slots=True)
class ExpectedImpacts:
    """Impacts as a model has them, when it is simulated.

    Attributes:
        interval: shortest usual interval between two impacts, s.
        rate: impacts a second; 0 of a motion that no force keeps going.
        soft: impacts a second that are too soft for ``rate``, and apart from others.
    """

    interval: float
    rate: float
    soft: float = 0.0


@dataclass(frozen=True, slots=True)
class SimulatedImpacts:
    """Impacts of a model: stamps, ns, and names of the contacts.

    Attributes:
        impacts: without the soft ones of a chatter.
        every: all impacts.
        seconds: for which the motion was simulated, s.
        is_driven: whether forces keep the motion going.
    """

    impacts: list[tuple[int, tuple[str, ...]]]
    every: list[tuple[int, tuple[str, ...]]]
    seconds: float
    is_driven: bool


def simulated_impacts(model: Model, seconds: float) -> SimulatedImpacts | None:
    """Simulate at most ``seconds`` and some hundred impacts; None where there is no such motion.

    The motion begins at the model's initial state, or at rest without one. There a gap may be
    negative, or the forcing may end.
    """
    system, rest = model.system, np.zeros(model.system.n)
    impacts, fastest = list[tuple[int, dict[str, float]]](), Counter[str]()
    try:
        start = (rest if x is None else x for x in (model.position, model.velocity))
        plant = Plant(system, *start, epoch=NS_PER_S)
        end = NS_PER_S + from_seconds(seconds)
        while len(impacts) < _MOST and (switching := plant.next_switching(end)) is not None:
            plant.cross(switching)
            speeds = (-system.contact_speeds(switching.before)).tolist()
            if hit := {system.contact_names[i]: speeds[i] for i in switching.contacts}:
                impacts.append((switching.instant.stamp, hit))
                fastest |= hit
    except (DynamicsError, ImpactLawError, UsageError):
        return None
    loud = [
        (stamp, names)
        for stamp, hit in impacts
        if (names := tuple(name for name, v in hit.items() if v >= _SOFT * fastest[name]))
    ]
    is_cut = len(impacts) == _MOST
    seconds = seconds_between(NS_PER_S, impacts[-1][0]) if is_cut else seconds
    every = [(stamp, (*hit,)) for stamp, hit in impacts]
    return SimulatedImpacts(loud, every, seconds, system.depends_on_time)


def expected_impacts(
    simulated: SimulatedImpacts | None, contacts: Collection[str]
) -> ExpectedImpacts | None:
    """Return the impacts of some contacts as a simulated model has them, None without any."""
    if simulated is None:
        return None
    loud, every = (
        np.array([stamp for stamp, names in impacts if {*contacts} & {*names}]) / NS_PER_S
        for impacts in (simulated.impacts, simulated.every)
    )
    loud = loud[loud.size // 4 :]
    intervals = np.diff(loud)
    usual = (
        intervals[intervals > _SHORTEST * np.median(intervals)] if intervals.size else intervals
    )
    if not usual.size:
        return None
    found = ExpectedImpacts(float(np.quantile(usual, _QUANTILE)), 0.0)
    if not simulated.is_driven:
        return found
    apart = np.diff(every[every >= loud[0]]) > usual_dead_time(found)
    seconds = float(intervals.sum())
    soft = max(int(np.sum(apart)) - usual.size, 0) / seconds
    return replace(found, rate=usual.size / seconds, soft=soft)


def usual_dead_time(expected: ExpectedImpacts | None) -> float:
    """Return a dead time by the impacts of the model, s; by hits 20 ms apart if unknown."""
    interval = _INTERVAL if expected is None else expected.interval
    return min(_DEAD * interval, _INTERVAL)


@dataclass(frozen=True, slots=True)
class ChosenSource:
    """A complete declaration of a peak sensor, with what remains in doubt.

    Attributes:
        source: the declaration; what was declared by the user is unchanged.
        refused: stamps of the highest peaks that are no impacts, ns, the highest first.
        doubts: why impacts may be missing or false, a line each.
    """

    source: Source
    refused: Stamps
    doubts: tuple[str, ...]


def choose_detection(
    source: Source, stamps: Stamps, values: Vector, expected: ExpectedImpacts | None
) -> ChosenSource:
    """Choose what a peak sensor does not declare: baseline, dead time, decay, instant, threshold.

    Peaks that ring are one bunch: the ringing after the loudest peaks gives its decay. The
    threshold stands at the largest ratio of neighbouring heights of bunches, where their number
    agrees with the model's.

    Args:
        source: the declaration, with None for what is to be chosen.
        stamps: of the samples, ns, ascending, shape (k,).
        values: of the signal, in its own unit, shape (k,).
        expected: the impacts of the model; None if unknown.

    Raises:
        BagError: no peak exceeds the noise.
    """
    t = (stamps - stamps[0]) / NS_PER_S
    offset = float(np.median(values))
    dead = usual_dead_time(expected) if source.dead_time is None else source.dead_time
    noise = _noise(t, np.abs(values - offset), dead)
    baseline = source.baseline
    if baseline is None:
        baseline = _BASELINE if abs(offset) > noise else 0.0
    signal = values - offset if baseline else values
    height = {"up": signal, "down": -signal}.get(source.direction or "both", np.abs(signal))
    top = float(np.max(height))
    floor = max(_NOISE * noise, _SILENT * top)
    loudest = max(_ABOVE * noise * float(np.sqrt(2 * np.log(t.size))), floor)
    interval = _INTERVAL if expected is None else expected.interval
    usual = np.sort(height[_peaks(t, height, noise, dead, 0.0)[1]])
    usual = usual[usual.size // 2 :]  # those of noise have no gap
    has_gap = source.threshold is not None or np.any(usual[1:] > _GAP * usual[:-1])
    if top <= (floor if has_gap else loudest):
        raise BagError(
            f"{source.contact}: no peak of {source.topic} differs from noise, which may reach"
            f" {loudest:.3g}; expected impacts, or their threshold in a file for --sources"
        )
    decay = source.decay
    if decay is None:
        decay = _decay(t, height, dead, interval, floor, loudest)
    doubts = list[str]()
    threshold = source.threshold
    if threshold is None:
        _, every = _peaks(t, height, floor, dead, decay)
        counts = None
        if expected is not None and expected.rate:
            rates = expected.rate, expected.rate + expected.soft
            counts = rates[0] * float(t[-1]), rates[1] * float(t[-1])
        threshold, doubt = _threshold(height[every], floor, loudest, counts)
        doubts += [f"{source.contact}: {doubt}"] if doubt else []
    begins, tops = _peaks(t, height, threshold, dead, decay)
    is_turned = np.any(signal[begins] * signal[tops] < 0)
    instant = source.instant or ("onset" if is_turned else "top")
    chosen = replace(
        source,
        threshold=_rounded(threshold),
        baseline=baseline,
        dead_time=_rounded(dead),
        decay=_rounded(decay),
        instant=instant,
    )
    others = np.setdiff1d(_peaks(t, height, floor, dead, 0.0)[1], tops)
    refused = others[np.argsort(-height[others])][: _SHOWN * tops.size]
    return ChosenSource(chosen, stamps[refused], tuple(doubts))


def _peaks(
    t: Vector, height: Vector, threshold: float, dead: float, decay: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of onsets and tops of peaks, as ``PeakSensor`` finds them."""
    begins, tops = list[int](), list[int]()
    above = np.flatnonzero(height >= threshold)
    at = 0
    while at < above.size:
        begin = int(above[at])
        end = int(np.searchsorted(t, t[begin] + dead, side="right"))
        top = begin + int(np.argmax(height[begin : max(end, begin + 1)]))
        begins.append(begin)
        tops.append(top)
        at = int(np.searchsorted(above, max(end, begin + 1)))
        while decay and at < above.size:
            some = above[at : at + 256]
            ringing = RINGING * height[top] * np.exp(-(t[some] - t[top]) / decay)
            louder = np.flatnonzero(height[some] >= np.hypot(threshold, ringing))
            at += int(louder[0]) if louder.size else some.size
            if louder.size:
                break
    return np.array(begins, dtype=np.intp), np.array(tops, dtype=np.intp)


def _noise(t: Vector, size: Vector, dead: float) -> float:
    """Return the deviation of white noise whose peaks are as high as those of the quiet parts."""
    count = int(np.clip(dead * t.size / (float(t[-1]) or 1.0), 1, t.size))
    parts = size[: t.size // count * count].reshape(-1, count)
    usual = special.ndtri((1 + _QUIET ** (1 / count)) / 2)  # not exceeded in a quiet part
    return float(np.quantile(np.max(parts, axis=1), _QUIET) / usual)


def _decay(  # noqa: PLR0917
    t: Vector, height: Vector, dead: float, interval: float, floor: float, loudest: float
) -> float:
    """Return the time constant of the ringing after the loudest peaks, s; 0 without ringing.

    The threshold of ``PeakSensor`` stands above the usual ringing up to the next impact, and then
    falls no faster than that.
    """
    _, tops = _peaks(t, height, _LOUD * float(np.max(height)), dead, 0.0)
    tops = tops[t[tops] + interval <= t[-1]]
    lags = np.linspace(dead, _CLEAR * interval, 1 + round(2 / _DEAD))[:-1]
    if not tops.size or not _CLEAR * interval > dead:
        return 0.0
    edges = np.searchsorted(t, t[tops, None] + np.append(lags, _CLEAR * interval))
    left = np.array(
        [[np.max(height[a:b], initial=0.0) for a, b in pairwise(each)] for each in edges.tolist()]
    )
    loud = float(np.median(height[tops]))
    usual = np.median(left / height[tops, None], axis=0)
    rings = (_MARGIN * usual < RINGING) & (usual * loud > floor)
    decay = float(np.max(lags[rings] / np.log(RINGING / _MARGIN / usual[rings]), initial=0.0))
    if np.sum(fades := usual * loud > loudest) > 1:
        slope, _ = np.polyfit(lags[fades], np.log(usual[fades]), 1)
        decay = max(decay, -1 / slope) if -slope * interval > _LEAST_FALL else decay
    return decay


def _threshold(
    heights: Vector, floor: float, loudest: float, counts: tuple[float, float] | None
) -> tuple[float, str]:
    """Return the threshold between impacts and other peaks, and why it is in doubt, if it is.

    Args:
        heights: of all peaks above ``floor`` that are no ringing.
        floor: least height of a peak.
        loudest: height up to which a peak may be noise.
        counts: least and largest number of impacts that the model expects; None if unknown.
    """
    falling = np.append(np.sort(heights)[::-1], floor)
    number = np.arange(1, falling.size)
    score = np.log(falling[:-1] / falling[1:])
    least, most = counts or (1.0, np.inf)
    score -= _PRIOR * np.abs(np.log(number / np.clip(number, least, most)))
    k, above = int(np.argmax(score)), int(np.sum(heights > loudest))
    if above and (counts is None or least / _RANGE <= above <= most * _SURPLUS):
        k = above - 1
    doubt = ""
    if counts is not None and not least / _RANGE <= number[k] <= most * _RANGE:
        doubt = f"{number[k]} impacts found, about {least:.0f} expected of the model"
    return float(np.sqrt(falling[k] * falling[k + 1])), doubt


def _rounded(x: float) -> float:
    """Return ``x`` with three digits, as an option is typed."""
    return float(f"{x:.3g}")
