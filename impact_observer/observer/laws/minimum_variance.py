# SPDX-License-Identifier: Apache-2.0
"""The Kalman filter of impact times, with a bank of hypotheses on what each event was."""

# ruff: noqa: D102 (overrides have the docstrings of ``Prediction``)

import math
from collections.abc import Sequence
from functools import cache, cached_property
from typing import ClassVar

import numpy as np
from scipy import linalg

from impact_observer.bank.balance import ImpactState, mixed
from impact_observer.bank.bank import Bank
from impact_observer.bank.course import Course
from impact_observer.bank.impact_bank import DeclaredErrors, ImpactBank
from impact_observer.bank.notes import Event
from impact_observer.bank.sample_correction import Function, LinearSample
from impact_observer.dynamics.contact.impact_balance import ImpactBalance
from impact_observer.errors import UsageError
from impact_observer.events import Contacts, Ruling
from impact_observer.model import System
from impact_observer.observer.belief import Belief, Onset, Parameters, Prediction
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws.law import Law
from impact_observer.observer.misfit import CONTRADICTION, JUMPS, MISFIT, SILENCE
from impact_observer.observer.samples import Reading, SampleOutcome
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_family import family_of
from impact_observer.square_roots import lengths_of
from impact_observer.stamps import Elapsed, elapsed
from impact_observer.states import Matrix, Vector

_NARROW = 0.05
"""Largest deviation of a synchronized estimate, over the motion."""
_DOUBTED = 12
"""Events in a row from which on a doubted model is a warning."""
_REJECTED = 20
"""Samples of a sensor in a row that are rejected before the estimate is doubted."""
_LOG_SILENT = math.log(1e-4)
"""Log probability of missed impacts in a row, from which on the sensor may be dead."""


