# SPDX-License-Identifier: Apache-2.0
"""The observer's laws: how a replica is corrected while the plant's ``chi`` is 1.

Each law has its file. Another package adds a law by an entry point in the group
``impact_observer.laws``.
"""

from importlib.metadata import entry_points

from impact_observer.errors import UsageError
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.kinematic import Kinematic
from impact_observer.observer.laws.law import Law
from impact_observer.observer.laws.measured_position import MeasuredPosition
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.observer.laws.open_loop import OpenLoop
from impact_observer.observer.laws.replica_law import ReplicaLaw
from impact_observer.observer.laws.unilateral import Unilateral
from impact_observer.process_end import place_in

__all__ = ["BUILT_IN", "OWN_LAWS", "Law", "ReplicaLaw", "law_named", "law_names"]

ENTRY_POINTS = "impact_observer.laws"
BUILT_IN: dict[str, type[Law]] = {
    law.name: law for law in (OpenLoop, Kinematic, Geometric, Unilateral, MinimumVariance)
}
"""Laws of linear systems."""
OWN_LAWS: dict[str, type[Law]] = {**BUILT_IN, MeasuredPosition.name: MeasuredPosition}
"""All laws of this package; the last one takes robots alone."""


def law_names() -> tuple[str, ...]:
    """Names of all laws that are installed, the built-in ones first."""
    others = sorted(entry.name for entry in entry_points(group=ENTRY_POINTS))
    return (*OWN_LAWS, *(name for name in others if name not in OWN_LAWS))


def law_named(name: str) -> type[Law]:
    """The law called ``name``.

    Raises:
        UsageError: the law is not installed, or its entry point cannot be imported or is no law.
    """
    if name in OWN_LAWS:
        return OWN_LAWS[name]
    for entry in entry_points(group=ENTRY_POINTS, name=name):
        try:
            law = entry.load()
        except Exception as error:  # noqa: BLE001 (what a user's module may raise)
            where = place_in(entry.module.partition(".")[0], error)
            found = f"{type(error).__name__}{where}: {error}"
            raise UsageError(f"law {name!r}: {entry.value} cannot be imported: {found}") from None
        if isinstance(law, type) and issubclass(law, Law):
            return law
        raise UsageError(f"law {name!r}: {entry.value} is not a subclass of Law")
    raise UsageError(f"law {name!r}: not installed; expected one of {', '.join(law_names())}")
