# SPDX-License-Identifier: Apache-2.0
"""Hypotheses at a start or restart, before any event has corrected them."""

import math
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from impact_observer.events import Contacts
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.uncertainty import Uncertainty, spread
from impact_observer.observer.belief import Fallback
from impact_observer.states import Matrix


class Starts:
    """Makes the first hypotheses of a bank.

    Attributes:
        filter: filter of the bank.
        uncertainty: the declared uncertainty.
        clocks: possible standard deviations of a stamp, s.
    """

    def __init__(
        self, filter_: ImpactFilter, uncertainty: Uncertainty, clocks: Sequence[float]
    ) -> None:
        """Starts of hypotheses for ``filter_``."""
        self.filter = filter_
        self.uncertainty = uncertainty
        self.clocks = clocks

    def restarts(
        self, fallback: Fallback, closed: Contacts, count: int, before: GaussianState
    ) -> tuple[Hypothesis, ...]:
        """Hypotheses of a restart: standard deviations as large as the motion was, any clock.

        ``count`` is the number of replicas. Where the clock has an offset in the state ``before``
        that was not declared, its value and deviation stay.
        """
        root = np.diag(fallback.largest)
        replicas = spread(fallback.x, root, count)
        state = self.declared(replicas, root, closed)
        if len(before.constants) > len(state.constants):
            deviation = float(np.linalg.norm(before.root[-1]))
            state = state.with_offset_error(deviation, before.offset)
        return self.per_clock(self.filter.begin(state))

    def per_clock(self, state: GaussianState) -> tuple[Hypothesis, ...]:
        """One hypothesis for each accuracy of the clock, all equally likely."""
        weight = -math.log(len(self.clocks))
        return tuple(Hypothesis(state, clock, weight) for clock in self.clocks)

    def declared(self, replicas: Matrix, root: Matrix, closed: Contacts) -> GaussianState:
        """``replicas`` and ``root``, with parameters and clock offset as they were declared."""
        unknowns, late = self.uncertainty.unknowns, self.uncertainty.clock_offset_error
        of_constants = [] if unknowns is None else [unknowns.root]
        of_constants += [np.array([[late]])] if late else []
        whole = linalg.block_diag(root, *of_constants) if of_constants else root
        state = GaussianState.of(replicas, whole, closed)
        if unknowns is None:
            return state
        p, nominal = unknowns.family.size, np.append(replicas[0], unknowns.family.nominal)
        size = nominal.size
        others = spread(nominal, whole[:size, : root.shape[1] + p], len(replicas))
        constants, differences = state.constants.copy(), state.differences.copy()
        constants[:p] = unknowns.family.nominal
        differences[size - p : size] = (others[1:] - nominal)[:, size - p :].T
        return state._replace(constants=constants, differences=differences, parameters=p)
