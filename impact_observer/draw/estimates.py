# SPDX-License-Identifier: Apache-2.0
"""The choice of the estimates that are drawn of a bag, and their labels."""

from collections import Counter
from collections.abc import Mapping, Sequence

from impact_observer.errors import UsageError
from impact_observer.io.reader import BagReader
from impact_observer.io.state_arrays import JointStates, ObserverStates


def chosen_observers(
    reader: BagReader, observers: Sequence[str] | None, most: int
) -> tuple[str, ...]:
    """Prefixes of the observers that are drawn.

    Args:
        reader: the bag.
        observers: prefixes of the estimates' topics, with or without the first slash; None for
            all.
        most: largest number of estimates that fit.

    Raises:
        UsageError: an observer that is not in the bag, or too many observers.
    """
    present = reader.observers()
    chosen = present if observers is None else tuple(f"/{each.lstrip('/')}" for each in observers)
    for each in chosen:
        if each not in present:
            raise UsageError(
                f"observer {each}: not in {reader.path}; it has {', '.join(present) or 'none'}"
            )
    if len(chosen) > most:
        raise UsageError(
            f"{len(chosen)} observers: too many; name at most {most} with --observers:"
            f" {', '.join(present)}"
        )
    return tuple(dict.fromkeys(chosen))


def law_of(states: JointStates) -> str:
    """The law of an estimate; empty if the messages do not name a law."""
    return states.law if isinstance(states, ObserverStates) else ""


def labels_by_law(laws: Mapping[str, str]) -> dict[str, str]:
    """Label of each estimate: the law, with the topic's prefix if several have the same law.

    Args:
        laws: by prefix; empty where the messages do not name a law.
    """
    named = {prefix: law or prefix.lstrip("/") for prefix, law in laws.items()}
    count = Counter(named.values())
    return {
        prefix: f"{law} ({prefix.lstrip('/')})" if count[law] > 1 else law
        for prefix, law in named.items()
    }
