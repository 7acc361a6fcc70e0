# SPDX-License-Identifier: Apache-2.0
"""Estimate the whole state of an impacting mechanical system from its impact times alone.

Rooms, each importing only from those before it: ``model``, ``dynamics``, ``robots``, ``plant``,
``bank``, ``observer``, ``io``, then the features ``detector``, ``draw``, ``compare``,
``batch``, ``check``, ``recording`` and ``sweep``, then ``ros`` and ``cli``. The modules beside
this file are the vocabulary that all rooms share: errors, stamps, events, states, options. The
first rooms, up to ``observer``, need numpy and scipy only; a ``Robot`` needs pinocchio.

The names below are imported when they are first used, so that ``--help`` stays quick.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from impact_observer.batch.fit_times import fit
    from impact_observer.events import ImpactEvent, Kind, Switch
    from impact_observer.model import Model, System, parse_model, read_model
    from impact_observer.observer import Observer, law_named
    from impact_observer.observer.make_observer import make_observer
    from impact_observer.observer.replay import replay
    from impact_observer.options import Options
    from impact_observer.plant import Plant, simulate
    from impact_observer.stamps import grid
    from impact_observer.states import Estimate

__version__ = "0.4.0"

_HOME = {
    "Estimate": "states",
    "ImpactEvent": "events",
    "Kind": "events",
    "Model": "model",
    "Observer": "observer",
    "Options": "options",
    "Plant": "plant",
    "Switch": "events",
    "System": "model",
    "fit": "batch.fit_times",
    "grid": "stamps",
    "law_named": "observer",
    "make_observer": "observer",
    "parse_model": "model",
    "read_model": "model",
    "replay": "observer",
    "simulate": "plant",
}
"""Where each public name is defined."""

__all__ = [
    "Estimate",
    "ImpactEvent",
    "Kind",
    "Model",
    "Observer",
    "Options",
    "Plant",
    "Switch",
    "System",
    "__version__",
    "fit",
    "grid",
    "law_named",
    "make_observer",
    "parse_model",
    "read_model",
    "replay",
    "simulate",
]


def __getattr__(name: str) -> object:
    """A public name, imported from its room."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    """The public names, for tab completion."""
    return sorted([*globals(), *_HOME])
