# SPDX-License-Identifier: Apache-2.0

# ruff: noqa: D102 (overrides have the docstrings of ``Prediction``)
"""The geometric replica beside the filter: where that restarts, and the cheaper estimate."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import ClassVar, TypeAlias

import numpy as np

from impact_observer.dynamics import KEPT
from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.ensemble import Ensemble
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.misfit import Fit
from impact_observer.filter.model_error import unit_kicks
from impact_observer.filter.square_root import triangular
from impact_observer.filter.tuning import TUNING
from impact_observer.observer.belief import Belief, Fallback, Prediction
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.states import Matrix, Vector

Part: TypeAlias = tuple[Vector, Matrix]
"""An estimate, shape (2n,), and a root of its covariance, shape (2n, any)."""
_DIFFERENCE = 1e-6
"""Scale of the differences by which a jump is linearised."""


class FallbackReplica:
    """A geometric replica, and its error by white accelerations or by contacts that last.

    Attributes:
        is_compared: whether it is compared with the estimate, and weighed in a misfit.
    """

    is_compared: ClassVar[bool] = True

    def __init__(self, filter_: ImpactFilter) -> None:
        """The replica of the filter's system."""
        self._moving = filter_.members.given.moving
        self._system = filter_.system
        self._geometric = Geometric(filter_.system, moving=self._moving)
        self._kicks = unit_kicks(filter_.system)
        self._contact_time = TUNING.replica_contact_time * filter_.scales.timescale
        self._lag = lru_cache(KEPT)(self._lag_of)

    def begin(self, x: Vector, root: Matrix, closed: Contacts) -> Fallback:
        """The replica at ``x``; ``root`` is one of the initial covariance, shape (2n, 2n)."""
        x = self._geometric.impact(x, closed, closed) if closed else x
        return Fallback(x, np.linalg.norm(root, axis=1), np.zeros((x.size, x.size + 1)))

    def after(self, change: ContactChange, before: Fallback) -> Fallback:
        """The replica after an event."""
        if not change.hit:
            return before
        x, n = self._geometric.impact(before.x, change.active, change.closed), self._system.n
        near = Ensemble(before.x, _DIFFERENCE * before.errors)
        near = self._geometric.impact_ensemble(near, x, change.active, change.closed)
        errors = near.differences / _DIFFERENCE
        errors[:n, -1] -= self._lag(change.hit).dot(x[n:])
        return Fallback(x, np.maximum(before.largest, np.abs(x)), errors)

    def beside(self, before: Fallback, x: Vector) -> Fallback:
        """The replica beside an estimate ``x``, which is another motion."""
        del x
        return before

    def _lag_of(self, hit: Contacts) -> Matrix:
        """How an impact adds to the lag, by the velocities after it, shape (n, n), s.

        A contact that lasts ends where it began; a rigid one has moved on by then.
        """
        which = list(hit)
        shift = self._kicks[:, which] @ self._system.W[:, which].T
        return np.asarray(self._contact_time * shift)

    def motion(self, t: float, before: Fallback, closed: Contacts) -> Callable[[float], Fallback]:
        """The replica some seconds after ``t``, s since the epoch, until the next event."""
        phase = self._moving.phase(closed)
        held = self._geometric.motion(t, before.x, closed) if closed else None

        def after(s: float) -> Fallback:
            if held is None:
                x, map_ = phase.moved(t, before.x, s)
            else:
                x = held.state(s)
                map_ = phase.transition(s)
            errors = map_.dot(before.errors)
            noise = self._moving.diffusion(t, before.x, closed, s)
            unit = np.concatenate([errors[:, :-1], noise], axis=1)
            errors[:, :-1] = triangular(unit)
            return Fallback(x, before.largest, errors)

        return after


class EstimateReplica(FallbackReplica):
    """The estimate of a robot in place of a replica: what is measured bounds its error."""

    is_compared: ClassVar[bool] = False

    def __init__(self) -> None:
        """Of any robot."""

    def begin(self, x: Vector, root: Matrix, closed: Contacts) -> Fallback:
        del closed
        return Fallback(x, np.linalg.norm(root, axis=1), np.zeros((x.size, x.size + 1)))

    def after(self, change: ContactChange, before: Fallback) -> Fallback:
        del change
        return before

    def beside(self, before: Fallback, x: Vector) -> Fallback:
        return before._replace(x=x, largest=np.maximum(before.largest, np.abs(x)))

    def motion(self, t: float, before: Fallback, closed: Contacts) -> Callable[[float], Fallback]:
        del t, closed
        return lambda _: before


