# SPDX-License-Identifier: Apache-2.0
"""Comparison of laws on a simulated run, as in Figure 2 of Baumann and Leine (ENOC 2014)."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from impact_observer.compare.bag_comparison import BagComparison
from impact_observer.compare.comparison import compare_replicas, impacts_in
from impact_observer.io.bag_part import TimeZero
from impact_observer.io.pairing import samples_of
from impact_observer.model import Model
from impact_observer.observer import make_observer
from impact_observer.options import Options
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import NS_PER_S, from_seconds, grid, seconds_between

LAWS = "kinematic,geometric"
"""The laws of the paper's figure."""
INITIAL = "random:1"
"""Initial state of the observers where none is given."""
EPOCH = NS_PER_S
"""Stamp of t = 0, ns."""
RATE = 100.0
"""Rate of the samples that are compared, Hz."""


def compare_simulated(
    model: Model,
    options: Sequence[Options],
    duration: float,
    *,
    progress: Callable[[str, float, float], None] = lambda _what, _done, _all: None,
) -> BagComparison:
    """Simulate ``duration`` s of a linear model with an ideal sensor, and run observers on it.

    The ``options`` are those of the observers, one a law. ``progress`` receives the name of the
    work, the amount done, and the whole amount.

    Raises:
        UsageError, ModelError: the options or the initial state cannot be used.
        ImpactLawError, DynamicsError: plant or observer cannot go on.
    """
    # The ensemble is left out: no estimate depends on the ensemble.
    observers = [
        make_observer(model.system, replace(each, ensemble=1, epoch=EPOCH)) for each in options
    ]
    run = simulate(
        Plant(model.system, *model.initial_state(), epoch=EPOCH),
        grid(EPOCH, EPOCH + from_seconds(duration), RATE),
        progress=lambda stamp: progress("simulating", seconds_between(EPOCH, stamp), duration),
    )
    truth = samples_of(run.stamps, run.states)
    comparisons = {
        observer.law.name: compare_replicas(
            observer,
            run.events,
            truth,
            progress=partial(progress, observer.law.name),
        )[0]
        for observer in observers
    }
    return BagComparison(model.system, comparisons, impacts_in(run.events), TimeZero(EPOCH))