class MinimumVariance(Law):
    """The estimate of least variance, and its covariance, from impact times alone.

    ``ImpactBank`` weighs hypotheses of what each event was, and how large the errors of model and
    clock are.

    Attributes:
        filter: the bank's filter.
        grounds: the family of systems, if the motion of their grounds is uncertain.
    """

    name: ClassVar[str] = "minimum-variance"
    has_covariance: ClassVar[bool] = True
    learns: ClassVar[bool] = True
    uses_measurements: ClassVar[bool] = True
    takes: ClassVar[tuple[type[System | Robot], ...]] = (System, Robot)

    def __init__(self, system: System, uncertainty: Uncertainty | None = None) -> None:
        """Prepare the filter.

        Raises:
            UsageError: the declared uncertainty does not fit the system; or its clock has an
                unknown offset, and the system no force that depends on time.
        """
        super().__init__(system, uncertainty)
        own = self.uncertainty
        unknowns, offset = own.unknowns, own.clock_offset_error
        if offset and not system.depends_on_time:
            raise UsageError(
                f"clock_offset_error: the offset cannot be estimated with {system.name}, as no"
                " force depends on time: a later clock and a later motion look the same; leave it"
                " out"
            )
        family = family_of(system) if unknowns is None else unknowns.family
        considered = () if unknowns is None else unknowns.considered
        roots = [] if unknowns is None else [unknowns.root]
        roots += [np.array([[offset]])] if offset else []
        self._names = [*family.names, *(["clock_offset"] if offset else [])]
        self._considered = np.array([*considered, *([False] if offset else [])], dtype=bool)
        self._has_delay = bool(offset)
        self.grounds = family if system.frame is not None and family.moves_grounds else None
        m, given, error = system.m, own.contacts, own.model_error
        if not (error or system.has_encoders or system.is_plain(range(m))):
            error = None  # what is not linear in speeds is an error at first
        if not error and own.estimates_parameters:
            error = None  # or in parameters
        self._latency = np.zeros(m) if given is None else given.latency
        self.filter = ImpactBank(
            family,
            DeclaredErrors(
                own.clock_error,
                error,
                own.missed if given is None else given.missed,
                math.nan if given is None else given.clock,
                own.spurious,
                own.mislabelled,
                own.dead_time,
                linalg.block_diag(*roots) if roots else np.zeros((0, 0)),
                tuple(self._considered.tolist()),
            ),
        )

    def begin(self, replicas: Matrix, root: Matrix, closed: Contacts) -> Belief:
        """The declared covariance, on the first rungs."""
        return self.belief(self.filter.begin(Elapsed(0), replicas[0], root, closed), 0.0)

    def belief(self, bank: Bank, s: float) -> Belief:
        """The belief ``s`` seconds after the stamp of a bank."""
        if s + bank.late:
            x, root = Course(self.filter, bank).estimate(s + bank.late)
        else:
            x, root = self.filter.gaussian(bank.rows)
        return self.made(bank, x, root, s)

    def made(self, bank: Bank, x: Vector, root: Matrix | None, s: float) -> Belief:
        """The belief of an estimate ``s`` seconds after the stamp of a bank, shape (N,).

        Without a ``root``, at the stamp, the covariance is found when asked for.
        """
        size, rows, ladders, misfit = 2 * self.system.n, bank.rows, self.filter.ladders, ""
        if bank.contradicted:
            misfit = CONTRADICTION.format(bank.farthest)
        elif bank.doubted >= _DOUBTED:
            level = float(rows.weights @ ladders.errors[rows.r])
            misfit = f"{MISFIT}: flights miss by {level:.2g} of the accelerations"
            misfit = misfit if ladders.is_learned else JUMPS
        own = published = None if root is None else root[:size]
        if own is not None and bank.contradicted:
            published = _anywhere(own, bank)
        return Belief(
            x[:size],
            np.zeros((size, 0)) if own is None else own,
            published,
            bank=bank,
            flown=s,
            clock_offset=float(x[-1]) if self._has_delay else 0.0,
            learned=cache(lambda: self._learned(bank, x, root)),
            noted=rows.notes[rows.best],
            clock_deviation=float(ladders.clocks[rows.c[rows.best]]),
            misfit=misfit,
        )

    def _learned(self, bank: Bank, x: Vector, root: Matrix | None) -> Parameters:
        """The estimated constants, and the levels of errors."""
        if root is None:
            root = self.filter.gaussian(bank.rows)[1]
        size, rows, ladders = 2 * self.system.n, bank.rows, self.filter.ladders
        deviations = lengths_of(root[size:]).tolist()
        each = zip(self._names, x[size:].tolist(), deviations, self._considered, strict=True)
        found = [row[:3] for row in each if not row[3]]
        own = self.uncertainty
        for name, declared, rungs, levels in (
            ("clock_error", own.clock_error, rows.c, ladders.clocks),
            ("relative model error", own.model_error, rows.r, ladders.errors),
        ):
            if declared is None:
                mean = float(rows.weights @ levels[rungs])
                square = float(rows.weights @ (levels[rungs] - mean) ** 2)
                found.append((name, mean, square**0.5))
        return tuple(sorted(found, key=lambda row: row[0] == "clock_offset"))

    def predict(self, t: float, posterior: Belief, closed: Contacts) -> Prediction:
        """The bank's own course."""
        del closed
        bank = posterior.bank
        assert bank is not None, "a belief of this law"
        if posterior.flown:  # a prior that nothing has corrected
            bank = self.filter.predicted(bank, posterior.flown)
        return BankPrediction(self, bank._replace(t=elapsed(t) + -bank.late))

    def correct(self, change: ContactChange, prior: Belief) -> Belief:
        """Every hypothesis branches, and is weighed."""
        bank = prior.bank
        assert bank is not None, "a belief of this law"
        delay = float(bank.constants[-1]) if self._has_delay else 0.0
        if change.contacts:
            delay += float(self._latency[change.contacts[0]])
        t = elapsed(change.t) + -delay
        if bank.rows.past.any() or prior.flown:
            bank = self.filter.predicted(bank, t - bank.t, change.hit)
        stay = tuple(i for i in change.hit if i in change.closed)
        event = Event(change.hit, stay, change.opened, change.stamp, change.sequence)
        bank = self.filter.after(bank._replace(t=t, late=delay), event)
        posterior = self.belief(bank, 0.0)
        latest = [note for note in posterior.noted if note.event == event.key]
        used = [note for note in latest if not note.is_inserted]
        hits = bool(change.hit) and all(note.ruling is Ruling.APPLIED for note in used)
        return posterior._replace(
            onset=Onset(prior.x, change.hit) if hits else None,
            innovations={n.contact: n.innovation for n in used if n.innovation >= 0},
        )

    def measure(
        self, readings: Sequence[Reading], before: Belief, prediction: Prediction, s: float
    ) -> tuple[Belief | None, list[SampleOutcome]]:
        """Every hypothesis is corrected and weighed; the covariance is found when asked for."""
        del before, s
        assert isinstance(prediction, BankPrediction), "a prediction of this law"
        bank, outcomes = prediction.bank, list[SampleOutcome]()
        t = Elapsed(readings[0].instant)
        bank = self.filter.predicted(bank, t - bank.t)._replace(t=t, late=0.0)
        for reading in readings:
            sensor = reading.sensor
            function = Function(*sensor.function)
            if self.grounds is None:
                shift = float(sensor.shifts(np.array([reading.instant]))[0])
            else:
                theta = bank.constants[: self.grounds.size]
                moved, slopes = self.grounds.ground_motion(theta, reading.instant)
                by = np.sum(slopes * np.array(function[:3]), axis=(1, 2))
                shift = float(np.sum(moved * np.array(function[:3])) - by @ theta)
                function = function._replace(parameters=by)
            gate = sensor.measurement.gate
            sample = LinearSample(
                function,
                reading.value - shift,
                sensor.measurement.deviation**2,
                gate,
                sensor.period,
            )
            lost = reading.rejected >= _REJECTED
            bank, found = self.filter.measured(bank, sample, lost=lost)
            innovation, z = float(found.innovation[0]), float(found.z[0])
            reason = ""
            if z > gate:
                reason = f"gate: {z:.3g} standard deviations; {gate:g} are allowed"
            outcomes.append(SampleOutcome(innovation, z, not reason, reason))
        return self.made(bank, bank.rows.x[bank.rows.best], None, 0.0), outcomes

    def impact_balance(
        self, change: ContactChange, before: Belief, prediction: Prediction, after: Belief
    ) -> ImpactBalance | None:
        """The balance of the contacts that hit, with deviations, at the estimated instant."""
        del before, prediction
        assert after.bank is not None, "a belief of this law"
        rows, key = after.bank.rows, (change.stamp, change.sequence)
        states, weights = list[ImpactState](), list[float]()
        for notes, weight in zip(rows.notes, rows.weights.tolist(), strict=True):
            for note in reversed(notes):
                if note.event != key:
                    break
                if note.switched in change.hit and note.ruling is Ruling.APPLIED:
                    states.append(note.state)
                    weights.append(weight)
                    break
        return self.known_balance(mixed(states, np.array(weights)), after) if states else None

    def doubt(self, belief: Belief, deviations: Vector) -> str:
        """Which deviation is too wide; empty if none is."""
        assert belief.bank is not None, "a belief of this law"
        ratio = deviations / belief.bank.sizes
        widest = int(np.argmax(ratio))
        if ratio[widest] <= _NARROW:
            return ""
        names = self.system.coordinates
        what = "velocity" if widest >= len(names) else "position"
        name, share = names[widest % len(names)], ratio[widest]
        return f"{what} of {name} is known to {share:.0%} of its motion"


