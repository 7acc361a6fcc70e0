# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter of impact times, with a bank of hypotheses on what each event was."""

import math
from collections.abc import Sequence
from functools import cached_property, partial
from operator import attrgetter
from typing import ClassVar

import numpy as np
from scipy import linalg

from impact_observer.dynamics.contact.impact_balance import ImpactBalance
from impact_observer.errors import UsageError
from impact_observer.events import Contacts, Ruling
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.filter_bank import RESTART, FilterBank
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import (
    Hypothesis,
    agreeing,
    mean_level,
    mixture,
    normalised,
    probabilities,
    published,
)
from impact_observer.filter.impact_deviations import balance_at
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.misfit import Fit, misfit_of
from impact_observer.filter.model_error import ErrorKind
from impact_observer.filter.readings import Reading, SampleOutcome
from impact_observer.filter.sample_update import SampleUpdate
from impact_observer.filter.square_root import lengths
from impact_observer.filter.tuning import TUNING
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.model import System
from impact_observer.observer.belief import (
    Belief,
    Fallback,
    Learned,
    Onset,
    Parameters,
    Prediction,
)
from impact_observer.observer.laws.fitting import fitted
from impact_observer.observer.laws.kalman_predictions import predicted_by
from impact_observer.observer.laws.law import Law
from impact_observer.observer.laws.starts import Starts
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector

_STAMP_ROUNDING = 1e-9 / math.sqrt(12)
"""Standard deviation of rounding a stamp to 1 ns, s."""


