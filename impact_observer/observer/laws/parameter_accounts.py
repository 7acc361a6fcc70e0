# SPDX-License-Identifier: Apache-2.0
"""Accounts of a doubted model: its parameters are estimated beside the law's own bank."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from scipy import linalg

from impact_observer.dynamics import Scales
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.filter_bank import FilterBank
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import (
    Hypothesis,
    error_share,
    mixture,
    normalised,
)
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.readings import Reading
from impact_observer.filter.sample_update import SampleUpdate
from impact_observer.filter.square_root import lengths, triangular
from impact_observer.filter.tuning import TUNING
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.filter.unknown_parameters import UnknownParameters
from impact_observer.model import System
from impact_observer.model.free_parameters import (
    STAND_INS,
    UNITS,
    forcing_quadratures,
    harmonic_forces,
    impact_durations,
    impulses_aside,
    usual_force,
)
from impact_observer.model.system import unit_of
from impact_observer.observer.belief import Account, Accounts, Belief, Fallback, Prediction
from impact_observer.observer.laws.fitting import fitted
from impact_observer.observer.laws.kalman_predictions import predicted_by
from impact_observer.observer.laws.starts import Starts
from impact_observer.states import Vector

OF_MOTION = {
    "stiffness-scale": TUNING.parameter_deviation,
    "damping-scale": TUNING.damping_deviation,
    "forcing-amplitude": TUNING.amplitude_deviation,
    "forcing-quadrature": TUNING.quadrature_deviation,
    "constant-force": TUNING.constant_deviation,
    "harmonic-force": TUNING.constant_deviation,
}
OF_IMPACTS = {
    "gap": TUNING.gap_deviation,
    "restitution": TUNING.restitution_deviation,
    "contact-time": TUNING.contact_time_deviation,
    "impulse-aside": TUNING.aside_deviation,
}
"""Parameters that an account estimates, where a model has them, and their deviations: of a
constant force relative to the largest force, of a gap to the largest gap, of a contact time to the
model's time scale."""
OF_FORCING = {"forcing-amplitude", "forcing-quadrature"}
"""Parameters of the motion that make any amplitude and phase of the forcing."""


def doubted(system: System, *, is_wide: bool = False) -> UnknownParameters:
    """The parameters that an account estimates; no scales of what moving grounds act through."""
    deviations, forcing = OF_MOTION | OF_IMPACTS, system.forcing
    deviations["contact-time"] *= Scales.of_equations(system).timescale
    for kind in ("constant-force", "harmonic-force"):
        deviations[kind] *= usual_force(system)
    deviations["gap"] *= float(np.max(np.abs(system.q_r), initial=0.0))
    at_rest = system.frame is None
    is_plain = at_rest and system.live is None and forcing.sampled is None
    parts = {"stiffness-scale": system.K * at_rest, "damping-scale": system.C * at_rest}
    parts["forcing-amplitude"] = np.where(is_plain, forcing.frequency, 0.0)
    is_forced = is_plain and system.n <= TUNING.forced_coordinates
    parts["constant-force"] = np.array([is_forced])
    parts["gap"] = system.q_r * is_plain
    parts["restitution"] = system.eps * ["restitution" in law.units for law in system.rebounds]
    kinds = (k for k in deviations if k not in STAND_INS and np.any(parts.get(k, 1.0)))
    found = UnknownParameters.named(system, [f"{k}={deviations[k]}" for k in kinds])
    others = [*impact_durations(system)]
    others += [*forcing_quadratures(system)] if is_plain and not is_wide else []
    others += [*harmonic_forces(system)] if is_forced and is_wide else []
    may_rub = is_forced and system.n <= TUNING.aside_coordinates
    others += [*impulses_aside(system)] if may_rub and is_wide else []
    if not others:
        return found
    family = found.family.extended(others)
    declared = dict(zip(found.family.names, found.deviations.tolist(), strict=True))
    return UnknownParameters.of(family, declared | deviations)


def subsets(names: Sequence[str]) -> list[list[bool]]:
    """Which of the parameters ``names`` are wrong together.

    All of them; those of the motion, those of the impacts; those of one kind.
    """
    kinds = [kind_of(name) for name in names]
    together = [{*kinds}, {*OF_MOTION}, {*OF_IMPACTS}, OF_FORCING, *({kind} for kind in kinds)]
    found = [tuple(kind in each for kind in kinds) for each in together]
    return [[*each] for each in dict.fromkeys(found) if any(each)]


