"""What every law is."""

from abc import ABC, abstractmethod
from typing import ClassVar

from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.uncertainty import Uncertainty
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.states import Matrix


class Law(ABC):
    """How a belief follows from the events of the plant.

    A law that corrects every replica by itself derives from ``ReplicaLaw``, and is simpler.

    Attributes:
        name: what users choose it by.
        uses_events: whether its replicas' agreement says anything: only if events correct them.
        learns: whether it learns parameters of the model that are not known.
        compiles: whether it has something to compile.
        system: what plant and replicas share.
        uncertainty: what the user declares not to know.
    """

    name: ClassVar[str]
    uses_events: ClassVar[bool] = True
    learns: ClassVar[bool] = False
    compiles: ClassVar[bool] = False

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare the law for one ``system``.

        Raises:
            UsageError: the declared uncertainty does not fit the system.
        """
        self.system = system
        self.uncertainty = Uncertainty() if uncertainty is None else uncertainty
        self.uncertainty.root(system.n)

    def compile(self) -> None:  # noqa: B027 (most laws have nothing to compile)
        """Have machine code for what an event takes, where that is much faster: not here.

        Raises:
            UsageError: the compiler is not installed.
        """

    @abstractmethod
    def begin(self, replicas: Matrix, root: Matrix, closed: Contacts) -> Belief:
        """What is believed before any event.

        Args:
            replicas: states (q, u), shape (N, 2n), the estimate first.
            root: a square root of the estimate's covariance, shape (2n, 2n).
            closed: contacts with ``chi = 1``; what holds while they are closed holds at once.

        Raises:
            ImpactLawError: the impact law has no solution on these contacts.
        """

    @abstractmethod
    def correct(self, change: ContactChange, belief: Belief) -> Belief:
        """What is believed just after an event.

        Args:
            change: what the plant's contacts do.
            belief: just before it.

        Raises:
            ImpactLawError: the impact law has no solution on these contacts.
            DynamicsError: the loads of closed contacts cannot be found.
        """

    @abstractmethod
    def predict(self, t: float, belief: Belief, closed: Contacts) -> Prediction:
        """How ``belief`` goes on until the next event.

        Args:
            t: s since the epoch.
            belief: then.
            closed: contacts with ``chi = 1`` meanwhile.
        """
