"""The Kalman filter of impact times, and as many of them as the events leave in doubt."""

import math
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.errors import UsageError
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.ensemble import Differences, Ensemble
from impact_observer.estimation.filter_bank import SURE, FilterBank
from impact_observer.estimation.forecast import FINE, Forecast
from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.hypotheses import Hypothesis
from impact_observer.estimation.impact_filter import ImpactFilter
from impact_observer.estimation.linear import Linear
from impact_observer.estimation.square_root import lengths, triangular
from impact_observer.estimation.uncertainty import Uncertainty, spread
from impact_observer.events import Contacts, Kind, Ruling
from impact_observer.model import System
from impact_observer.observer.belief import Belief, Fallback, Prediction
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.law import Law
from impact_observer.states import Matrix, Vector

CLOCK_ERRORS = (0.0, 1e-7, 1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
"""Standard deviations of a stamp among which the events decide where none is declared, s."""
_STAMP = 1e-9 / math.sqrt(12)
"""Standard deviation of what rounding to 1 ns does to a stamp, s."""
_NOTHING = np.zeros(0)
"""What is slow where nothing is learnt."""
_IMPACTS = 1024
"""Impacts that are believed unheard, one after the other."""
_WINDOW = 64 / FINE
"""How far an estimate looks on at first, in the inverse of the fastest rate."""


class MinimumVariance(Law):
    """The estimate of least variance, and that variance, from the instants alone.

    ``ImpactFilter`` says what follows from events that are what they are said to be, and
    ``FilterBank`` weighs what else they may have been. The estimate is that of the likeliest
    account. What it falls through by more than it can be wrong is an impact that nobody heard,
    and it jumps where that is predicted. Where every event is believed, the clock is declared
    and nothing is learnt there is one account, which is the belief itself, and no bank.

    Attributes:
        clocks: standard deviations of a stamp that are thought possible, s.
    """

    name: ClassVar[str] = "minimum-variance"
    learns: ClassVar[bool] = True
    compiles: ClassVar[bool] = True

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare the filter.

        Raises:
            UsageError: the declared uncertainty does not fit the system; or its clock has an
                unknown offset, and the system no force that depends on time.
        """
        super().__init__(system, uncertainty)
        declared = self.uncertainty.clock_error
        errors = CLOCK_ERRORS if declared is None else (declared,)
        self.clocks = tuple(math.hypot(error, _STAMP) for error in errors)
        if self.uncertainty.clock_offset_error and not system.forcing.depends_on_time:
            raise UsageError(
                f"clock_offset_error: the offset cannot be known with {system.name}, as no force"
                " depends on time: a later clock and a later motion look the same; leave it out"
            )
        filter_ = ImpactFilter(system, self.uncertainty.model_error, self.uncertainty.unknowns)
        self._bank = FilterBank(filter_, self.uncertainty, self.clocks)
        self._geometric = Geometric(system)
        self._names = filter_.members.family.names
        self._learns = bool(
            self._names or len(self.clocks) > 1 or self.uncertainty.clock_offset_error
        )
        self._sure = self.uncertainty.trusts_events and not self._learns

    def compile(self) -> None:
        """Have machine code for the numbers of nearly every event.

        Raises:
            UsageError: ``numba`` is not installed.
        """
        self._bank.filter.compile()

    def begin(self, replicas: Matrix, root: Matrix, closed: Contacts) -> Belief:
        """What is declared, and that closed contacts rest."""
        known = self._bank.filter.begin(self._known(replicas, root, closed))
        if self._sure:
            return Belief(known.ensemble, known.root)
        x = replicas[0]
        x = self._geometric.impact(x, closed, closed) if closed else x
        return self._belief(self._even(known), Fallback(x, np.linalg.norm(root, axis=1)))

    def correct(self, change: ContactChange, belief: Belief) -> Belief:
        """What each hypothesis makes of the event, and which is the likeliest then."""
        if not change.hit and change.before == change.closed:
            return belief
        if self._sure:
            return self._believed(change, belief)
        hypotheses, fallback = self._taken(belief, change.before)
        x = fallback.x
        x = self._geometric.impact(x, change.active, change.closed) if change.hit else x
        fallback = Fallback(x, np.maximum(fallback.reach, np.abs(x)))
        anew = partial(self._anew, fallback, change.closed, 1 + belief.ensemble.others)
        return self._belief(self._bank.heard(change, hypotheses, anew) or anew(), fallback, change)

    def predict(self, t: float, belief: Belief, closed: Contacts) -> Prediction:
        """The likeliest account for the estimate, all of them for the next event."""
        if self._sure:
            return _Sure(self._bank.filter, t, belief, closed)
        hypotheses, fallback = self._taken(belief, closed)
        motion = self._geometric.motion(t, fallback.x, closed)

        def later(s: float) -> Belief:
            found = self._bank.predicted(hypotheses, t, s)
            return self._belief(found, Fallback(motion.state(s), fallback.reach))

        if self.uncertainty.trusts_events:
            return _Heard(self._bank.filter, t, hypotheses, later)
        return _Foreseen(self._bank, t, hypotheses, later)

    def _believed(self, change: ContactChange, belief: Belief) -> Belief:
        """``belief`` after an event that is beyond doubt."""
        (x, since, _), root, clock = belief.ensemble, belief.root, self.clocks[0]
        assert root is not None, "a belief of another law"
        differences, filter_ = belief.ensemble.differences, self._bank.filter
        if (usual := filter_.usually(change, (x, root, differences), clock)) is None:
            known = GaussianState(x, _NOTHING, root, differences, change.before)
            evidence, after = filter_.generally(change, known, clock)
            known = after()
            return Belief(known.ensemble, known.root, innovations=evidence.innovations)
        (x, root, differences), (white, *_) = usual
        ensemble = Ensemble(x, Differences(differences) if differences.size else since)
        return Belief(ensemble, root, innovations={change.hit[0]: abs(float(white))})

    def _taken(self, belief: Belief, closed: Contacts) -> tuple[tuple[Hypothesis, ...], Fallback]:
        """Hypotheses and fallback of a belief; of a bare one, that it is right."""
        if belief.fallback is not None:
            return belief.hypotheses, belief.fallback
        assert belief.root is not None, "a belief of another law"
        known = self._known(belief.replicas, belief.root, closed)
        return self._even(known), Fallback(belief.x, np.linalg.norm(belief.root, axis=1))

    def _even(self, known: GaussianState) -> tuple[Hypothesis, ...]:
        """One hypothesis for each accuracy of the clock, all as likely."""
        weight = -math.log(len(self.clocks))
        return tuple(Hypothesis(known, clock, weight) for clock in self.clocks)

    def _known(self, replicas: Matrix, root: Matrix, closed: Contacts) -> GaussianState:
        """``replicas`` and ``root`` with what else is not known, as it was declared."""
        declared, late = self.uncertainty.unknowns, self.uncertainty.clock_offset_error
        deviations = [*([] if declared is None else declared.deviations)]
        unsure = np.diag([*deviations, *([late] if late else [])])
        whole = linalg.block_diag(root, unsure) if len(unsure) else root
        known = GaussianState.of(replicas, whole, closed)
        if declared is None:
            return known
        p, given = declared.family.size, np.append(replicas[0], declared.family.nominal)
        others = spread(given, whole[: given.size, : root.shape[1] + p], len(replicas))
        slow, differences = known.slow.copy(), known.differences.copy()
        slow[:p] = declared.family.nominal
        differences[given.size - p : given.size] = (others[1:] - given)[:, given.size - p :].T
        return known._replace(slow=slow, differences=differences, parameters=p)

    def _anew(self, fallback: Fallback, closed: Contacts, count: int) -> tuple[Hypothesis, ...]:
        """If nothing is believed any more: a motion as large as there was, any clock."""
        root = np.diag(fallback.reach)
        replicas = spread(fallback.x, root, count)
        known = self._known(replicas, root, closed)
        return self._even(self._bank.filter.begin(known))

    def _belief(
        self,
        hypotheses: tuple[Hypothesis, ...],
        fallback: Fallback,
        change: ContactChange | None = None,
    ) -> Belief:
        """A belief whose estimate is that of the likeliest of ``hypotheses``."""
        best, size = hypotheses[0], fallback.x.size
        root = _mixed(hypotheses).root
        notes = best.noted((change.stamp, change.sequence)) if change else []
        return Belief(
            best.known.ensemble,
            root[:size],
            innovations={n.contact: n.innovation for n in notes if n.innovation >= 0},
            accepted=all(note.ruling is Ruling.APPLIED for note in notes),
            clock_offset=best.known.offset,
            parameters=self._learnt(hypotheses, root[size:]) if self._learns else (),
            hypotheses=hypotheses,
            fallback=fallback,
        )

    def _learnt(
        self, hypotheses: Sequence[Hypothesis], root: Matrix
    ) -> tuple[tuple[str, float, float], ...]:
        """What is known of parameters and of the clock, where those are not given.

        Args:
            hypotheses: the likeliest first.
            root: rows of the covariance's root for what is slow, shape (k, any).
        """
        best, deviations = hypotheses[0].known, lengths(root)
        found = list(zip(self._names, best.theta.tolist(), deviations, strict=False))
        if len(self.clocks) > 1:
            weights = np.exp([h.weight for h in hypotheses])
            clocks = np.array([h.clock for h in hypotheses])
            mean = float(np.average(clocks, weights=weights))
            spread_ = math.sqrt(float(np.average((clocks - mean) ** 2, weights=weights)))
            found.append(("clock_error", mean, spread_))
        if self.uncertainty.clock_offset_error:
            found.append(("clock_offset", best.offset, deviations[-1]))
        return tuple(found)


def _mixed(hypotheses: Sequence[Hypothesis]) -> GaussianState:
    """What is known by the likeliest hypothesis, as surely as all of them together allow."""
    best = hypotheses[0].known
    if len(hypotheses) == 1:
        return best
    weights = np.exp([h.weight for h in hypotheses])
    columns = []
    for weight, h in zip(np.sqrt(weights / np.sum(weights)), hypotheses, strict=True):
        differences = np.append(h.known.x - best.x, h.known.slow - best.slow)
        columns += [weight * h.known.root, weight * differences[:, None]]
    return best._replace(root=triangular(np.hstack(columns)))


class _Sure(Prediction):
    """What is believed until the next event, where none is in doubt."""

    def __init__(self, filter_: ImpactFilter, t: float, belief: Belief, closed: Contacts) -> None:
        self._filter = filter_
        self._belief = belief
        self._phase = filter_.members.given.moving.phase(closed)
        self._motion = self._phase.start(t, belief.x)

    def state(self, s: float) -> Vector:
        return self._motion.state(s)

    def root(self, s: float) -> Matrix:
        return self._carried(self._phase.transition(s), s)

    def belief(self, s: float) -> Belief:
        x, map_ = self._phase.flow.moved(self._motion, s)
        before = self._belief.ensemble
        after = before.propagated(x, map_) if before.others else Ensemble(x, before.since)
        return Belief(after, self._carried(map_, s))

    def _carried(self, map_: Matrix, s: float) -> Matrix:
        """The covariance's root after ``s`` seconds of which ``map_`` is the transition."""
        assert self._belief.root is not None, "a belief of another law"
        root, astray = map_.dot(self._belief.root), self._filter.astray
        return root if astray is None else astray.gone(self._phase, root, s)


class _Heard(Prediction):
    """What is believed until the next event, where every one is heard."""

    def __init__(
        self,
        filter_: ImpactFilter,
        t: float,
        hypotheses: Sequence[Hypothesis],
        later: Callable[[float], Belief],
    ) -> None:
        self._begun = partial(filter_.course, t)
        self._hypotheses = hypotheses
        self._later = later

    @cached_property
    def _linear(self) -> Linear:
        return self._begun(_mixed(self._hypotheses))

    def state(self, s: float) -> Vector:
        return self._linear.state(s)

    def root(self, s: float) -> Matrix:
        return self._linear.root(s)

    def belief(self, s: float) -> Belief:
        return self._later(s)


class _Part(NamedTuple):
    """A stretch of the likeliest account between two switchings that nobody heard.

    Attributes:
        since: from when on it is believed, s since the last event.
        start: when it began, s since the last event.
        forecast: what it comes to.
        closed: contacts that it holds closed.
        linear: the covariance of all accounts together, as it goes on.
    """

    since: float
    start: float
    forecast: Forecast
    closed: Contacts
    linear: Linear


class _Foreseen(Prediction):
    """What is believed until the next event, where some are not heard.

    The estimate is a function of time alone: an impact that was not heard counts from when on it
    is sure, whoever asks when.
    """

    def __init__(
        self,
        bank: FilterBank,
        t: float,
        hypotheses: Sequence[Hypothesis],
        later: Callable[[float], Belief],
    ) -> None:
        self._bank = bank
        self._t = t
        self._hypotheses = hypotheses
        self._later = later
        self._first = _WINDOW * bank.filter.phases.scales.timescale
        self._looked, self._window = 0.0, self._first

    @cached_property
    def _parts(self) -> list[_Part]:
        root = _mixed(self._hypotheses).root
        return [self._begun(0.0, 0.0, self._hypotheses[0].known, root)]

    def state(self, s: float) -> Vector:
        part = self._part(s)
        return part.forecast.course.state(s - part.start)

    def root(self, s: float) -> Matrix:
        part = self._part(s)
        return part.linear.root(s - part.start)

    def closed(self, s: float) -> Contacts:
        return self._part(s).closed

    def belief(self, s: float) -> Belief:
        return self._later(s)

    def _begun(self, since: float, start: float, known: GaussianState, root: Matrix) -> _Part:
        """A stretch from ``start`` on."""
        t = self._t + start
        mixed = self._bank.filter.course(t, known._replace(root=root))
        return _Part(since, start, self._bank.forecast(t, known), known.closed, mixed)

    def _part(self, s: float) -> _Part:
        """The stretch that is believed after ``s`` seconds."""
        while self._looked < s:
            self._look()
        return next(part for part in reversed(self._parts) if part.since <= s)

    def _look(self) -> None:
        """Look on: to the end of a window, twice as long as the last, or to the next switching."""
        if len(self._parts) > _IMPACTS:
            self._looked = math.inf
            return
        _, start, forecast, _, mixed = self._parts[-1]
        sure = (dip for dip in forecast.dips(self._window) if dip.depth >= SURE)
        dip = next(sure, None)
        if dip is None:
            self._looked, self._window = start + self._window, 2 * self._window
            return
        at, since = forecast.root(dip), start + forecast.sure(dip, SURE)
        t = self._t + start + at
        known, kind = self._bank.switched(t, forecast.course.known(at), dip)
        # The other accounts jump with it: how far they are apart is thrown back likewise.
        differences, size = mixed.whole(at).copy(), known.x.size
        if kind is not Kind.OPEN:
            differences[:size] = (
                self._bank.filter.mirrored(dip.contact, known) @ differences[:size]
            )
        root_now = triangular(np.hstack([known.root, differences]))
        self._parts.append(self._begun(since, start + at, known, root_now))
        self._looked, self._window = since, self._first
