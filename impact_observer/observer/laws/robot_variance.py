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
from impact_observer.filter.branching import LogPriors
from impact_observer.filter.clock_steps import ClockStep, ClockSteps, SensorClock
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.ensemble import Ensemble
from impact_observer.filter.filter_bank import RESTART, FilterBank
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import (
    Hypothesis,
    agreeing,
    log_sum,
    mean_level,
    mixture,
    normalised,
    probabilities,
    published,
)
from impact_observer.filter.impact_deviations import balance_at
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.misfit import Fit, Residual, misfit_of
from impact_observer.filter.model_error import ErrorKind
from impact_observer.filter.readings import Reading, SampleOutcome
from impact_observer.filter.sample_update import SampleUpdate
from impact_observer.filter.square_root import lengths
from impact_observer.filter.tuning import TUNING
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.model import System
from impact_observer.observer.belief import (
    Accounts,
    Belief,
    Fallback,
    Learned,
    Onset,
    Parameters,
    Prediction,
)
from impact_observer.observer.laws.fallback import (
    DoubtedPrediction,
    MisfitPrediction,
    combined,
    doubted_root,
    nearest,
    replica_of,
)
from impact_observer.observer.laws.fitting import fitted
from impact_observer.observer.laws.kalman_predictions import predicted_by
from impact_observer.observer.laws.law import Law
from impact_observer.observer.laws.parameter_accounts import ParameterAccounts
from impact_observer.observer.laws.starts import Starts
from impact_observer.robots.robot import Robot
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Vector

_STAMP_ROUNDING = 1e-9 / math.sqrt(12)
"""Standard deviation of rounding a stamp to 1 ns, s."""


