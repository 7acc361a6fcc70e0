# SPDX-License-Identifier: Apache-2.0
"""Choice of what a contact switch does not declare: its threshold, and which level is closed."""

from dataclasses import replace

import numpy as np

from impact_observer.detector.source import SWITCH, Source
from impact_observer.states import Stamps, Vector

_LEVEL = 0.2
"""Width of a level of a switch with its noise, over the range of the signal."""


def is_switch(source: Source, values: Vector) -> bool:
    """Whether the signal of a sensor has two levels: few samples lie between them.

    A short pulse of a force has more samples on its flanks than at its top. A kind that is
    declared counts; a threshold without a kind makes a peak.
    """
    if source.kind or source.threshold is not None:
        return source.kind == SWITCH
    low, high = float(np.min(values)), float(np.max(values))
    width = _LEVEL * (high - low)
    at_low, at_high = np.sum(values <= low + width), np.sum(values >= high - width)
    return high > low and bool(2 * (values.size - at_low - at_high) < min(at_low, at_high))


def choose_switch(source: Source, stamps: Stamps, values: Vector) -> Source:
    """Choose what a switch does not declare: threshold and ``inverted``.

    Contacts are shorter than flights, so the level that is usually held for a shorter time is the
    closed one.

    Args:
        source: the declaration, with None for what is to be chosen.
        stamps: of the samples, ns, ascending, shape (k,).
        values: of the signal, shape (k,).
    """
    if np.ptp(values) == 0:
        return source
    threshold = source.threshold
    if threshold is None:
        threshold = float(np.min(values) + np.max(values)) / 2
    is_high = values >= threshold
    begins = np.flatnonzero(np.diff(is_high, prepend=~is_high[:1]))
    lengths = np.diff(np.append(stamps[begins], stamps[-1]))
    high, low = lengths[is_high[begins]], lengths[~is_high[begins]]
    inverted = source.inverted
    if inverted is None:
        inverted = bool(high.size and low.size and np.median(high) > np.median(low))
    return replace(source, kind=SWITCH, threshold=threshold, inverted=inverted)