class RobotVariance(Law):
    """The estimate of least variance of a robot, from encoders and impact times.

    ``ImpactFilter`` corrects a state by events that are what they are reported to be;
    ``FilterBank`` weighs hypotheses of what else they may have been. The estimate is that of the
    likeliest hypothesis. Where it penetrates a stop by more than its standard deviation explains,
    an impact was missed, and it jumps at the predicted instant.

    Attributes:
        clocks: possible standard deviations of a stamp, s.
        misfit: the warning that the model does not explain the impacts.
    """

    name: ClassVar[str] = "minimum-variance"
    has_covariance: ClassVar[bool] = True
    learns: ClassVar[bool] = True
    uses_measurements: ClassVar[bool] = True
    takes: ClassVar[tuple[type[System | Robot], ...]] = (Robot,)

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare the filter.

        Raises:
            UsageError: the declared uncertainty does not fit the system; or its clock has an
                unknown offset, and the system no force that depends on time.
        """
        super().__init__(system, uncertainty)
        declared = self.uncertainty.clock_error
        errors = TUNING.clock_errors if declared is None else (declared,)
        self.clocks = tuple(math.hypot(error, _STAMP_ROUNDING) for error in errors)
        if self.uncertainty.clock_offset_error and not system.depends_on_time:
            raise UsageError(
                f"clock_offset_error: the offset cannot be estimated with {system.name}, as no"
                " force depends on time: a later clock and a later motion look the same; leave it"
                " out"
            )
        self.misfit = misfit_of(system)
        learns_error = self.uncertainty.model_error is None
        filter_ = ImpactFilter(
            system, self.uncertainty.model_error or 0.0, self.uncertainty.unknowns
        )
        self.moving = filter_.members.given.moving
        self._bank = FilterBank(filter_, self.uncertainty, self.clocks)
        self._starts = Starts(filter_, self.uncertainty, self.clocks)
        each = zip(filter_.members.family.names, filter_.members.considered, strict=True)
        self._names = tuple("" if considered else name for name, considered in each)
        self._estimates_parameters = bool(
            any(self._names)
            or len(self.clocks) > 1
            or learns_error
            or self.uncertainty.clock_offset_error
        )

    def begin(self, replicas: Matrix, root: Matrix, closed: Contacts) -> Belief:
        """The declared covariance, with closed contacts at rest."""
        state = self._bank.filter.begin(self._starts.declared(replicas, root, closed))
        fallback = _begun(replicas[0], root)
        return self._posterior(self._starts.per_clock(state), fallback, Fit())

    def correct(self, change: ContactChange, belief: Belief) -> Belief:
        """Each hypothesis branches and is weighed; the estimate is that of the likeliest."""
        if not change.hit and change.before == change.closed:
            return belief
        corrected = self._corrected(change, belief)
        if not (change.hit and corrected.accepted):
            return corrected
        return corrected._replace(onset=Onset(belief.x, change.hit))

    def _corrected(self, change: ContactChange, belief: Belief) -> Belief:
        hypotheses, fallback = self._hypotheses_of(belief, change.before)
        count = 1 + belief.ensemble.others
        restarts = partial(
            self._starts.restarts, fallback, change.closed, count, hypotheses[0].state
        )
        weighed = self._bank.weighed(change, hypotheses, restarts, fallback.extent)
        corrected = normalised(weighed) or restarts()
        fit = fitted(belief.fit, change, hypotheses[0].state, corrected, self._bank)
        return self._posterior(corrected, fallback, fit, change)

    def impact_balance(
        self, change: ContactChange, before: Belief, prediction: Prediction, after: Belief | None
    ) -> ImpactBalance:
        """The balance of the contacts that hit, with deviations, at the estimated instant.

        The state just before is that of the likeliest hypothesis, corrected by the impact. Where
        the model is doubted, the covariance is the published one. After a restart the state is so,
        too, and its deviations are at least as large as the gap at the stamp is wrong.
        """
        conditioning, hypotheses = self.filter.conditioning, (after or before).hypotheses
        state = self._published(before, prediction, change)
        if after is None:
            joint = conditioning.joint_of_missed(change, state)
        else:
            clock, prior = _clock(hypotheses), prediction.belief(change.flown)
            if (met := _met(change, prior, after)) is not None:
                state = met
            else:
                z = conditioning.likelihood(change, state, clock).innovations.values()
                state = state._replace(root=max(1.0, *z) * state.root)
            change = change.from_closed(state.closed)
            early = conditioning.joint_prior(change, state, clock)
            joint = conditioning.joint_posterior(change, early)
        sizes = self.filter.scales.sizes(joint.x)
        least = self.uncertainty.least_deviations(joint.x, sizes)
        kicks = np.zeros_like(joint.x)[:, None]
        level = mean_level(hypotheses, ErrorKind.RESTITUTION)
        if level and self._bank.errors is not None:
            kicks = level * self._bank.errors.kicks(joint.x, change.hit)
        return balance_at(self.filter.members, change, joint, least, kicks[self.system.n :])

    def _published(
        self, before: Belief, prediction: Prediction, change: ContactChange
    ) -> GaussianState:
        """The published estimate at the stamp of an impact."""
        best, root = before.hypotheses[0].state, prediction.root(change.flown)
        assert root is not None, "the law has a covariance"
        constants = lengths(best.root[best.x.size :])
        x, root = prediction.state(change.flown), linalg.block_diag(root, np.diag(constants))
        return best._replace(x=x, root=root, differences=np.zeros((len(root), 0)))

    def measure(self, reading: Reading, prior: Belief) -> tuple[Belief, SampleOutcome]:
        """Each hypothesis is corrected and weighed; those with other parameters too."""
        closed = reading.closed
        hypotheses, fallback = self._hypotheses_of(prior, closed)

        def restart() -> GaussianState:
            count, before = 1 + prior.ensemble.others, hypotheses[0].state
            return self._starts.restarts(fallback, closed, count, before)[0].state

        found, outcome = self._samples.after(reading, hypotheses, fallback.largest, restart)
        if len(found) == len(hypotheses) == 1 and found[0].state is hypotheses[0].state:
            return prior, outcome
        return self._measured(found, fallback, prior.fit), outcome

    def followed(
        self, readings: Sequence[Reading], posterior: Belief, since: float, s: float
    ) -> tuple[Belief, list[SampleOutcome]] | None:
        """By a short way, where nothing is in doubt and the filter's own estimate is published."""
        if posterior.fallback is None:
            return None
        made = self._samples.followed(readings, posterior.hypotheses, since, s)
        if made is None:
            return None
        return self._measured(made[0], posterior.fallback, posterior.fit), made[1]

    def _measured(
        self,
        found: tuple[Hypothesis, ...],
        fallback: Fallback,
        fit: Fit,
    ) -> Belief:
        """The belief of hypotheses after a sample; its covariance is found when asked for."""
        found, state = _best_first(found, fit)
        return Belief(
            state.ensemble,
            fit=fit,
            clock_offset=state.offset,
            learned=Learned(partial(self._learned_of, found, fit)),
            hypotheses=found,
            fallback=fallback,
            misfit=fit.message("", self.misfit) if fit.is_misfit else "",
        )

    def _learned_of(self, hypotheses: Sequence[Hypothesis], fit: Fit) -> Parameters:
        """What hypotheses estimate besides the state."""
        shown = _shown(hypotheses, fit)
        size = hypotheses[0].state.x.size
        return self._learned(shown, mixture(shown).root[size:], self._names)

    @cached_property
    def _samples(self) -> SampleUpdate:
        return SampleUpdate(self._bank)

    def predict(self, t: float, belief: Belief, closed: Contacts) -> Prediction:
        """The likeliest hypothesis for the estimate, all of them for the next event."""
        hypotheses, fallback = self._hypotheses_of(belief, closed)

        def prior(s: float) -> Belief:
            predicted = self._bank.between.predict(hypotheses, t, s)
            return self._prior(predicted, fallback, belief.fit)

        found = predicted_by(self._bank, t, partial(_shown, hypotheses, belief.fit), prior)
        some = partial(agreeing, hypotheses, self.near(hypotheses[0].state.x))
        found.agreeing = predicted_by(self._bank, t, some, prior)
        return found

    def near(self, x: Vector) -> System:
        """The system at a state ``x``, shape (2n,)."""
        return self._bank.filter.near(x)

    @property
    def filter(self) -> ImpactFilter:
        """Predicts and corrects one state."""
        return self._bank.filter

    def prior(self, x: Vector, root: Matrix) -> GaussianState:
        """What is declared of a start at ``x`` = (q, u) with a root of its covariance."""
        return self._starts.declared(x[None], root, ())

    def _hypotheses_of(
        self, belief: Belief, closed: Contacts
    ) -> tuple[tuple[Hypothesis, ...], Fallback]:
        """Hypotheses and fallback of a belief; one without them gets those of a start."""
        if belief.fallback is not None:
            hypotheses = belief.hypotheses
            return hypotheses, _beside(belief.fallback, hypotheses[0].state.x)
        assert belief.root is not None, "a belief of another law"
        state = self._starts.declared(belief.replicas, belief.root, closed)
        return self._starts.per_clock(state), _begun(belief.x, belief.root)

    def _prior(self, hypotheses: tuple[Hypothesis, ...], fallback: Fallback, fit: Fit) -> Belief:
        """The belief of ``hypotheses``, the likeliest first, without a covariance."""
        hypotheses, state = _best_first(hypotheses, fit)
        return Belief(state.ensemble, fit=fit, hypotheses=hypotheses, fallback=fallback)

    def _posterior(
        self,
        hypotheses: tuple[Hypothesis, ...],
        fallback: Fallback,
        fit: Fit,
        change: ContactChange | None = None,
    ) -> Belief:
        """The belief of ``hypotheses`` with their covariance, after a ``change`` if any."""
        hypotheses, state = _best_first(hypotheses, fit)
        shown, size = _shown(hypotheses, fit), fallback.x.size
        whole, best = mixture(shown).root, shown[0]
        notes = best.ledger.notes_on((change.stamp, change.sequence)) if change else []
        return Belief(
            state.ensemble,
            whole[:size],
            innovations={n.contact: n.innovation for n in notes if n.innovation >= 0},
            accepted=all(note.ruling is Ruling.APPLIED for note in notes),
            clock_offset=best.state.offset,
            learned=Learned(partial(self._learned, shown, whole[size:], self._names)),
            fit=fit,
            hypotheses=hypotheses,
            fallback=fallback,
            misfit=fit.message("", self.misfit),
        )

    def _learned(
        self,
        hypotheses: Sequence[Hypothesis],
        root: Matrix,
        names: Sequence[str],
    ) -> Parameters:
        """Estimated parameters of model and clock: name, value, standard deviation.

        ``root`` has the rows of the mixture's root for the constants, shape (k, any); ``names``
        are those of the model's parameters, empty for considered ones. Those that no hypothesis
        doubts are left out.
        """
        if not self._estimates_parameters:
            return ()
        best, deviations = hypotheses[0].state, lengths(root)
        rows = zip(names, best.theta.tolist(), deviations, strict=False)
        found = [row for row in rows if row[0] and row[2]]
        learned = {}
        if len(self.clocks) > 1:
            learned["clock_error"] = [h.clock for h in hypotheses]
        if self.uncertainty.model_error is None:
            for kind in (ErrorKind.ACCELERATION, ErrorKind.RESTITUTION):
                learned[kind.value] = [h.error.level * (h.error.kind is kind) for h in hypotheses]
        weights = probabilities(hypotheses)
        for name, values in learned.items():
            mean = float(weights.dot(values))
            variance = float(weights.dot((np.array(values) - mean) ** 2))
            found.append((name, mean, math.sqrt(variance)))
        if len(best.constants) > best.parameters:
            offset = best.offset
            found.append(("clock_offset", offset, deviations[-1]))
        return tuple(found)