class RobotVariance(Law):
    """The estimate of least variance of a robot, from encoders and impact times.

    ``ImpactFilter`` corrects a state by events that are what they are reported to be;
    ``FilterBank`` weighs hypotheses of what else they may have been. The estimate is that of the
    likeliest hypothesis. Where it penetrates a stop by more than its standard deviation explains,
    an impact was missed, and it jumps at the predicted instant. Where the model does not explain
    the impacts, a geometric replica is weighed beside it.

    Attributes:
        clocks: possible standard deviations of a stamp, s.
        tries_steps: whether the sensor's clock may step.
        misfit: the warning that the model does not explain the impacts.
    """

    name: ClassVar[str] = "minimum-variance"
    has_covariance: ClassVar[bool] = True
    learns: ClassVar[bool] = True
    uses_measurements: ClassVar[bool] = True
    takes: ClassVar[tuple[type[System | Robot], ...]] = (Robot,)
    tries_steps: ClassVar[bool] = True

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
        self._doubts = (
            learns_error
            and not self.uncertainty.estimates_parameters
            and ParameterAccounts.are_affordable(system)
        )
        self._replica = replica_of(filter_)
        self._steps = ClockSteps(self._bank)
        self._tries_steps = (
            self.tries_steps and system.depends_on_time and self._replica.is_compared
        )
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
        fallback = self._replica.begin(replicas[0], root, closed)
        return self._posterior(self._starts.per_clock(state), fallback, Fit())

    def correct(self, change: ContactChange, belief: Belief) -> Belief:
        """Each hypothesis branches and is weighed; the estimate is that of the likeliest."""
        if not change.hit and change.before == change.closed:
            return belief
        corrected = self._corrected(change, belief)
        if not (change.hit and corrected.accepted):
            return corrected
        if corrected.clock.late != belief.clock.late:
            return corrected
        return corrected._replace(onset=Onset(belief.x, change.hit))

    def _corrected(self, change: ContactChange, belief: Belief) -> Belief:
        hypotheses, fallback = self._hypotheses_of(belief, change.before)
        belief = belief._replace(hypotheses=hypotheses)
        fallback = self._caught_up(belief, fallback, change.before)
        gap = (
            fallback.gap(self.near(fallback.x), change.hit[0])
            if change.hit
            else (math.nan, math.nan)
        )
        fallback = self._replica.after(change, fallback)
        count = 1 + belief.ensemble.others
        restarts = partial(
            self._starts.restarts, fallback, change.closed, count, hypotheses[0].state
        )
        weighed = self._bank.weighed(change, hypotheses, restarts, fallback.extent)
        clock = belief.clock
        if self._tries_steps and weighed:
            evidence = log_sum([h.weight for h in weighed])
            steps = self._steps.after(change, clock, evidence, fallback.extent)
            if steps and steps[0].odds > TUNING.largest_evidence:
                return self._stepped(change, clock, steps[0], fallback)
            clock = SensorClock(clock.late, None, steps)
        corrected = normalised(weighed) or restarts()
        return self._judged(change, belief._replace(clock=clock), corrected, fallback, gap)

    def _stepped(
        self, change: ContactChange, clock: SensorClock, step: ClockStep, fallback: Fallback
    ) -> Belief:
        """The belief after an event that has shown a ``step`` of the clock."""
        x = step.hypotheses[0].state.x
        fallback = fallback._replace(x=x, errors=np.zeros_like(fallback.errors))
        fit, clock = Fit(step=step.shift / NS_PER_S), SensorClock(clock.late + step.shift)
        return self._posterior(step.hypotheses, fallback, fit, None, change, clock=clock)

    def _judged(
        self,
        change: ContactChange,
        prior: Belief,
        corrected: tuple[Hypothesis, ...],
        fallback: Fallback,
        gap: tuple[float, float],
    ) -> Belief:
        """The belief after an event, by hypotheses and fallback after the event.

        The ``gap`` is that of the fallback before the event, with its deviation, m.
        """
        predicted = prior.hypotheses[0].state
        fit = fitted(prior.fit, change, predicted, corrected, self._bank)
        best, account = _shown(corrected, fit)[0], prior.account
        if account is not None:
            account = self._accounts.after(change, account, fallback)
        is_compared = self._replica.is_compared and fit is not prior.fit
        if change.hit and best.innovation is not None and is_compared:
            by_account = math.nan if account is None else account.few.residual
            fit = fit.compared(Residual(best.innovation.residual, *gap, by_account))
        change_of_few = 0.0 if account is None else self._accounts.few.change(account.few)
        fit = fit.beside(change_of_few)
        if not (self._doubts and fit.is_doubted):
            account = None
        elif account is None:
            clocks = sorted({self.clocks[0], corrected[0].clock})
            state = mixture(published(corrected, misfit=True))
            account = self._accounts.begin(state, fallback.largest, clocks)
        return self._posterior(corrected, fallback, fit, account, change, clock=prior.clock)

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
                is_doubted = prior.fit.is_compared or prior.account is not None
                state = met._replace(root=state.root if is_doubted else met.root)
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
        closed, account = reading.closed, prior.account
        hypotheses, fallback = self._hypotheses_of(prior, closed)

        def restart() -> GaussianState:
            now = self._caught_up(prior, fallback, closed)
            count, before = 1 + prior.ensemble.others, hypotheses[0].state
            return self._starts.restarts(now, closed, count, before)[0].state

        found, outcome = self._samples.after(reading, hypotheses, fallback.largest, restart)
        if len(found) == len(hypotheses) == 1 and found[0].state is hypotheses[0].state:
            return prior, outcome
        if account is not None:
            account = self._accounts.measured(reading, account, fallback.largest)
        if prior.fit.is_compared:
            return self._posterior(found, fallback, prior.fit, account), outcome
        posterior = self._measured(found, fallback, prior.fit, prior.behind)
        return posterior._replace(account=account), outcome

    def followed(
        self, readings: Sequence[Reading], posterior: Belief, since: float, s: float
    ) -> tuple[Belief, list[SampleOutcome]] | None:
        """By a short way, where nothing is in doubt and the filter's own estimate is published."""
        fit = posterior.fit
        fallback, (began, ago) = posterior.fallback, posterior.behind
        if fallback is None or posterior.account is not None or fit.is_compared:
            return None
        made = self._samples.followed(readings, posterior.hypotheses, since, s)
        if made is None:
            return None
        behind = (began, ago + s) if ago else (since, s)
        return self._measured(made[0], fallback, fit, behind), made[1]

    def _measured(
        self,
        found: tuple[Hypothesis, ...],
        fallback: Fallback,
        fit: Fit,
        behind: tuple[float, float],
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
            behind=behind,
            misfit=fit.message("", self.misfit) if fit.is_misfit else "",
        )

    def _caught_up(self, belief: Belief, fallback: Fallback, closed: Contacts) -> Fallback:
        """The ``fallback`` of a belief when that holds."""
        since, ago = belief.behind
        return self._replica.motion(since, fallback, closed)(ago) if ago else fallback

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
        account, (hypotheses, fallback) = belief.account, self._hypotheses_of(belief, closed)
        since, ago = belief.behind if belief.behind[1] else (t, 0.0)

        clock, moved = belief.clock, None
        if self._tries_steps:
            clock = clock._replace(before=ClockStep(0, t, hypotheses, 0.0))
        if belief.fit.is_compared:
            moved = self._replica.motion(since, fallback, closed)

        def prior(s: float) -> Belief:
            predicted = self._bank.between.predict(hypotheses, t, s)
            later = None if account is None else self._accounts.predicted(t, account, s)
            if moved is not None:
                made = self._prior(predicted, moved(ago + s), belief.fit, later)
            else:
                behind = since, ago + s
                made = self._prior(predicted, fallback, belief.fit, later, behind)
            return made._replace(clock=clock)

        found = predicted_by(self._bank, t, partial(_shown, hypotheses, belief.fit), prior)
        some = partial(agreeing, hypotheses, self.near(hypotheses[0].state.x))
        found.agreeing = predicted_by(self._bank, t, some, prior)
        if moved is None:
            if account is None:
                return found
            return DoubtedPrediction(found, self._accounts.wide.predict(t, account.wide, prior))

        def motion(s: float) -> Fallback:
            return moved(ago + s)

        if account is None:
            return MisfitPrediction(belief.fit, found, motion, None)
        by_wide = self._accounts.wide.predict(t, account.wide, prior)
        if not belief.fit.prefers_account:
            return MisfitPrediction(belief.fit, found, motion, None, by_wide)
        by_few = self._accounts.few.predict(t, account.few, prior)
        explained = account.few.is_explained
        return MisfitPrediction(belief.fit, found, motion, by_few, by_wide, explained=explained)

    def near(self, x: Vector) -> System:
        """The system at a state ``x``, shape (2n,)."""
        return self._bank.filter.near(x)

    @property
    def filter(self) -> ImpactFilter:
        """Predicts and corrects one state."""
        return self._bank.filter

    @property
    def log_priors(self) -> LogPriors:
        """What is assumed of any event."""
        return self._bank.branching.priors

    def prior(self, x: Vector, root: Matrix) -> GaussianState:
        """What is declared of a start at ``x`` = (q, u) with a root of its covariance."""
        return self._starts.declared(x[None], root, ())

    @cached_property
    def _accounts(self) -> ParameterAccounts:
        """Accounts with parameters, made when the model is doubted first."""
        return ParameterAccounts(self.system, self.uncertainty, self.clocks)

    def _hypotheses_of(
        self, belief: Belief, closed: Contacts
    ) -> tuple[tuple[Hypothesis, ...], Fallback]:
        """Hypotheses and fallback of a belief; one without them gets those of a start."""
        if belief.fallback is not None:
            hypotheses = belief.hypotheses
            return hypotheses, self._replica.beside(belief.fallback, hypotheses[0].state.x)
        assert belief.root is not None, "a belief of another law"
        state = self._starts.declared(belief.replicas, belief.root, closed)
        return self._starts.per_clock(state), self._replica.begin(belief.x, belief.root, closed)

    def _prior(
        self,
        hypotheses: tuple[Hypothesis, ...],
        fallback: Fallback,
        fit: Fit,
        account: Accounts | None = None,
        behind: tuple[float, float] = (0.0, 0.0),
    ) -> Belief:
        """The belief of ``hypotheses``, the likeliest first, without a covariance.

        By ``behind`` the ``fallback`` is still an earlier one.
        """
        hypotheses, ensemble = _estimate(hypotheses, fallback, fit, account)
        return Belief(
            ensemble,
            fit=fit,
            hypotheses=hypotheses,
            fallback=fallback,
            behind=behind,
            account=account,
        )

    def _posterior(
        self,
        hypotheses: tuple[Hypothesis, ...],
        fallback: Fallback,
        fit: Fit,
        account: Accounts | None = None,
        change: ContactChange | None = None,
        *,
        clock: SensorClock = SensorClock(),  # noqa: B008 (immutable)
    ) -> Belief:
        """The belief of ``hypotheses`` with their covariance, after a ``change`` if any."""
        hypotheses, ensemble = _estimate(hypotheses, fallback, fit, account)
        shown, size = _shown(hypotheses, fit), fallback.x.size
        best, whole, names, instead = shown[0], mixture(shown).root, self._names, ""
        root, notes = whole[:size], []
        if fit.is_compared:
            part, wide, explained = None, None, False
            if account is not None:
                far = self._accounts.wide.estimate(account.wide)
                wide = far.x, far.root[:size]
            if account is not None and fit.prefers_account:
                few = self._accounts.few
                found, instead = few.estimate(account.few), few.text(account.few)
                part, explained = (found.x, found.root[:size]), account.few.is_explained
                shown, whole, names = account.few.published, found.root, few.names
            own = None if explained else ((best.state.x, root), fallback)
            root = combined(fit, own, part, wide)
        elif account is not None:
            far = self._accounts.wide.estimate(account.wide)
            root = doubted_root((best.state.x, root), (far.x, far.root[:size]))
        if change:
            notes = best.ledger.notes_on((change.stamp, change.sequence))
        return Belief(
            ensemble,
            root,
            innovations={n.contact: n.innovation for n in notes if n.innovation >= 0},
            accepted=all(note.ruling is Ruling.APPLIED for note in notes),
            clock_offset=clock.late / NS_PER_S + best.state.offset,
            clock=clock,
            learned=Learned(partial(self._learned, shown, whole[size:], names, clock.late)),
            fit=fit,
            hypotheses=hypotheses,
            fallback=fallback,
            account=account,
            misfit=fit.message(instead, self.misfit),
        )

    def _learned(
        self,
        hypotheses: Sequence[Hypothesis],
        root: Matrix,
        names: Sequence[str],
        late: int = 0,
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
            offset = late / NS_PER_S + best.offset
            found.append(("clock_offset", offset, deviations[-1]))
        return tuple(found)


def _estimate(
    hypotheses: tuple[Hypothesis, ...], fallback: Fallback, fit: Fit, account: Accounts | None
) -> tuple[tuple[Hypothesis, ...], Ensemble]:
    """``hypotheses`` with the published one first, and the estimate with its replicas."""
    hypotheses, state = _best_first(hypotheses, fit)
    ensemble = state.ensemble
    if fit.is_compared:
        states = [ensemble.x, fallback.x]
        if account is not None and fit.prefers_account:
            states.append(account.few.published[0].state.x)
        ensemble = Ensemble(states[nearest(fit, len(states))], ensemble.columns)
    return hypotheses, ensemble


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
    if not own or is_new or after.clock.late != before.clock.late:
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
