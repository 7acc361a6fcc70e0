"""One event applied: interpret it, predict the belief to its stamp, correct that by the law."""

from dataclasses import replace
from math import isfinite

from impact_observer.errors import DynamicsError, ImpactLawError
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.observer.belief import Prediction
from impact_observer.observer.event_order import EventKey, Superseding, interpret
from impact_observer.observer.laws.law import Law
from impact_observer.observer.synchronization import SynchronizationTest
from impact_observer.observer.timeline import Entry
from impact_observer.stamps import Elapsed, seconds_between, text


class EventUpdate:
    """Makes the entries of a timeline, each from the one before.

    Attributes:
        law: what the replicas do at an event, and in between.
        test: of their synchronization.
        epoch: stamp of ``t = 0`` of the forcing, ns; 0 while unknown.
    """

    def __init__(self, law: Law, test: SynchronizationTest, epoch: int) -> None:
        """Use ``law`` and ``test``."""
        self.law = law
        self.test = test
        self.epoch = epoch

    def apply(self, previous: Entry, event: EventKey, superseding: Superseding) -> Entry:
        """The entry of ``event``, from the one before it.

        Raises:
            ImpactLawError: the impact law has no solution.
            DynamicsError: the loads of closed contacts cannot be found, or the estimate is not
                finite.
        """
        meaning = interpret(event, previous.closed, previous.latest, superseding)
        if not meaning.switches:
            return replace(previous, key=event, latest=meaning.latest, overruled=meaning.overruled)
        stamp, s = event.stamp, seconds_between(previous.since, event.stamp)
        prior = self.prediction(previous).belief(s) if s > 0 else previous.belief
        change = ContactChange.of(
            Elapsed(stamp - (self.epoch or stamp)),
            previous.closed,
            meaning.switches,
            stamp=stamp,
            sequence=event.sequence,
            flown=s,
        )
        try:
            posterior = self.law.correct(change, prior)
        except ImpactLawError as error:
            raise ImpactLawError(f"at {text(stamp)} s: {error}") from None
        result = self.test.after(previous.synchronization, change, prior, posterior)
        if not isfinite(result.energy):
            raise DynamicsError(
                f"at {text(stamp)} s: the estimate is not finite any more; is the declared"
                " uncertainty too large, or the model another one?"
            )
        return Entry(
            event, stamp, posterior, result, change.closed, meaning.latest, meaning.overruled
        )

    def prediction(self, entry: Entry) -> Prediction:
        """The prediction from the belief of ``entry``, made once."""
        if entry.prediction is None:
            t = Elapsed(entry.since - (self.epoch or entry.since))
            entry.prediction = self.law.predict(t, entry.belief, entry.closed)
        return entry.prediction
