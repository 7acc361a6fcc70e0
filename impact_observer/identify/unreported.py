# SPDX-License-Identifier: Apache-2.0
"""Rows of bounces of which a sensor reports the first edge alone.

A debounced switch reports no hit within its dead time, and a contact that bounces until it rests
as one closing. A motion that is switched at such events alone rests where the rig bounces. So the
bounces are put in as the plant makes them, from the first edge on: until the dead time ends, or
until the contact rests and, where no opening is reported, opens again. A motion that is fitted to
events and bounces gives better bounces, and so on.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from impact_observer.dynamics import Phases
from impact_observer.events import Contacts, Kind
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.tuning import TUNING
from impact_observer.identify.problem import Problem, Solution
from impact_observer.identify.recorded_impacts import NEAR, Hit, Recording
from impact_observer.model import System
from impact_observer.observer.event_order import EventKey
from impact_observer.plant import Plant
from impact_observer.stamps import from_seconds
from impact_observer.states import Vector

_MOST = 400
"""Most changes of contacts that are followed in a row."""
_SHARE = 0.9
"""Where a contact opens that must before its next hit, as a share of the time until then."""
_NEAR = 1e-6
"""Error of an opening that does not matter, s: the load is zero there."""


def has_rows(recording: Recording, system: System) -> bool:
    """Whether the sensor has a dead time, a closing may bounce, or openings are not reported."""
    return bool(recording.dead_time or recording.rows) or any(
        kind is Kind.CLOSE and _may_bounce(system, i)
        for key in recording.episode.keys
        for i, kind in key.switches
    )


def opened(recording: Recording) -> Recording:
    """The recording in which each contact that is closed opens before its next hit."""
    return replace(recording, rows=tuple(_openings(recording)))


def as_closings(recording: Recording, system: System) -> Recording:
    """The recording in which each impact of a contact that may bounce is a closing.

    So a debounced switch that reports no closings reports as one that reports the first edge of a
    row as the closing. A row of bounces is nearer to a rest than to a single impact.
    """
    keys = [
        key._replace(
            switches=tuple(
                (i, Kind.CLOSE if kind is Kind.IMPACT and _may_bounce(system, i) else kind)
                for i, kind in key.switches
            )
        )
        for key in recording.episode.keys
    ]
    return replace(
        recording,
        episode=recording.episode._replace(keys=keys),
        is_debounced=keys != recording.episode.keys,
    )


def dead_time_of(recording: Recording) -> float:
    """How long after an event its row of bounces lasts at most, s.

    0 without rows, and if no dead time hides these: another event follows one as soon.
    """
    hits = {
        (key.stamp, i)
        for key in recording.episode.keys
        for i, kind in key.switches
        if kind is not Kind.OPEN
    }
    last, longest, shortest = dict[int, int](), 0, np.inf
    for stamp, i in sorted(hits | recording.row_hits):
        since = stamp - last.setdefault(i, stamp)
        if (stamp, i) not in hits:
            longest = max(longest, since)
        else:
            shortest = min(shortest, since or np.inf)
            last[i] = stamp
    return longest * 1e-9 if longest < shortest else 0.0


def _openings(recording: Recording) -> Iterator[EventKey]:
    """Openings that are not reported, where each contact is about to hit again, in order."""
    closed = dict[int, int]()
    for key in recording.episode.keys:
        for i, kind in key.switches:
            since = closed.pop(i, None)
            if since is not None and kind is not Kind.OPEN:
                yield EventKey(_before(since, key.stamp), 0, ((i, Kind.OPEN),))
            if kind is Kind.CLOSE:
                closed[i] = key.stamp


def _before(since: int, stamp: int) -> int:
    """When a contact opens that closes and hits again at two stamps, as a guess, ns."""
    return since + int(_SHARE * (stamp - since))


def with_rows(
    recording: Recording, problem: Problem, solution: Solution, clock: float
) -> Recording:
    """The recording with the bounces that a fitted motion makes and the sensor does not report.

    Args:
        recording: the events, and what was put in before.
        problem: of the recording.
        solution: the fitted motion.
        clock: standard deviation of a stamp, s, if declared; the shifts may show a larger one.

    Raises:
        DynamicsError: the motion does not go on.
        ModelError: the fitted values make no valid system.
    """
    n = problem.family.system.n
    system = problem.family.system_at(solution.y[2 * n :])
    rows = _Rows(recording, system, max(clock, solution.rms))
    moving = MovingSystem(system)
    instants = {
        (moment.t, moment.hit): float(t)
        for moment, t in zip(problem.moments, solution.t, strict=True)
        if moment.measured
    }
    t, x = problem.start, solution.y[: 2 * n]
    held: Contacts = ()
    for k, moment in enumerate(problem.moments):
        at = float(solution.t[k])
        if moment.measured and len(moment.hit) == 1 and not held:
            before = moving.motion(t, x, held).states(np.array([max(at - t, 0.0)]))[0]
            rows.follow(round(moment.t * 1e9) + recording.episode.epoch, moment.hit[0], at, before)
        t, x, held = at, solution.shot.states[k], moment.held
    return replace(
        recording,
        rows=tuple(sorted(rows.found)),
        bouncing=frozenset(rows.bouncing),
        instants=instants,
    )


def is_same(recording: Recording, other: Recording) -> bool:
    """Whether two recordings have the same rows, with openings at the same instants."""
    mine, theirs = ([key.switches for key in each.rows] for each in (recording, other))
    if mine != theirs or recording.bouncing != other.bouncing:
        return False
    apart = [abs(a.stamp - b.stamp) for a, b in zip(recording.rows, other.rows, strict=True)]
    return max(apart, default=0) <= from_seconds(_NEAR)


class _Rows:
    """The rows of bounces that begin at the events of a recording."""

    def __init__(self, recording: Recording, system: System, clock: float) -> None:
        """``clock`` is the standard deviation of a stamp, s."""
        self._recording, self._system = recording, system
        self._epoch, self._plant = (
            recording.episode.epoch,
            _free_plant(system, recording.episode.epoch),
        )
        self._phases = Phases(system)
        shortest = TUNING.neglected_flight * self._phases.scales.timescale
        self._soon = from_seconds(NEAR * clock + _NEAR)
        self._shortest = from_seconds(max(TUNING.unresolved_flight * clock, shortest))
        self._reports: list[tuple[int, int, Kind]] = sorted(
            (key.stamp, i, kind)
            for key in recording.episode.keys
            for i, kind in key.switches
            if (key.stamp, i) not in recording.rejected
        )
        self.found, self.bouncing = list[EventKey](), set[Hit]()

    def follow(self, stamp: int, contact: int, t: float, before: Vector) -> None:
        """Add the row that begins at an event, if one does.

        Args:
            stamp: of the event, ns.
            contact: its index.
            t: its instant in the fitted motion, s since the epoch.
            before: the state (q, u) just before, shape (2n,).
        """
        kind = next((k for s, i, k in self._reports if (s, i) == (stamp, contact)), Kind.IMPACT)
        closes, dead = kind is Kind.CLOSE, self._recording.dead_time
        later = [(s, k) for s, i, k in self._reports if i == contact and s > stamp]
        end, after = later[0] if later else (self._recording.episode.keys[-1].stamp + 1, None)
        bounces = _may_bounce(self._system, contact)
        opens_unreported = closes and after not in {None, Kind.OPEN}
        if not (opens_unreported or (bounces and (closes or dead))):
            return
        at = self._epoch + from_seconds(t)
        row = [*self._bounces(contact, at, before, end)]
        if not closes:
            until = min(at + from_seconds(dead), end - self._soon if after else end)
            row = _within(row, until, end)
        if closes and after is Kind.OPEN:
            row = _resting(row)
        elif closes and after and (not row or row[-1][1] is not Kind.OPEN):
            row.append((_before(at, end), Kind.OPEN))
        if closes and any(k is not Kind.OPEN for _, k in row):
            self.bouncing.add((stamp, contact))
        self.found += [EventKey(s, 0, ((contact, k),)) for s, k in row]

    def _bounces(
        self, contact: int, begin: int, before: Vector, end: int
    ) -> Iterator[tuple[int, Kind]]:
        """Stamp and kind of the bounces of a ``contact``, and of its opening after its rest.

        They begin at a stamp in a state ``before`` its hit; none is after ``end``, ns.
        """
        n, plant, name = self._system.n, self._plant, self._system.contact_names[contact]
        q = self._phases.projection.position_after(before[:n], (contact,))
        plant.restart(begin, np.concatenate([q, before[n:]]))
        last, is_closed = begin, False
        for _ in range(_MOST):
            if (switching := plant.next_switching(end - 1)) is None:
                return
            plant.cross(switching)
            stamp = switching.instant.stamp
            kinds = [each.kind for each in switching.switches if each.contact == name]
            if not kinds or stamp <= begin:
                is_closed |= kinds == [Kind.CLOSE]
                continue
            if kinds == [Kind.OPEN]:
                yield stamp, Kind.OPEN
                return
            if is_closed or (last == begin and stamp - begin < self._shortest):
                is_closed = True
                continue
            is_closed = kinds == [Kind.CLOSE] or stamp - last < self._shortest
            yield stamp, Kind.CLOSE if is_closed else Kind.IMPACT
            last = stamp


def _free_plant(system: System, epoch: int) -> Plant:
    """A plant of a system that begins between its stops."""
    q = np.linalg.lstsq(system.W.T, 1.0 - system.q_r, rcond=None)[0]
    start = np.concatenate([q, np.zeros(system.n)])
    q, u = np.split(system.from_frame(np.zeros(1, dtype=np.int64), start[None])[0], 2)
    return Plant(system, q, u, epoch=epoch)


def _within(row: list[tuple[int, Kind]], until: int, end: int) -> list[tuple[int, Kind]]:
    """The hits of a row until a stamp, ns, and the end of a rest that began before, by ``end``."""
    found = list[tuple[int, Kind]]()
    for stamp, kind in row:
        if stamp > until and not (kind is Kind.OPEN and found and found[-1][1] is Kind.CLOSE):
            break
        found.append((stamp, kind))
    if found and found[-1][1] is Kind.CLOSE:
        found.append((_before(found[-1][0], end), Kind.OPEN))
    return found


def _resting(row: list[tuple[int, Kind]]) -> list[tuple[int, Kind]]:
    """A row that rests at its end, until an opening that is reported."""
    hits = [each for each in row if each[1] is not Kind.OPEN]
    return [*hits[:-1], (hits[-1][0], Kind.CLOSE)] if hits else []


def _may_bounce(system: System, contact: int) -> bool:
    """Whether a contact has a restitution."""
    return float(system.eps[contact]) > 0
