# SPDX-License-Identifier: Apache-2.0
"""The smoothed events of a recording: their account, and the motion that explains them all."""

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np

from impact_observer.errors import BagError, DynamicsError
from impact_observer.events import ImpactEstimate, ImpactEvent, Verdict
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.model import Model, System
from impact_observer.model.measurement import Measurement
from impact_observer.observer import (
    Observer,
    Options,
    initial_state,
    make_observer,
    replay_batches,
)
from impact_observer.observer.encoder_start import EncoderStart
from impact_observer.observer.event_order import EventKey
from impact_observer.observer.make_observer import encoder_start
from impact_observer.observer.replay import Impacts, noting_impacts
from impact_observer.observer.samples import SensorSample
from impact_observer.observer.sender_runs import placed
from impact_observer.robots.robot import Robot, robot_of
from impact_observer.smooth.account import EventAccount, TracedLaw, account_of, start_of
from impact_observer.smooth.arc import Arc, Node
from impact_observer.smooth.backward import Retracing
from impact_observer.smooth.smoothed_motion import NO_DOUBT, Doubt, SmoothedMotion
from impact_observer.smooth.smoother import OTHER, Smoothed, smooth, with_remainders
from impact_observer.stamps import MAX_STAMP, Elapsed
from impact_observer.states import Estimates, Stamps

Progress: TypeAlias = Callable[[str, int, int], None]
"""Called with the name of the job, the part done, and the total."""

_MOST_ROUNDS = 2
"""Rounds in which other accounts of the events are tried."""
_SEARCHED = 80
"""Events at the beginning of which other accounts are tried."""
_RETRACED = 4
"""Moments from which the motion is followed back."""
_UNLIKELY = 0.003
"""Least odds of another account that is reported."""
_FITTED = 30.0
"""Prior deviations of parameters that were fitted to the same events, relative to the declared:
the events count 0.1 % twice.
"""
_SURE, _WIDER = 3.0, (0.0, 0.1, 0.3)
"""Standard deviations of the start of filters of other accounts, relative to the smoothed and to
the declared ones.
"""


def no_progress(what: str, done: int, total: int) -> None:
    """Do nothing."""
    del what, done, total


def no_inputs(observer: Observer) -> None:
    """Give the observer no inputs."""
    del observer


def smoothed_runs(
    model: Model | System,
    events: Sequence[ImpactEvent],
    options: Options,
    *,
    measurements: Sequence[Measurement] = (),
    samples: Sequence[SensorSample] = (),
    progress: Progress = no_progress,
    give: Callable[[Observer], object] = no_inputs,
    unknowns: UnknownParameters | None = None,
    thorough: bool = True,
) -> list[SmoothedMotion]:
    """The smoothed motion in each run of the sender in a recording, in order.

    Args:
        model: the model, or the system alone.
        events: in order of reception, or as ``sender_runs.in_order`` has them.
        options: of the observer.
        measurements: measurements of sensors beside the impacts.
        samples: samples of these sensors, in order of stamps.
        progress: see ``Progress``.
        give: gives an observer the recorded samples of live inputs.
        unknowns: uncertain parameters; None for those of options and model.
        thorough: whether other accounts of the events than the filter's are tried.

    Raises:
        UsageError: an option cannot be used.
        BagError: no event could be applied.
        DynamicsError: no motion explains the events, or one of them has no solution.
    """
    runs: dict[int, list[ImpactEvent]] = {}
    for each in placed(events, options.epoch):
        if each.period >= 0:
            runs.setdefault(each.period, []).append(each.event)
    if not runs:
        raise BagError("it holds no impact")
    robot = robot_of(model) if isinstance(model, Model) and model.robot is not None else None
    encoders = encoder_start(options, robot, measurements)
    made = partial(
        make_observer,
        model,
        _own(options),
        law=TracedLaw,
        measurements=measurements,
        unknowns=unknowns,
    )
    known = model.uncertainty if isinstance(model, Model) else None
    is_fitted = known is not None and known.is_fitted_to(each.stamp for each in events)
    begins = [min(each.stamp for each in run) for run in runs.values()]
    motions = list[SmoothedMotion]()
    for run, begin, end in zip(runs.values(), begins, [*begins[1:], MAX_STAMP + 1], strict=True):
        own = [
            each for each in samples if (begin <= each.stamp or not motions) and each.stamp < end
        ]
        start = None if encoders is None else encoders.anew()
        each_run = _Run(
            run,
            own,
            options,
            made,
            give,
            encoders=start,
            is_fitted=is_fitted,
            progress=progress,
        )
        motions.append(each_run.motion(thorough=thorough))
    if not any(each.account.moments for each in motions):
        raise BagError("no impact was applied")
    return motions


