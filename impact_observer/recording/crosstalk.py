# SPDX-License-Identifier: Apache-2.0
"""Sensors that notice the hits of another contact."""

from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from impact_observer.detector import Source
from impact_observer.detector.sensors import SignalTrace

_TOGETHER = 2_000_000
"""Time between impacts of two contacts within which one may be crosstalk, ns."""
_SHARE = 0.2
"""Share of a sensor's impacts that come with those of another one, which chance has not."""


def crosstalk(sources: Sequence[Source], traces: Sequence[SignalTrace]) -> Iterator[str]:
    """Yield a line on each sensor of which many impacts come with fewer ones of another sensor."""
    both = zip(sources, traces, strict=True)
    found = [(source.contact, np.sort(trace.impacts)) for source, trace in both]
    for (name, own), (other, fewer) in permutations(found, 2):
        if not fewer.size or fewer.size > own.size:
            continue
        after = np.searchsorted(fewer, own)
        sides = np.maximum(after - 1, 0), np.minimum(after, fewer.size - 1)
        near = np.stack([fewer[side] for side in sides])
        together = int(np.sum(np.min(np.abs(near - own), axis=0) <= _TOGETHER))
        if together > _SHARE * own.size:
            yield (
                f"{name}: {together} of {own.size} impacts come with one of {other}; if this is"
                f" crosstalk, raise the `threshold` of {name} in the file for --sources"
            )
