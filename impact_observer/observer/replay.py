"""A whole recording through an observer."""

from collections.abc import Iterator, Sequence

from impact_observer.events import ImpactEvent, Verdict
from impact_observer.observer.observer import Observer
from impact_observer.states import Estimate, Stamps


def replay(
    observer: Observer, events: Sequence[ImpactEvent], stamps: Stamps
) -> Iterator[Estimate | Verdict]:
    """Estimates at ``stamps``, each after all events at or before it, with all verdicts.

    Args:
        observer: has seen nothing yet.
        events: in order of episode, stamp and sequence.
        stamps: where to estimate, ns, ascending, shape (samples,). Those before the observer
            can know anything are passed over.

    Yields:
        Verdicts and estimates, in the order in which they come about.

    Raises:
        ImpactLawError, UsageError: as ``Observer.receive``.
    """
    pending = list(reversed(events))
    for stamp in stamps.tolist():
        while pending and _is_due(pending[-1], stamp, observer):
            yield from observer.receive(pending.pop())
        if observer.start is not None and observer.start <= stamp:
            yield observer.estimate(stamp)
    while pending:
        yield from observer.receive(pending.pop())


def _is_due(event: ImpactEvent, stamp: int, observer: Observer) -> bool:
    """Whether ``event`` bears on the state at ``stamp``: by its instant, or by a new epoch."""
    return event.stamp <= stamp or (event.epoch != observer.epoch and event.epoch <= stamp)