def replica_of(filter_: ImpactFilter) -> FallbackReplica:
    """The replica beside a filter of a linear system or a robot."""
    return EstimateReplica() if filter_.is_of_robot else FallbackReplica(filter_)


def nearest(fit: Fit, states: int) -> int:
    """Which estimate is published in a misfit: of filter, replica and, if asked, account."""
    return 2 if states > 2 else int(fit.prefers_replica)


def combined(
    fit: Fit,
    by_filter: tuple[Part, Fallback] | None,
    by_few: Part | None,
    by_wide: Part | None,
) -> Matrix:
    """A root of the covariance in a misfit: of all estimates, about the nearest one.

    Contacts that last shift all of them alike, and no gap need show it. So this error is added.

    Args:
        fit: how far each is from the impacts.
        by_filter: the filter's, and the replica; None where few parameters explain the impacts:
            then only the accounts count.
        by_few: by the account with few parameters; None where it is not the nearest.
        by_wide: by the account with all of them; None without.
    """
    weight = TUNING.wide_weight
    if by_filter is None:
        assert by_few is not None, "few parameters explain the impacts"
        parts, x, columns, shares = [by_few], by_few[0], list[Matrix](), np.ones(1)
        weight = TUNING.wide_weight_explained
    else:
        own, replica = by_filter
        parts = [own, (replica.x, fit.replica_level * replica.unit)]
        if by_few is not None:
            parts.append(by_few)
        x, columns = parts[nearest(fit, len(parts))][0], [replica.lag[:, None]]
        shares = fit.shares(with_account=by_few is not None)
    if by_wide is not None:
        parts.append(by_wide)
        shares = np.append((1 - weight) * shares, weight)
    for share, (other, root) in zip(np.sqrt(shares), parts, strict=True):
        columns += [share * root, share * (x - other)[:, None]]
    return np.hstack(columns)


def doubted_root(by_filter: Part, by_wide: Part) -> Matrix:
    """A root of the covariance about the filter's estimate, where the model is doubted.

    Args:
        by_filter: the filter's.
        by_wide: by the account with all parameters.
    """
    weight, away = TUNING.wide_weight_explained, by_filter[0] - by_wide[0]
    wide = math.sqrt(weight) * np.column_stack([by_wide[1], away])
    return np.hstack([math.sqrt(1 - weight) * by_filter[1], wide])


class DoubtedPrediction(Prediction):
    """Of the filter; its covariance is that of the account with all parameters, too."""

    def __init__(self, by_filter: Prediction, by_wide: Prediction) -> None:
        self._by_filter, self._by_wide = by_filter, by_wide

    def state(self, s: float) -> Vector:
        return self._by_filter.state(s)

    def root(self, s: float) -> Matrix:
        return doubted_root(_part(self._by_filter, s), _part(self._by_wide, s))

    def closed(self, s: float) -> Contacts | None:
        return self._by_filter.closed(s)

    def belief(self, s: float) -> Belief:
        return self._by_filter.belief(s)

    def silence(self, s: float) -> str:
        return self._by_filter.silence(s)


class MisfitPrediction(Prediction):
    """Of filter, replica and accounts together, where the model does not fit."""

    def __init__(
        self,
        fit: Fit,
        by_filter: Prediction,
        replica: Callable[[float], Fallback],
        by_few: Prediction | None,
        by_wide: Prediction | None = None,
        *,
        explained: bool = False,
    ) -> None:
        self._by_filter = by_filter
        self._replica = replica
        self._by_few, self._by_wide = by_few, by_wide
        self._fit = fit
        self._explained = explained

    def state(self, s: float) -> Vector:
        if self._by_few is not None:
            return self._by_few.state(s)
        return self._replica(s).x if self._fit.prefers_replica else self._by_filter.state(s)

    def root(self, s: float) -> Matrix:
        few = None if self._by_few is None else _part(self._by_few, s)
        wide = None if self._by_wide is None else _part(self._by_wide, s)
        own = None if self._explained else (_part(self._by_filter, s), self._replica(s))
        return combined(self._fit, own, few, wide)

    def closed(self, s: float) -> Contacts | None:
        if self._by_few is not None:
            return self._by_few.closed(s)
        return None if self._fit.prefers_replica else self._by_filter.closed(s)

    def belief(self, s: float) -> Belief:
        return self._by_filter.belief(s)

    def silence(self, s: float) -> str:
        return self._by_filter.silence(s)


def _part(prediction: Prediction, s: float) -> Part:
    root = prediction.root(s)
    assert root is not None, "the filter has a covariance"
    return prediction.state(s), root