def _begun(x: Vector, root: Matrix) -> Fallback:
    """Where the filter restarts: at the estimate, as what is measured bounds its error."""
    return Fallback(x, np.linalg.norm(root, axis=1))


def _beside(before: Fallback, x: Vector) -> Fallback:
    return Fallback(x, np.maximum(before.largest, np.abs(x)))


def _best_first(
    hypotheses: tuple[Hypothesis, ...], fit: Fit
) -> tuple[tuple[Hypothesis, ...], GaussianState]:
    """``hypotheses`` with the first of ``_shown`` first, and its state."""
    if len(hypotheses) > 1:
        if fit.is_misfit or fit.is_in_error:
            best = _shown(hypotheses, fit)[0]
        else:
            best = max(hypotheses, key=attrgetter("weight"))
        if hypotheses[0] is not best:
            hypotheses = tuple(sorted(hypotheses, key=lambda h: h is not best))
    return hypotheses, hypotheses[0].state


def _met(change: ContactChange, before: Belief, after: Belief) -> GaussianState | None:
    """The mixture of the hypotheses before an impact from which the likeliest after it may come.

    None where the likeliest one comes from no other.
    """
    event = change.stamp, change.sequence
    notes = [note for note in after.hypotheses[0].ledger.notes if note.event == event]
    missed = sum(note.is_inserted for note in notes)
    is_new = any(note.reason.startswith(RESTART) for note in notes)
    own = [h for h in before.hypotheses if len(h.ledger.missed) == missed]
    if not own or is_new:
        return None
    shown = _shown(own, before.fit)
    return mixture([h for h in shown if h.state.closed == shown[0].state.closed])


def _clock(hypotheses: Sequence[Hypothesis]) -> float:
    """The root mean square of the deviations of a stamp, s."""
    squares = np.array([h.clock**2 for h in hypotheses])
    return math.sqrt(float(np.average(squares, weights=probabilities(hypotheses))))


def _shown(hypotheses: Sequence[Hypothesis], fit: Fit) -> Sequence[Hypothesis]:
    """Those whose mixture is published."""
    if len(hypotheses) == 1:
        return hypotheses
    return published(hypotheses, misfit=fit.is_misfit or fit.is_in_error)
