# SPDX-License-Identifier: Apache-2.0
"""The moments of a recording: the instants at which contacts switch, by an account."""

from collections.abc import Hashable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import DynamicsError
from impact_observer.events import Contacts
from impact_observer.stamps import Elapsed
from impact_observer.states import Vector

Indices = NDArray[np.intp]
Key = TypeVar("Key", bound=Hashable)


class MomentSwitching(NamedTuple):
    """What the contacts do at a moment.

    Attributes:
        hit: contacts that impact or close; empty where contacts only open.
        pressed: contacts that take an impulse.
        before: contacts that are closed until the moment.
        held: contacts that are closed from the moment on.
    """

    hit: Contacts
    pressed: Contacts
    before: Contacts = ()
    held: Contacts = ()


class Moment(NamedTuple):
    """An instant at which contacts switch.

    Attributes:
        t: the stamp, s since the epoch.
        switching: what the contacts do.
        is_measured: whether the moment has a stamp; else the moment is a missed detection.
        stamp: of the event, ns.
        sequence: of the event; 0 without an event, or if the sender does not count.
    """

    t: Elapsed
    switching: MomentSwitching
    is_measured: bool = True
    stamp: int = 0
    sequence: int = 0


class Moments:
    """The K moments of one run of the sender, in order, with R measured gaps.

    Attributes:
        start: where the initial state holds, s since the epoch.
        each: the moments.
        starts: where each flight begins, s since the epoch.
        flights: durations of the flights before the moments, shape (K,), s.
        row_moment: moment of each measured gap, shape (R,).
        row_contact: contact of each measured gap, shape (R,).
        first_row: first measured gap of each moment, shape (K,).
    """

    def __init__(self, start: Elapsed, each: Sequence[Moment]) -> None:
        """Take the moments after ``start``; the first one may be at ``start``.

        Raises:
            DynamicsError: there are none.
        """
        if not each:
            raise DynamicsError("no motion of the model has any of these impacts (times in s)")
        self.start, self.each = start, tuple(each)
        self.starts = (start, *(one.t for one in self.each[:-1]))
        flown = [one.t - t for one, t in zip(self.each, self.starts, strict=True)]
        self.flights: Vector = np.array(flown)
        rows = [
            (k, i) for k, one in enumerate(self.each) if one.is_measured for i in one.switching.hit
        ]
        self.row_moment: Indices = np.array([k for k, _ in rows], dtype=np.intp)
        self.row_contact: Indices = np.array([i for _, i in rows], dtype=np.intp)
        self.first_row: Indices = np.searchsorted(self.row_moment, np.arange(len(self.each)))

    def missed(self, dead_time: float) -> Indices:
        """Contacts of the missed detections that a sensor could have reported, shape (any,).

        For ``dead_time`` seconds after an event the sensor reports no other of the contact.
        """
        reported, found = dict[int, Elapsed](), list[int]()
        for moment in self.each:
            for i in moment.switching.hit:
                if moment.is_measured:
                    reported[i] = moment.t
                elif i not in reported or moment.t - reported[i] >= dead_time:
                    found.append(i)
        return np.array(found, dtype=np.intp)

    @property
    def count(self) -> int:
        """Number of moments."""
        return len(self.each)


def grouped(keys: Sequence[Key]) -> dict[Key, Indices]:
    """Positions in a sequence, by what stands there."""
    found = dict[Key, list[int]]()
    for k, key in enumerate(keys):
        found.setdefault(key, []).append(k)
    return {key: np.array(own, dtype=np.intp) for key, own in found.items()}
