# ruff: noqa: D102 (overrides have the docstrings of ``Prediction``)
"""The geometric replica beside the filter: where that restarts, and the cheaper estimate."""

import math
from collections.abc import Callable

import numpy as np

from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.ensemble import Differences, Ensemble
from impact_observer.estimation.impact_filter import ImpactFilter
from impact_observer.estimation.misfit import Fit
from impact_observer.estimation.square_root import triangular
from impact_observer.events import Contacts
from impact_observer.observer.belief import Belief, Fallback, Prediction
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.states import Matrix, Vector

_SMALL = 1e-6
"""Scale of the differences by which a jump is linearised."""


class FallbackReplica:
    """A geometric replica, and the covariance of its error if accelerations are white noise."""

    def __init__(self, filter_: ImpactFilter) -> None:
        """The replica of the filter's system."""
        self._moving = filter_.members.given.moving
        self._geometric = Geometric(filter_.system)

    def begin(self, x: Vector, root: Matrix, closed: Contacts) -> Fallback:
        """The replica at ``x``; ``root`` is one of the initial covariance, shape (2n, 2n)."""
        x = self._geometric.impact(x, closed, closed) if closed else x
        return Fallback(x, np.linalg.norm(root, axis=1), np.zeros((x.size, x.size)))

    def after(self, change: ContactChange, before: Fallback) -> Fallback:
        """The replica after an event."""
        if not change.hit:
            return before
        x = self._geometric.impact(before.x, change.active, change.closed)
        near = Ensemble(before.x, Differences(_SMALL * before.unit))
        near = self._geometric.impact_ensemble(near, x, change.active, change.closed)
        unit = near.differences / _SMALL
        return Fallback(x, np.maximum(before.largest, np.abs(x)), unit)

    def motion(self, t: float, before: Fallback, closed: Contacts) -> Callable[[float], Fallback]:
        """The replica some seconds after ``t``, s since the epoch, until the next event."""
        motion, phase = self._geometric.motion(t, before.x, closed), self._moving.phase(closed)

        def after(s: float) -> Fallback:
            parts = [phase.transition(s) @ before.unit, self._moving.diffusion(closed, s)]
            return before._replace(x=motion.state(s), unit=triangular(np.hstack(parts)))

        return after


def combined(x: Vector, root: Matrix, replica: Fallback, fit: Fit) -> tuple[Vector, Matrix]:
    """What is published in a misfit: one of filter and replica, with the covariance of both.

    Args:
        x: the filter's estimate, shape (2n,).
        root: a root of its covariance, shape (2n, any).
        replica: at the same instant.
        fit: how far each is from the impacts.
    """
    weight, level = fit.replica_weight, fit.replica_level
    distance = (x - replica.x)[:, None]
    if fit.prefers_replica:
        x, distance = replica.x, math.sqrt(1 - weight) * distance
    else:
        distance = math.sqrt(weight) * distance
    parts = [math.sqrt(1 - weight) * root, math.sqrt(weight) * level * replica.unit, distance]
    return x, np.hstack(parts)


class MisfitPrediction(Prediction):
    """Of filter and replica together, where the model does not fit."""

    def __init__(
        self, by_filter: Prediction, replica: Callable[[float], Fallback], fit: Fit
    ) -> None:
        self._by_filter = by_filter
        self._replica = replica
        self._fit = fit

    def state(self, s: float) -> Vector:
        return self._replica(s).x if self._fit.prefers_replica else self._by_filter.state(s)

    def root(self, s: float) -> Matrix:
        root = self._by_filter.root(s)
        assert root is not None, "the filter has a covariance"
        return combined(self._by_filter.state(s), root, self._replica(s), self._fit)[1]

    def closed(self, s: float) -> Contacts | None:
        return None if self._fit.prefers_replica else self._by_filter.closed(s)

    def belief(self, s: float) -> Belief:
        return self._by_filter.belief(s)
