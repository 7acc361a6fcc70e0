# SPDX-License-Identifier: Apache-2.0
"""An account of the first events, backward in time from a later motion that is certain.

Early decisions of the filter may be wrong for good. Where the account from a moment on is right,
the smoothed state before that moment is exact enough to be followed back. Where a gap falls to
zero backward in time, the contact has hit: the impact is a reported event near that instant, or a
missed detection. Each new moment is added and the motion smoothed again, before the next search.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.errors import DynamicsError
from impact_observer.events import Ruling, Verdict
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.model_error import unit_kicks
from impact_observer.kernel._kernel import falls_at
from impact_observer.smooth.account import EventAccount, Moment
from impact_observer.smooth.arc import Arc
from impact_observer.smooth.chain import Normal
from impact_observer.smooth.linearised import followed
from impact_observer.smooth.smoother import smooth
from impact_observer.stamps import from_seconds
from impact_observer.states import Vector

_KEPT = 16
"""Moments after an instant from which its state is smoothed."""
_SAMPLES = 24.0
"""Instants in the model's time scale at which gaps are looked at."""
_GATE = 5.0
"""Largest distance of a reported instant from the predicted one, in standard deviations."""
_VAGUE = 0.2
"""Largest deviation of a predicted instant, relative to the model's time scale."""

_FALSE = "spurious: the smoothed motion does not hit then"
_MISSED = "IMPACT missed: the smoothed motion hits then"


class _Hit(NamedTuple):
    """An instant at which a gap falls to zero backward in time.

    Attributes:
        contact: index.
        t: s since the epoch.
        x: state then, after the impact, shape (2n,).
        deviation: of the instant, s.
    """

    contact: int
    t: float
    x: Vector
    deviation: float