def _own(options: Options) -> Options:
    """The options of the filter that makes the account."""
    return replace(options, law=TracedLaw.name, ensemble=1)


class _Trial(NamedTuple):
    """An account of the events, and the motion that explains it best.

    Attributes:
        law: the law that has made the account.
        account: the meaning of each event.
        smoothed: the motion.
        epoch: stamp of ``t = 0`` of the forcing, ns; 0 while unknown.
    """

    law: TracedLaw
    account: EventAccount
    smoothed: Smoothed
    epoch: int


def _evidence(trial: _Trial) -> float:
    """Logarithm of the probability density of the events by an account."""
    prior = trial.law.log_priors
    dead = trial.account.in_dead_time(trial.law.uncertainty.dead_time)
    return (
        trial.smoothed.evidence
        + trial.account.rejected * prior.spurious
        + sum(
            prior.missed if each.is_inserted else prior.reported
            for k, each in enumerate(trial.account.moments)
            if k not in dead
        )
    )


def _doubt(best: _Trial, trials: Sequence[_Trial]) -> Doubt:
    """The likeliest other account of the events, or other motion, with another first state."""
    doubt = NO_DOUBT
    for each in trials:
        odds = math.exp(min(_evidence(each) - _evidence(best), 0.0))
        if each is best or not each.smoothed.is_settled or odds <= max(doubt.odds, _UNLIKELY):
            continue
        far = best.smoothed.distance(each.smoothed)
        if far > OTHER:
            doubt = Doubt(odds, far, _same_from(best.account, each.account))
    return doubt


def _same_from(account: EventAccount, other: EventAccount) -> int:
    """The stamp of the first moment from which on two accounts are the same, ns."""
    stamp = max(each.change.stamp for each in account.moments)
    pairs = zip(reversed(account.moments), reversed(other.moments), strict=False)
    decided = zip(reversed(account.decisions), reversed(other.decisions), strict=False)
    for (mine, _), (a, b) in zip(pairs, decided, strict=False):
        if a != b:
            break
        stamp = mine.change.stamp
    return stamp


