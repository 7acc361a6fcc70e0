# SPDX-License-Identifier: Apache-2.0
"""The filter: a bank of hypotheses that is predicted to each event and corrected by it."""

import math

import numpy as np
from scipy import linalg

from impact_observer.bank.bank import (
    OTHER,
    RESTART,
    SPURIOUS,
    TRUE,
    Bank,
    Hypotheses,
    bits,
    contacts_of,
)
from impact_observer.bank.branch import Branches, Priors, impacts
from impact_observer.bank.correct import Hit, corrected
from impact_observer.bank.ladders import NUMBERS, Ladders, Numbers
from impact_observer.bank.merge import merged, most_of
from impact_observer.bank.predict import Flights, Leg
from impact_observer.dynamics.tangent import Tangent
from impact_observer.events import Contacts
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

_SMALL = 1e-12
"""Size of a motion that has none, m or m/s."""


class ImpactBank:
    """A Kalman filter of impact times with hypotheses on what the events were."""

    def __init__(
        self,
        tangent: Tangent,
        *,
        clock: float | None = None,
        error: float | None = None,
        missed: float = 0.0,
        spurious: float = 0.0,
        mislabelled: float = 0.0,
        numbers: Numbers = NUMBERS,
    ) -> None:
        """Prepare the filter of one system.

        Args:
            tangent: flights and jumps of the system.
            clock: declared deviation of a stamp besides its rounding, s; None to weigh several.
            error: declared relative error of the model; None to weigh several.
            missed: probability that an impact is not reported.
            spurious: probability that an event is a false alarm.
            mislabelled: probability that an event is an impact of another contact.
            numbers: the tuned numbers.
        """
        self.tangent, self.numbers = tangent, numbers
        system = tangent.system
        self.n, self.m = system.n, system.m
        self.ladders = Ladders.of(clock, error, numbers)
        exponential = tangent.phase(()).flow.exponential
        self.rate = max(exponential.rate, 1.0)
        self.priors = Priors.of(spurious, mislabelled, self.m, self.rate, numbers)
        log_missed = np.full(self.m, math.log(missed) if missed > 0 else -math.inf)
        self.forced = self._forced()
        self._A = exponential.A[self.n : 2 * self.n, : 2 * self.n]
        self.flights = Flights(tangent, self.ladders, numbers, log_missed)
        self.scan = numbers.scan * self.n

    def begin(self, t: Elapsed, x: Vector, root: Matrix, held: Contacts = ()) -> Bank:
        """The bank at a start: (q, u), shape (2n,), with a root of its covariance, (2n, 2n)."""
        rows = self._begun(x, root, held)
        return Bank(t, rows, x.copy(), self.forced**2 / 2, self._intensity(self.forced))

    def _intensity(self, sizes: Vector) -> tuple[float, ...]:
        """Of the accelerations of a motion of some size, to a factor of two."""
        accelerations = np.abs(self._A * sizes).max(axis=1) + _SMALL
        rounded = 2.0 ** np.round(np.log2(accelerations))
        return tuple((rounded / math.sqrt(self.rate)).tolist())

    def _begun(self, x: Vector, root: Matrix, held: Contacts) -> Hypotheses:
        r, c, logw = self.ladders.first(self.numbers)
        H, N = r.size, x.size
        return Hypotheses(
            np.tile(x, (H, 1)),
            np.tile(root, (H, 1, 1)),
            np.zeros((H, N, N)),
            logw,
            r,
            c,
            np.zeros((H, self.scan), dtype=np.intp),
            np.zeros((H, self.m)),
            np.full(H, bits(held)),
            np.zeros(H, dtype=np.intp),
            np.zeros(H, dtype=np.intp),
        )

    def predicted(self, bank: Bank, s: float, named: Contacts = ()) -> Bank:
        """The bank ``s`` seconds later, just before an event of the contacts ``named`` if any."""
        if s <= 0:
            return bank
        rows = self.flights.moved(bank.rows, Leg(bank.t, s, (), bank.intensity, named))
        middle, replica = self.tangent.flights([bank.t] * 2, np.array([s / 2, s]), ()).of(
            bank.replica
        )
        forget = 1 - self.numbers.forgetting
        squares = (1 - forget) * bank.squares + forget * (middle**2 + replica**2) / 2
        squares = np.minimum(squares, 4 * bank.squares)
        intensity = self._intensity(np.sqrt(2 * squares))
        return Bank(bank.t + s, rows, replica, squares, intensity)

    def hit(self, bank: Bank, contact: int) -> Bank:
        """The bank after an event that reports an impact of a ``contact`` now."""
        rows, priors, numbers = bank.rows, self.priors, self.numbers
        parts = [self._impacts(rows, contact, priors.true)]
        if priors.other > -math.inf:
            parts += [self._impacts(rows, i, priors.other) for i in range(self.m) if i != contact]
        whole = Branches(*(np.concatenate(each) for each in zip(*parts, strict=True)))
        false = rows.logw + priors.spurious + priors.false_rate
        evidence = float(np.logaddexp.reduce(np.concatenate([whole.logw, false])))
        before = float(np.logaddexp.reduce(rows.logw))
        best = max(float(whole.logw.max()), float(false.max()))
        most = most_of(numbers, rows.x.shape[1])
        order = np.argsort(-whole.logw)[:most]
        order = order[whole.logw[order] > best + numbers.log_kept]
        found = []
        if order.size:
            found.append(self._corrected(rows, whole.take(order), bank.t, contact))
        order = np.argsort(-false)[:most]
        order = order[false[order] > best + numbers.log_kept]
        if order.size:
            kept = rows.take(order)
            past = kept.decided(8 * contact + SPURIOUS)
            found.append(kept._replace(logw=false[order], past=past))
        replica = self._bounced(bank.replica, contact)
        if evidence - before < math.log(self.rate):
            found.append(self._restarted(replica, bank, contact, evidence))
        rows = merged(Hypotheses.joined(found), self.ladders, numbers, self.scan)
        return bank._replace(rows=rows, replica=replica)

    def _impacts(self, rows: Hypotheses, contact: int, prior: float) -> Branches:
        found = impacts(rows, contact, self.flights)
        return found._replace(logw=found.logw + prior)

    def _corrected(
        self, rows: Hypotheses, branches: Branches, t: Elapsed, named: int
    ) -> Hypotheses:
        """The hypotheses of ``branches``, after their impacts."""
        chosen = rows.take(branches.h)._replace(r=branches.r, c=branches.c, logw=branches.logw)
        parts = []
        for i in np.unique(branches.contact).tolist():
            for number in np.unique(chosen.held).tolist():
                own = (branches.contact == i) & (chosen.held == number)
                if not own.any():
                    continue
                group, held = chosen.take(own), contacts_of(number)
                after = corrected(group, Hit(t, (i,), held), self.flights)
                past = group.decided(8 * i + (TRUE if i == named else OTHER))
                just = np.full_like(after.just, bits((i,)))
                parts.append(after._replace(past=past, just=just))
        return Hypotheses.joined(parts)

    def _restarted(self, replica: Vector, bank: Bank, contact: int, evidence: float) -> Hypotheses:
        """Hypotheses about the replica, with deviations as large as the motion."""
        root = np.diag(self.numbers.restart_deviation * bank.sizes)
        row = self.flights.gap_rows[contact] @ root
        axis = row / np.linalg.norm(row)
        rows = self._begun(replica, root - np.outer(root @ axis, axis), ())
        past = rows.decided(8 * contact + RESTART)
        just = np.full_like(rows.just, bits((contact,)))
        logw = rows.logw + evidence + self.numbers.log_restart
        return rows._replace(past=past, logw=logw, just=just)

    def _bounced(self, x: Vector, contact: int) -> Vector:
        """A geometric replica after an impact."""
        n = self.n
        q = self.tangent.phases.projection.position_after(x[:n], (contact,))
        return np.concatenate([q, self.tangent.newton.velocity_after(x[n:], (contact,))])

    def _forced(self) -> Vector:
        """Size of the motion that the forces give without contacts, and stops, shape (2n,)."""
        system, n = self.tangent.system, self.n
        forcing = system.forcing
        amplitude = np.zeros(2 * n)
        soft = system.K + 1e-6 * np.trace(system.K) / n * np.eye(n) + _SMALL * system.M
        if forcing.constant.any():
            amplitude[:n] += linalg.solve(soft, forcing.constant) ** 2
        for w, cos, sin in zip(forcing.frequency, forcing.cosine, forcing.sine, strict=True):
            dynamic = soft - w**2 * system.M + 1j * w * system.C
            q = np.abs(linalg.solve(dynamic, cos - 1j * sin))
            amplitude += np.concatenate([q, w * q]) ** 2
        return np.asarray(np.sqrt(amplitude)) + _SMALL