class BankPrediction(Prediction):
    """A bank as a function of time until the next event.

    Attributes:
        bank: the hypotheses at the start.
    """

    def __init__(self, law: MinimumVariance, bank: Bank) -> None:
        self._law, self.bank, self._size = law, bank, 2 * law.system.n

    @cached_property
    def _silent(self) -> int:
        """Missed impacts in a row from which on the sensor may be dead."""
        missed = float(np.max(self._law.uncertainty.missed))
        return max(math.ceil(_LOG_SILENT / math.log(missed)), 2) if 0 < missed < 1 else 2

    @cached_property
    def _course(self) -> Course:
        return Course(self._law.filter, self.bank)

    def state(self, s: float) -> Vector:
        return self._course.estimate(s + self.bank.late)[0][: self._size]

    def states(self, s: Vector) -> Matrix:
        return self._course.states(s + self.bank.late)[:, : self._size]

    def root(self, s: float) -> Matrix:
        root = self._course.estimate(s + self.bank.late)[1][: self._size]
        lost = self.bank.contradicted or self.silence(s)
        return _anywhere(root, self.bank) if lost else root

    def of_grounds(self, ns: int, s: float) -> tuple[Vector, Matrix] | None:
        if (family := self._law.grounds) is None:
            return None
        x, root = self._course.estimate(s + self.bank.late)
        own = slice(self._size, self._size + family.size)
        moved, slopes = family.ground_motion(x[own], ns)
        by = slopes[:, :2].reshape(family.size, -1)
        return moved[:2].ravel(), by.T @ root[own]

    def closed(self, s: float) -> Contacts:
        return self._course.closed(s + self.bank.late)

    def belief(self, s: float) -> Belief:
        x, root = self._law.filter.flown_on(self.bank, s + self.bank.late)
        return self._law.made(self.bank, x, root, s)

    def silence(self, s: float) -> str:
        missed, is_inside = self._course.silent(s + self.bank.late)
        if missed >= self._silent:
            return f"{missed} predicted impacts in a row were {SILENCE}"
        return f"a predicted impact was {SILENCE}" if is_inside else ""


def _anywhere(root: Matrix, bank: Bank) -> Matrix:
    """A ``root`` of the covariance of a plant that may also be anywhere within its motion."""
    return np.hstack([root, np.diag(2 * bank.sizes)])