class _Run:
    """The events of one run of the sender, and their declarations."""

    def __init__(
        self,
        events: Sequence[ImpactEvent],
        samples: Sequence[SensorSample],
        options: Options,
        make: Callable[[], Observer],
        give: Callable[[Observer], object],
        *,
        encoders: EncoderStart | None,
        is_fitted: bool,
        progress: Progress,
    ) -> None:
        self._is_fitted = is_fitted
        self._events, self._samples = events, samples
        self._options, self._progress = options, progress
        self._make, self._give = make, give
        self._encoders = encoders
        if encoders is not None:
            encoders.note(EventKey.measured(s.stamp, s.sensor, s.value) for s in samples)
            if encoders.lacking:
                raise BagError(f"it holds no sample of the encoder of {encoders.lacking[0]}")
        self._trials = list[_Trial]()

    def motion(self, *, thorough: bool) -> SmoothedMotion:
        """The motion by the likeliest account of all events.

        The filter's first decisions are uncertain. So other accounts of the first events are
        tried, until no account is likelier: all events as reported, accounts by ``Retracing``, and
        accounts of filters that begin about the smoothed start. Unless ``thorough``, none of
        these is tried.
        """
        few = self._events[:_SEARCHED]
        best = self._tried(few)
        is_open = thorough and not isinstance(best.law.system, Robot)  # encoders tell the state
        if is_open and not best.law.uncertainty.trusts_events:
            best = self._searched(best, few)
        doubt = _doubt(best, self._trials)
        if len(self._events) > len(few):
            best = self._tried(self._events, best.smoothed)
        best = best._replace(smoothed=with_remainders(best.smoothed))
        return self._as_motion(best, doubt)

    def _as_motion(self, best: "_Trial", doubt: Doubt = NO_DOUBT) -> SmoothedMotion:
        start = self._start(best.epoch)
        return SmoothedMotion(
            best.smoothed,
            best.account,
            best.law,
            start=start,
            epoch=best.epoch or start,
            doubt=doubt,
            filtered=self._filtered,
            filtered_impacts=self._filtered_impacts,
        )

    def _filtered(self, stamps: Stamps) -> Iterator[Estimates]:
        """The estimates of the filter at ``stamps``, ns."""
        _, made = self._replayed(stamps)
        yield from (each for each in made if isinstance(each, Estimates))

    def _filtered_impacts(self) -> Iterable[ImpactEstimate]:
        """The estimates of impacts by the filter."""
        observer, made = self._replayed(np.empty(0, dtype=np.int64))
        impacts: Impacts = {}
        deque(noting_impacts(made, observer, impacts), maxlen=0)
        return impacts.values()

    def _replayed(self, stamps: Stamps) -> tuple[Observer, Iterator[Estimates | Verdict]]:
        """An observer, and what it says of the events and at ``stamps``, ns."""
        observer, law = self._observer()
        law.forget()
        return observer, replay_batches(
            observer, self._events, stamps, rejects=True, by_stamps=True, samples=self._samples
        )

    def _searched(self, best: "_Trial", events: Sequence[ImpactEvent]) -> "_Trial":
        """The likeliest account of ``events``, in a search that begins with ``best``."""
        tried, reported = {best.account.decisions}, best.account.as_reported()
        if reported.decisions in tried and best.smoothed.is_settled:
            return best
        if reported.decisions not in tried:
            tried.add(reported.decisions)
            best = self._likelier(best, best.law, reported, best.epoch)
        for _ in range(_MOST_ROUNDS):
            before = best
            best = self._refined(self._retraced(best, tried), tried, events)
            if best is before:
                break
        return best

    def _retraced(self, best: "_Trial", tried: set[tuple[object, ...]]) -> "_Trial":
        """The likeliest of ``best`` and accounts that are retraced from several moments."""
        known, law, n = best.account, best.law, best.law.system.n
        count, given = len(known.moments), best.smoothed.known
        if known.decisions == known.as_reported().decisions:
            return best
        prior, begin = self._prior(law, best.epoch), self._begin(best.epoch)
        back = Retracing(law.filter, prior, begin)
        for first in range(n + 2, min(count - n, _RETRACED * n + 3), n):
            x = given.state(Node(first)).mean[1 : 1 + 2 * n]
            account = back.account(known, first, x)
            if account is None or account.decisions in tried:
                continue
            tried.add(account.decisions)
            best = self._likelier(best, law, account, best.epoch)
        return best

    def _refined(
        self,
        best: "_Trial",
        tried: set[tuple[object, ...]],
        events: Sequence[ImpactEvent],
    ) -> "_Trial":
        """The likeliest of ``best`` and accounts of filters that begin near its smoothed start."""
        for wider in _WIDER:
            observer, law = self._observer(best.smoothed, best.epoch, wider)
            account = self._account(observer, law, events)
            if account.decisions in tried:
                continue
            tried.add(account.decisions)
            best = self._likelier(best, law, account, observer.epoch)
        return best

    def _tried(self, events: Sequence[ImpactEvent], about: Smoothed | None = None) -> "_Trial":
        """The account of a filter that begins as declared, or ``about`` a smoothed start.

        If no motion explains that account, all events are taken as they were reported.
        """
        epoch = self._options.epoch or self._events[0].epoch
        observer, law = self._observer(about, epoch)
        account = self._account(observer, law, events)
        try:
            return self._evaluated(law, account, observer.epoch)
        except DynamicsError:
            return self._evaluated(law, account.as_reported(), observer.epoch)

    def _likelier(
        self, best: "_Trial", law: TracedLaw, account: EventAccount, epoch: int
    ) -> "_Trial":
        """The likelier of ``best`` and the trial of ``account``, if that has a motion."""
        try:
            return max(best, self._evaluated(law, account, epoch), key=_evidence)
        except DynamicsError:
            return best

    def _evaluated(self, law: TracedLaw, account: EventAccount, epoch: int) -> "_Trial":
        """An account with the motion that explains it best.

        Raises:
            DynamicsError: the motion grows beyond all bounds, or an impact has no solution.
        """
        whole = self._with_all_inputs(law, epoch)
        prior, begin = self._prior(whole, epoch), self._begin(epoch)
        arc = Arc(whole.filter, begin, prior, account.moments, account.samples)
        smoothed = smooth(arc, lambda done, total: self._progress("smoother", done, total))
        self._trials.append(_Trial(law, account, smoothed, epoch))
        return self._trials[-1]

    def _prior(self, law: TracedLaw, epoch: int) -> GaussianState:
        """The declared start.

        Parameters that were fitted to these events get a wide prior: the events determine them
        again, and count once.
        """
        system = law.system
        given = self._options
        if self._encoders is not None:
            x = self._encoders.state
        else:
            x = np.concatenate(initial_state(given.initial_state, system))
        if system.frame is not None:
            (x,) = system.to_frame(np.array([self._begin(epoch).ns]), x[None])
        prior = law.prior(x, law.uncertainty.root(system.n))
        if not self._is_fitted:
            return prior
        factors = np.ones(len(prior.root))
        factors[x.size : x.size + prior.parameters] = _FITTED
        return prior._replace(root=factors[:, None] * prior.root)

    def _with_all_inputs(self, law: TracedLaw, epoch: int) -> TracedLaw:
        """``law``; for a live system a fresh law with all recorded inputs."""
        if law.system.live is None:
            return law
        observer, law = self._observer()
        assert observer.live is not None, "the system is live"
        observer.live.follow(epoch)
        return law

    def _begin(self, epoch: int) -> Elapsed:
        """Seconds from the epoch to the start; 0 where the epoch is unknown."""
        start = self._start(epoch)
        return Elapsed(start - (epoch or start))

    def _start(self, epoch: int) -> int:
        """Stamp of the initial state, ns."""
        if self._encoders is not None:
            return self._encoders.stamp
        return start_of(self._events, epoch)

    def _observer(
        self, about: Smoothed | None = None, epoch: int = 0, wider: float = 0.0
    ) -> tuple[Observer, TracedLaw]:
        """An observer that has received nothing, as declared or ``about`` a smoothed start.

        About a smoothed start the deviations are ``_SURE`` times the smoothed ones, and ``wider``
        times the declared ones.
        """
        made = self._make()
        self._give(made)
        law = made.law
        assert isinstance(law, TracedLaw), "made with this law"
        if about is not None:
            start = self._start(epoch)
            n, first = law.system.n, about.first
            root = np.hstack([_SURE * first.root[: 2 * n], wider * law.uncertainty.root(n)])
            at = np.array([start - (epoch or start)])
            x = first.mean[: 2 * n]
            if law.system.frame is not None:
                (x,) = law.system.from_frame(at, x[None])
            made.set_state(start, x[:n], x[n:], root @ root.T)
        return made, law

    def _account(
        self, observer: Observer, law: TracedLaw, events: Sequence[ImpactEvent]
    ) -> EventAccount:
        total, samples = len(events), self._samples
        if total < len(self._events):
            last = max(each.stamp for each in events)
            samples = [each for each in samples if each.stamp <= last]
        return account_of(
            observer, law, events, samples, lambda done: self._progress("filter", done, total)
        )
