# ruff: noqa: D102 (overrides have the docstrings of ``Prediction``)
"""The geometric replica beside the filter: where that restarts, and the cheaper estimate."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.ensemble import Differences, Ensemble
from impact_observer.estimation.impact_filter import ImpactFilter
from impact_observer.estimation.misfit import Fit
from impact_observer.estimation.model_error import unit_kicks
from impact_observer.estimation.square_root import triangular
from impact_observer.events import Contacts
from impact_observer.observer.belief import Belief, Fallback, Prediction
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.states import Matrix, Vector

Part: TypeAlias = tuple[Vector, Matrix]
"""An estimate, shape (2n,), and a root of its covariance, shape (2n, any)."""
CONTACT_TIME = 0.01
"""Standard deviation of the duration of a contact that is not known, relative to the model's time
scale."""
_SMALL = 1e-6
"""Scale of the differences by which a jump is linearised."""


class FallbackReplica:
    """A geometric replica, and its error by white accelerations or by contacts that last."""

    def __init__(self, filter_: ImpactFilter) -> None:
        """The replica of the filter's system."""
        self._moving = filter_.members.given.moving
        self._system = filter_.system
        self._geometric = Geometric(filter_.system)
        self._kicks = unit_kicks(filter_.system)
        self._contact_time = CONTACT_TIME * filter_.phases.scales.timescale

    def begin(self, x: Vector, root: Matrix, closed: Contacts) -> Fallback:
        """The replica at ``x``; ``root`` is one of the initial covariance, shape (2n, 2n)."""
        x = self._geometric.impact(x, closed, closed) if closed else x
        return Fallback(
            x, np.linalg.norm(root, axis=1), np.zeros((x.size, x.size)), np.zeros(x.size)
        )

    def after(self, change: ContactChange, before: Fallback) -> Fallback:
        """The replica after an event."""
        if not change.hit:
            return before
        x = self._geometric.impact(before.x, change.active, change.closed)
        errors = np.column_stack([before.unit, before.lag])
        near = Ensemble(before.x, Differences(_SMALL * errors))
        near = self._geometric.impact_ensemble(near, x, change.active, change.closed)
        unit, lag = np.split(near.differences / _SMALL, [x.size], axis=1)
        return Fallback(x, np.maximum(before.largest, np.abs(x)), unit, self._lag(change, x, lag))

    def _lag(self, change: ContactChange, x: Vector, lag: Matrix) -> Vector:
        """``lag`` after an impact that leads to the state ``x``.

        A contact that lasts ends where it began; a rigid one has moved on by then.
        """
        n, hit = x.size // 2, list(change.hit)
        lag = lag[:, 0].copy()
        shift = self._kicks[:, hit] @ (x[n:] @ self._system.W[:, hit])
        lag[:n] -= self._contact_time * shift
        return lag

    def motion(self, t: float, before: Fallback, closed: Contacts) -> Callable[[float], Fallback]:
        """The replica some seconds after ``t``, s since the epoch, until the next event."""
        motion, phase = self._geometric.motion(t, before.x, closed), self._moving.phase(closed)

        def after(s: float) -> Fallback:
            map_ = phase.transition(s)
            parts = [map_ @ before.unit, self._moving.diffusion(closed, s)]
            unit = triangular(np.hstack(parts))
            return before._replace(x=motion.state(s), unit=unit, lag=map_ @ before.lag)

        return after


def combined(
    fit: Fit, by_filter: Part, replica: Fallback, by_account: Part | None, *, explained: bool
) -> Part:
    """What is published in a misfit: one of the estimates, with the covariance of all.

    Contacts that last shift all of them alike, and no gap need show it. So this error is added.

    Args:
        fit: how far each is from the impacts.
        by_filter: the filter's.
        replica: at the same instant.
        by_account: that of the account with other parameters; None where it is not the nearest.
        explained: whether that account explains the impacts: then it stands alone.
    """
    if by_account is not None and explained:
        return by_account
    by_replica = replica.x, fit.replica_level * replica.unit
    parts, best = [by_filter, by_replica], int(fit.prefers_replica)
    if by_account is not None:
        parts, best = [*parts, by_account], 2
    x, columns = parts[best][0], [replica.lag[:, None]]
    shares = fit.shares(with_account=by_account is not None)
    for share, (other, root) in zip(np.sqrt(shares), parts, strict=True):
        columns += [share * root, share * (x - other)[:, None]]
    return x, np.hstack(columns)


class MisfitPrediction(Prediction):
    """Of filter, replica and account together, where the model does not fit."""

    def __init__(
        self,
        fit: Fit,
        by_filter: Prediction,
        replica: Callable[[float], Fallback],
        by_account: Prediction | None,
        *,
        explained: bool = False,
    ) -> None:
        self._by_filter = by_filter
        self._replica = replica
        self._by_account = by_account
        self._fit = fit
        self._explained = explained

    def state(self, s: float) -> Vector:
        if self._by_account is not None:
            return self._by_account.state(s)
        return self._replica(s).x if self._fit.prefers_replica else self._by_filter.state(s)

    def root(self, s: float) -> Matrix:
        account = None if self._by_account is None else _part(self._by_account, s)
        if account is not None and self._explained:
            return account[1]
        parts = _part(self._by_filter, s), self._replica(s), account
        return combined(self._fit, *parts, explained=self._explained)[1]

    def closed(self, s: float) -> Contacts | None:
        if self._by_account is not None:
            return self._by_account.closed(s)
        return None if self._fit.prefers_replica else self._by_filter.closed(s)

    def belief(self, s: float) -> Belief:
        return self._by_filter.belief(s)


def _part(prediction: Prediction, s: float) -> Part:
    root = prediction.root(s)
    assert root is not None, "the filter has a covariance"
    return prediction.state(s), root