class Retracing:
    """Finds the moments before others, in the flights of one filter's system."""

    def __init__(self, filter_: ImpactFilter, prior: GaussianState, t: float) -> None:
        """The ``prior`` holds at ``t``, s since the epoch: the start of the recording."""
        self._filter, self._prior, self._t = filter_, prior, t
        self._moving = filter_.members.given.moving
        self._kicks = unit_kicks(filter_.system)
        self._step = filter_.scales.timescale / _SAMPLES

    def account(self, known: EventAccount, first: int, x: Vector) -> EventAccount | None:
        """The account whose moments from the ``first`` on are the moments of ``known``.

        ``x`` is about the state just before that moment, shape (2n,). Returns None if the motion
        cannot be followed back: a contact is closed, instants are too vague, or the motion grows
        beyond all bounds.
        """
        try:
            return self._followed_back(known, first, x)
        except DynamicsError:
            return None

    def _followed_back(self, known: EventAccount, first: int, x: Vector) -> EventAccount | None:
        """As ``account``; raises a DynamicsError if the motion grows beyond all bounds."""
        moments, clock = [*known.moments[first:]], known.moments[first].clock
        reported = [each for each in known.reported if each.change.stamp < moments[0].change.stamp]
        taken: set[int] = set()
        while not moments[0].change.before:
            t = moments[0].change.t
            state = self._prior._replace(x=x, constants=self._prior.constants)
            arc = Arc(self._filter, t, state, moments[:_KEPT])
            hit = self._last_hit(t, smooth(arc).first)
            if hit is None:
                return self._joined(known, moments, first, taken)
            if not hit.deviation < _VAGUE * self._filter.scales.timescale:
                return None
            x = self._before(hit)
            moment = self._reported(hit, reported, clock, moments[0])
            if moment is None:
                stamp = from_seconds(hit.t - t) + moments[0].change.stamp
                at = t + (stamp - moments[0].change.stamp) * 1e-9
                change = ContactChange(at, (), (hit.contact,), (), stamp)
                moment = Moment(change, 0.0, moments[0].error, is_inserted=True)
            else:
                taken.add(moment.change.stamp)
            flown = (moments[0].change.stamp - moment.change.stamp) * 1e-9
            moments[0] = moments[0]._replace(change=moments[0].change._replace(flown=flown))
            moments.insert(0, moment)
        return None

    def _last_hit(self, t: float, z: Normal) -> _Hit | None:
        """The last impact between the start and ``t``, where the state is ``z``."""
        system, n = self._filter.system, self._filter.system.n
        x, total = z.mean[: 2 * n], t - self._t
        if total <= 0:
            return None
        count = math.ceil(total / self._step)
        before = np.full(system.m, -math.inf)
        for k in range(count + 1):
            s = -total * k / count
            after = self._gaps(t, x, s)
            fallen = np.flatnonzero((before > 0) & (after < 0))
            if fallen.size:
                roots = [self._root(t, x, i, s + total / count, s) for i in fallen.tolist()]
                s, i = max(zip(roots, fallen.tolist(), strict=True))
                return self._hit(t, z, i, s)
            before = after
        return None

    def _gaps(self, t: float, x: Vector, s: float) -> Vector:
        """All gaps, ``s`` seconds after ``t``, where the state is ``x``."""
        system = self._filter.system
        moved = followed(self._moving.moved(t, x, s, ())[0])
        return np.asarray(system.gap(moved[: system.n]))

    def _root(self, t: float, x: Vector, i: int, above: float, below: float) -> float:
        return falls_at(lambda s: float(self._gaps(t, x, s)[i]), above, below)

    def _hit(self, t: float, z: Normal, i: int, s: float) -> _Hit:
        n = self._filter.system.n
        x, map_ = self._moving.moved(t, z.mean[: 2 * n], s, ())
        w = self._filter.system.W[:, i]
        seen = w @ (map_ @ z.root[: 2 * n])[:n]
        speed = max(abs(float(w @ x[n:])), 1e-12)
        return _Hit(i, t + s, x, float(np.linalg.norm(seen)) / speed)

    def _before(self, hit: _Hit) -> Vector:
        """About the state before an impact, shape (2n,)."""
        system = self._filter.system
        x: Vector = hit.x.copy()
        speed = float(system.W[:, hit.contact] @ x[system.n :])
        before = system.rebounds[hit.contact].speed_before(speed)
        x[system.n :] += self._kicks[:, hit.contact] * (before - speed)
        return x

    def _reported(
        self, hit: _Hit, reported: Sequence[Moment], clock: float, after: Moment
    ) -> Moment | None:
        """The nearest reported event within the gate of ``hit``; None without one."""
        near = [
            each
            for each in reported
            if each.change.hit == (hit.contact,) and each.change.stamp < after.change.stamp
        ]
        if not near:
            return None
        best = min(near, key=lambda each: abs(each.change.t - hit.t))
        if abs(best.change.t - hit.t) > _GATE * math.hypot(hit.deviation, clock):
            return None
        return best

    def _joined(
        self, known: EventAccount, moments: Sequence[Moment], first: int, taken: set[int]
    ) -> EventAccount:
        """The account with ``moments``; from the ``first`` moment on, that of ``known``.

        Of the events reported before, the events at the stamps ``taken`` are true.
        """
        since = known.moments[first].change.stamp
        verdicts = [each for each in known.verdicts if each.stamp >= since]
        for each in known.as_reported().verdicts:
            if each.stamp < since:
                is_true = each.stamp in taken or each.ruling is not Ruling.APPLIED
                verdicts.append(
                    each if is_true else each._replace(ruling=Ruling.REJECTED, reason=_FALSE)
                )
        names = self._filter.system.contact_names
        for moment in moments:
            if moment.is_inserted and moment.change.stamp < since:
                name = names[moment.change.hit[0]]
                verdicts.append(
                    Verdict(moment.change.stamp, Ruling.INSERTED, 0, name, reason=_MISSED)
                )
        verdicts.sort(key=lambda each: (each.stamp, each.sequence))
        return known._replace(moments=tuple(moments), verdicts=tuple(verdicts))
