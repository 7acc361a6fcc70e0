# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter of impact times on arrays, with two ladders of doubt (``bank``)."""

# ruff: noqa: D102 (overrides have the docstrings of ``Prediction``)

from typing import ClassVar, cast

import numpy as np

from impact_observer.bank.bank import SPURIOUS, Bank
from impact_observer.bank.course import Course
from impact_observer.bank.impact_bank import ImpactBank
from impact_observer.dynamics.tangent import Tangent
from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.ensemble import Ensemble
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.model import System
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.laws.law import Law
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

_NARROW = 0.05
"""Largest deviation of a synchronized estimate, over the motion."""


class LadderVariance(Law):
    """The estimate of least variance of a bank of hypotheses on levels of errors.

    Attributes:
        filter: the bank's filter.
    """

    name: ClassVar[str] = "ladder-variance"
    has_covariance: ClassVar[bool] = True

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare the filter."""
        super().__init__(system, uncertainty)
        own = self.uncertainty
        self.filter = ImpactBank(
            Tangent(ParametricFamily(system, ())),
            clock=own.clock_error,
            error=own.model_error,
            missed=own.missed,
            spurious=own.spurious,
            mislabelled=own.mislabelled,
        )

    def begin(self, replicas: Matrix, root: Matrix, closed: Contacts) -> Belief:
        """The declared covariance, on the first rungs."""
        return self._belief(self.filter.begin(Elapsed(0), replicas[0], root, closed), 0.0)

    def _belief(self, bank: Bank, s: float) -> Belief:
        x, root = Course(self.filter, bank).estimate(s)
        return Belief(Ensemble(x, root), root, bank=bank, behind=(0.0, s))

    def predict(self, t: float, posterior: Belief, closed: Contacts) -> Prediction:
        """The bank's own course."""
        del closed
        assert posterior.bank is not None, "a belief of this law"
        return BankPrediction(self, posterior.bank._replace(t=cast(Elapsed, t)))

    def correct(self, change: ContactChange, prior: Belief) -> Belief:
        """Every hypothesis branches, and is weighed."""
        bank, s = prior.bank, prior.behind[1]
        assert bank is not None, "a belief of this law"
        t = cast(Elapsed, change.t)
        bank = self.filter.predicted(bank._replace(t=t + -s), s, change.hit)._replace(t=t)
        for contact in change.hit:
            bank = self.filter.hit(bank, contact)
        posterior = self._belief(bank, 0.0)
        best = int(np.argmax(bank.rows.logw))
        is_true = bank.rows.past[best, -1] % 8 != SPURIOUS
        return posterior._replace(accepted=bool(is_true))

    def doubt(self, belief: Belief, root: Matrix) -> str | None:
        """Which deviation is too wide; empty if none is."""
        assert belief.bank is not None, "a belief of this law"
        ratio = np.sqrt(np.einsum("ij,ij->i", root, root)) / belief.bank.sizes
        widest = int(np.argmax(ratio))
        if ratio[widest] <= _NARROW:
            return ""
        names = self.system.coordinates
        what = "velocity" if widest >= len(names) else "position"
        name, share = names[widest % len(names)], ratio[widest]
        return f"{what} of {name} is known to {share:.0%} of its motion"


class BankPrediction(Prediction):
    """A bank as a function of time until the next event."""

    def __init__(self, law: LadderVariance, bank: Bank) -> None:
        self._law, self._bank = law, bank
        self._course = Course(law.filter, bank)

    def state(self, s: float) -> Vector:
        return self._course.estimate(s)[0]

    def states(self, s: Vector) -> Matrix:
        return self._course.states(s)

    def root(self, s: float) -> Matrix:
        return self._course.estimate(s)[1]

    def belief(self, s: float) -> Belief:
        x, root = self._course.estimate(s)
        return Belief(Ensemble(x, root), root, bank=self._bank, behind=(0.0, s))