def kind_of(name: str) -> str:
    """The kind of a parameter."""
    return name.partition(".")[0]


class AccountBank:
    """Begins, corrects and predicts an account with parameters of a system.

    Attributes:
        names: of the parameters.
    """

    def __init__(
        self,
        system: System,
        uncertainty: Uncertainty,
        clocks: Sequence[float],
        *,
        is_wide: bool = False,
    ) -> None:
        """An account of ``system``; ``uncertainty`` has no unknown parameters.

        One that ``is_wide`` estimates all parameters together, and harmonic forces beside them.
        """
        self._unknowns = doubted(system, is_wide=is_wide)
        self._deviations = (TUNING.wide_share if is_wide else 1.0) * self._unknowns.deviations
        self.names = self._unknowns.family.names
        self._nominal = self._unknowns.family.nominal
        uncertainty = replace(uncertainty, unknowns=self._unknowns)
        self._subsets = subsets(self.names)[: 1 if is_wide else None]
        most = TUNING.wide_hypotheses if is_wide else TUNING.account_hypotheses
        filter_ = ImpactFilter(system, 0.0, self._unknowns)
        self._bank = FilterBank(filter_, uncertainty, clocks, most)
        self._starts = Starts(filter_, uncertainty, clocks)
        self._system = system

    def begin(self, state: GaussianState, largest: Vector, clocks: Sequence[float]) -> Account:
        """The account at an estimate that is in doubt.

        Some of the parameters are wrong, and none is considered; the stamps have one of the
        errors ``clocks``, s. The components of the motion have been as large as ``largest``,
        shape (2n,).
        """
        state = state.without_parameters()
        d, late, p = state.x.size, len(state.constants), self._unknowns.family.size
        rows = np.r_[:d, d + late : d + late + p, d : d + late]
        constants = np.concatenate([self._nominal, state.constants])
        nothing, begun = np.zeros((rows.size, 0)), []
        doubt = np.pad(np.diag(TUNING.doubted_start * largest), ((0, late), (0, 0)))
        root = triangular(np.hstack([TUNING.widened_start * state.root, doubt]))
        for k, free in enumerate(self._subsets):
            deviations = np.where(free, self._deviations, 0.0)
            whole = linalg.block_diag(root, np.diag(deviations))[rows]
            prior = GaussianState(state.x, constants, whole, nothing, state.closed, p)
            prior = self._bank.filter.begin(prior)
            kinds = {kind_of(name) for name, each in zip(self.names, free, strict=True) if each}
            weight = len(kinds) * TUNING.log_further
            begun += [Hypothesis(prior, clock, weight, subset=k) for clock in clocks]
        return Account(normalised(begun))

    def after(self, change: ContactChange, before: Account, fallback: Fallback) -> Account:
        """The account after an event."""
        prior = before.published[0].state
        restarts = partial(self._starts.restarts, fallback, change.closed, 1, prior)
        corrected = self._bank.update(change, before.hypotheses, restarts, fallback.extent)
        corrected = corrected or restarts()
        fit = fitted(before.fit, change, prior, corrected, self._bank)
        if error_share(corrected) > TUNING.established_error:
            corrected = tuple(h._replace(state=self._doubted_again(h.state)) for h in corrected)
        residual = before.residual
        if change.hit:
            residual = self._bank.filter.gap(change.hit[0], prior)
        return Account(corrected, fit, residual)

    def measured(self, reading: Reading, before: Account, largest: Vector) -> Account:
        """The account after a sample that is measured beside the impacts."""
        found = self._samples.after(reading, before.hypotheses, largest)[0]
        return before._replace(hypotheses=found)

    @cached_property
    def _samples(self) -> SampleUpdate:
        return SampleUpdate(self._bank)

    def _doubted_again(self, state: GaussianState) -> GaussianState:
        """``state`` with all parameters in doubt, by as much as the most changed one has changed.

        Parameters that need an error of the model beside them are not the right ones. They are
        replacements, which may explain the impacts and still be far from the plant.
        """
        d, p, first = state.x.size, state.parameters, self._deviations
        change = min(float(np.max(np.abs(state.theta - self._nominal) / first)), 1.0)
        known = np.array(lengths(state.root[d : d + p])) < change * first
        added = np.zeros((len(state.root), p))
        added[d : d + p] = np.diag(TUNING.doubted_again * change * first * known)
        return state._replace(root=triangular(np.hstack([state.root, added])))

    def estimate(self, account: Account) -> GaussianState:
        """What the account publishes, parameters included."""
        return mixture(account.published)

    def changes(self, account: Account) -> dict[str, tuple[float, float]]:
        """Of each parameter in doubt its value, and its change in standard deviations."""
        found = self.estimate(account)
        d, p = found.x.size, found.parameters
        rows = zip(
            self.names, found.theta, self._nominal, lengths(found.root[d : d + p]), strict=True
        )
        return {
            name: (float(value), abs(float(value - given)) / deviation)
            for name, value, given, deviation in rows
            if deviation
        }

    def change(self, account: Account) -> float:
        """How far the parameters are from those of the model together, in standard deviations.

        Their Mahalanobis distance, beyond what as many parameters have by chance.
        """
        found = self.estimate(account)
        d, p = found.x.size, found.parameters
        far = np.linalg.lstsq(found.root[d : d + p], found.theta - self._nominal)[0]
        return math.sqrt(max(float(far @ far) - p, 0.0))

    def text(self, account: Account) -> str:
        """What explains the impacts, or some of them, for the warning."""
        found, unit = self.changes(account), self._system.unit
        names = [name for name, (_, change) in found.items() if change > TUNING.named_change]
        names = names or [max(found, key=lambda name: found[name][1])] if found else []
        values = ", ".join(
            f"{name} {found[name][0]:.4g} {unit_of(UNITS[kind_of(name)], unit)}".rstrip()
            for name in names
        )
        better = "" if account.is_explained else " better, not fully"
        return f"; {values} would explain the impacts{better}"

    def predicted(self, t: float, account: Account, s: float) -> Account:
        """The account of ``t`` (s since the epoch) ``s`` seconds later."""
        return account._replace(hypotheses=self._bank.between.predict(account.hypotheses, t, s))

    def predict(self, t: float, account: Account, prior: Callable[[float], Belief]) -> Prediction:
        """The prediction of what the account publishes, from ``t`` (s since the epoch) on.

        ``prior`` finds the whole belief some seconds later.
        """
        return predicted_by(self._bank, t, lambda: account.published, prior)


