"""What users choose of an observer, as they write it: the same in nodes and commands."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from impact_observer.errors import UsageError
from impact_observer.estimation.uncertainty import Uncertainty, deviation_of
from impact_observer.estimation.unknown_parameters import Unknowns
from impact_observer.model import System
from impact_observer.model.elements import Element
from impact_observer.observer.initial_state import initial_state
from impact_observer.observer.laws import law_named
from impact_observer.observer.observer import DEFAULT_ENSEMBLE, DEFAULT_HISTORY, Observer
from impact_observer.observer.synchronization import AGREED

COMPILING = "machine code of what an event takes: half a minute to compile, once"
"""What users are told where an observer ``compiles``."""


@dataclass(frozen=True, slots=True)
class Options:
    """Everything about an observer but its system.

    Attributes:
        law: name of its law.
        initial: where the estimate begins; see ``initial_state``.
        deviation: standard deviations of that; see ``deviation_of``.
        clock_error: standard deviation of the events' stamps, s; None to learn it from them.
        clock_offset_error: standard deviation of what all stamps are late by, s; 0 for none.
        model_error: of the accelerations, as white noise, m/s^1.5.
        missed: probability of an impact that it is not heard.
        spurious: probability of an event that nothing has happened.
        mislabelled: probability of an impact that it was one of another contact.
        ensemble: replicas that are run together.
        agreed: V distance at which they count as synchronized, relative to the motion's energy.
        epoch: stamp of ``t = 0``, ns; 0 to learn it from the events.
        history: how late an event may be and still be applied, s.
        estimate_parameters: of the model, to learn with the state; see ``Unknowns.named``.
        parameter_drift: of their deviations, what these go astray by in a minute.
        compiled: whether to have machine code for what an event takes, where the law ``compiles``.
    """

    law: str = "geometric"
    initial: str = "zero"
    deviation: str = "1"
    clock_error: float | None = None
    clock_offset_error: float = 0.0
    model_error: float = 0.0
    missed: float = 0.1
    spurious: float = 0.1
    mislabelled: float = 0.01
    ensemble: int = DEFAULT_ENSEMBLE
    agreed: float = AGREED
    epoch: int = 0
    history: float = DEFAULT_HISTORY
    estimate_parameters: tuple[str, ...] = ()
    parameter_drift: float = 0.0
    compiled: bool = False

    @property
    def compiles(self) -> bool:
        """Whether something is compiled for an observer, or what was is read again.

        Raises:
            UsageError: its law is not installed.
        """
        return self.compiled and law_named(self.law).compiles

    def of_laws(self, laws: Sequence[str]) -> "list[Options]":
        """These for each law; parameters are learnt by the laws that can, if there is one.

        Raises:
            UsageError: a law is not installed.
        """
        learns = [law_named(law).learns for law in laws]
        plain = replace(self, estimate_parameters=(), parameter_drift=0.0)
        told = [self if each or not any(learns) else plain for each in learns]
        return [replace(each, law=law) for law, each in zip(laws, told, strict=True)]

    def observer(self, system: System, elements: Sequence[Element] = ()) -> Observer:
        """An observer of ``system`` that has seen nothing yet.

        Args:
            system: what plant and replica share.
            elements: what it was assembled of: their parameters can be learnt one by one.

        Raises:
            UsageError: something cannot be used, by its name; or what compiles is not installed.
        """
        law, wanted, unknowns = law_named(self.law), self.estimate_parameters, None
        if self.parameter_drift and not wanted:
            raise UsageError(
                f"parameter_drift: {self.parameter_drift:g} found, but no estimate_parameters to"
                " drift; expected some, or no drift"
            )
        if wanted:
            unknowns = Unknowns.named(system, wanted, elements, self.parameter_drift)
            if not law.learns:
                raise UsageError(
                    f"estimate_parameters: the law {self.law} learns none; expected"
                    " minimum-variance, or leave them out"
                )
        uncertainty = Uncertainty(
            deviation_of(self.deviation, system),
            self.clock_error,
            self.clock_offset_error,
            self.model_error,
            self.missed,
            self.spurious,
            self.mislabelled,
            unknowns,
        )
        chosen = law(system, uncertainty)
        if self.compiled:
            chosen.compile()
        return Observer(
            system,
            chosen,
            *initial_state(self.initial, system),
            epoch=self.epoch,
            history=self.history,
            ensemble=self.ensemble,
            agreed=self.agreed,
        )
