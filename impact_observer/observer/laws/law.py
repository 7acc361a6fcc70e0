# SPDX-License-Identifier: Apache-2.0
"""The interface of a law."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar

from impact_observer.bank.balance import ImpactState, balance_of
from impact_observer.dynamics import ImpactLaw
from impact_observer.dynamics.contact.impact_balance import ImpactBalance, impact_balance
from impact_observer.errors import UsageError
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.samples import Reading, SampleOutcome
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector


class Law(ABC):
    """How a belief is corrected by the events of the plant, and predicted in between.

    A law that corrects each replica by itself derives from ``ReplicaLaw``, which is simpler.

    Attributes:
        name: the name by which users choose the law.
        uses_events: whether events correct the replicas. Otherwise their agreement says nothing.
        has_covariance: whether the law estimates a covariance.
        learns: whether the law estimates unknown parameters of the model.
        uses_measurements: whether samples of sensors correct the replicas.
        takes: the kinds of systems whose states the law can estimate.
        system: the model of plant and replicas.
        uncertainty: the uncertainty that the user declares.
    """

    name: ClassVar[str]
    uses_events: ClassVar[bool] = True
    has_covariance: ClassVar[bool] = False
    learns: ClassVar[bool] = False
    uses_measurements: ClassVar[bool] = False
    takes: ClassVar[tuple[type[System | Robot], ...]] = (System,)

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare the law; without an ``uncertainty`` for the usual one.

        Raises:
            UsageError: the law does not take the system, or the declared uncertainty does not fit.
        """
        self.check_kind(type(system), system.name)
        self.system = system
        self.uncertainty = Uncertainty() if uncertainty is None else uncertainty
        self.uncertainty.root(system.n)

    @classmethod
    def check_kind(cls, kind: type[System | Robot], name: str) -> None:
        """Raise UsageError if the law does not take systems of this ``kind``, such as ``name``."""
        if issubclass(kind, cls.takes):
            return
        found = f"takes only robots, and {name} is a linear model"
        if issubclass(kind, Robot):
            found = f"takes no robot, as {name} is"
        raise UsageError(
            f"law {cls.name}: {found}; expected --law minimum-variance, or the same parameter of a"
            " node"
        )

    @cached_property
    def newton(self) -> ImpactLaw:
        """Newton's impact law with the masses of a linear system."""
        return ImpactLaw(self.system)

    @abstractmethod
    def begin(self, replicas: Matrix, root: Matrix, closed: Contacts) -> Belief:
        """The belief before any event, which satisfies the constraints of ``closed`` contacts.

        The ``replicas`` (q, u) have shape (N, 2n), the estimate first; ``root`` is a square root
        of its covariance, shape (2n, 2n).

        Raises:
            ImpactLawError: the impact law has no solution on these contacts.
        """

    @abstractmethod
    def correct(self, change: ContactChange, prior: Belief) -> Belief:
        """The posterior just after the ``change`` of contacts in an event.

        Raises:
            ImpactLawError: the impact law has no solution on these contacts.
            DynamicsError: the loads of closed contacts cannot be computed.
        """

    def impact_balance(
        self, change: ContactChange, before: Belief, prediction: Prediction, after: Belief
    ) -> ImpactBalance | None:
        """The balance of the contacts that hit; by default that of the estimate's own speeds.

        None where the belief ``after`` the event has them hit no more.

        The impact is ``change.flown`` seconds after the belief ``before``, from which the
        ``prediction`` goes, and just before the belief ``after``.

        Raises:
            ImpactLawError: the impact law has no solution.
        """
        del before, after
        u, active = prediction.state(change.flown)[self.system.n :], change.active
        impulses = self.newton.impulses(u, active)
        pressed = tuple(i for i, each in zip(active, impulses, strict=True) if each > 0)
        gamma = self.system.contact_speed(u)[list(active)]
        values = impact_balance(self.system, active, pressed, gamma)
        return ImpactBalance.without_deviations(values[[active.index(i) for i in change.hit]])

    def known_balance(self, state: ImpactState, belief: Belief) -> ImpactBalance:
        """The balance of an impact of which hypotheses of a ``belief`` know the ``state``.

        Raises:
            ImpactLawError: the impact law has no solution.
        """
        assert belief.bank is not None, "hypotheses"
        return balance_of(state, self.uncertainty.least_deviations(state.x, belief.bank.sizes))

    def measure(
        self, readings: Sequence[Reading], before: Belief, prediction: Prediction, s: float
    ) -> tuple[Belief | None, list[SampleOutcome]]:
        """Correct a belief by samples of one instant; by default samples are not used.

        They are ``s`` seconds after the belief ``before``, from which the ``prediction`` goes.

        Returns:
            The posterior, None if no sample is used; and the outcome of each sample.
        """
        del before, prediction, s
        return None, [SampleOutcome.unused(f"{self.name} uses no measurements")] * len(readings)

    def doubt(self, belief: Belief, deviations: Vector) -> str | None:
        """Why an estimate is not synchronized; empty if it is.

        By default None: the agreement of replicas decides. The published ``deviations`` of (q, u)
        hold some time after the ``belief``, away from impacts, shape (2n,).
        """
        del belief, deviations
        return None

    @abstractmethod
    def predict(self, t: float, posterior: Belief, closed: Contacts) -> Prediction:
        """The prediction from ``t`` (s since the epoch) on, ``closed`` having ``chi = 1``."""