class ParameterAccounts:
    """The two accounts of a doubted model.

    What few kinds of parameters explain is sparse, and sure of what no impact tells. The wide
    account says how far the state may be there.

    Attributes:
        few: with parameters of one kind, of some or of all.
        wide: with all parameters and harmonic forces together.
    """

    def __init__(self, system: System, uncertainty: Uncertainty, clocks: Sequence[float]) -> None:
        """Accounts of ``system``; ``uncertainty`` has no unknown parameters."""
        self.few = AccountBank(system, uncertainty, clocks)
        self.wide = AccountBank(system, uncertainty, clocks, is_wide=True)

    @staticmethod
    def are_affordable(system: System) -> bool:
        """Whether ``system`` is small enough for accounts."""
        return system.n <= TUNING.account_coordinates

    def begin(self, state: GaussianState, largest: Vector, clocks: Sequence[float]) -> Accounts:
        """Both accounts at an estimate that is in doubt; see ``AccountBank.begin``."""
        return Accounts(
            self.few.begin(state, largest, clocks), self.wide.begin(state, largest, clocks)
        )

    def after(self, change: ContactChange, before: Accounts, fallback: Fallback) -> Accounts:
        """The accounts after an event."""
        return Accounts(
            self.few.after(change, before.few, fallback),
            self.wide.after(change, before.wide, fallback),
        )

    def measured(self, reading: Reading, before: Accounts, largest: Vector) -> Accounts:
        """The accounts after a sample that is measured beside the impacts."""
        return Accounts(
            self.few.measured(reading, before.few, largest),
            self.wide.measured(reading, before.wide, largest),
        )

    def predicted(self, t: float, accounts: Accounts, s: float) -> Accounts:
        """The accounts of ``t`` (s since the epoch) ``s`` seconds later."""
        return Accounts(
            self.few.predicted(t, accounts.few, s), self.wide.predicted(t, accounts.wide, s)
        )
