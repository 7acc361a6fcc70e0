# SPDX-License-Identifier: Apache-2.0
"""The smoothed motion in one run of the sender: estimates at stamps, and of impacts."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from impact_observer.batch.explanation import Explanation
from impact_observer.batch.motion_fit import MotionFit
from impact_observer.batch.recorded_run import RecordedRun
from impact_observer.batch.smoothed_states import own_instants, smoothed_states
from impact_observer.dynamics.contact.impact_balance import uncertain_balance
from impact_observer.events import ImpactEstimate, Ruling, SmoothedImpact, Verdict
from impact_observer.observer.impact_sides import EXACT, REACH, side_error
from impact_observer.observer.uncertainty import Uncertainty
from impact_observer.stamps import Elapsed
from impact_observer.states import Estimate, Estimates, Matrix, Stamps, Vector

LAW = "smoother"
"""The name of the law in estimates of the smoother."""
_AT_ONCE = 512
"""States that are computed at once."""


@dataclass(frozen=True, eq=False)
class SmoothedRun:
    """The motion in one run of the sender, by all of its events.

    Attributes:
        run: the events.
        found: their account, the motion that explains it best, and whether the model fits.
        uncertainty: what is declared of sensor and model.
    """

    run: RecordedRun
    found: Explanation
    uncertainty: Uncertainty

    @property
    def start(self) -> int:
        """Stamp of the first state, ns."""
        return self.run.start

    @cached_property
    def fit(self) -> MotionFit:
        """The motion, with noises as large as they may be."""
        return self.found.fit.published(fits=self.found.verdict.fits)

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The final verdicts, in order of stamps."""
        return tuple(self.run.verdicts(self.fit.problem.moments))

    @property
    def misfit(self) -> str:
        """Why the model does not explain the impacts; empty where the model fits."""
        return "; ".join(self.found.verdict.reasons)

    @property
    def parameters(self) -> tuple[tuple[str, float, float], ...]:
        """Parameters with deviations: name, value, standard deviation, SI units."""
        d, fit = self.fit.x.shape[1], self.fit
        deviations = np.sqrt(np.diag(fit.covariance))[d:]
        names = fit.problem.family.names
        return tuple(zip(names, fit.values.tolist(), deviations.tolist(), strict=True))

    @cached_property
    def _late(self) -> Vector:
        """Instants of the moments minus their stamps, shape (K,), s."""
        return own_instants(self.fit)

    @cached_property
    def instants(self) -> Stamps:
        """Instants of the moments, shape (K,), ns."""
        stamps = np.array([each.stamp for each in self.fit.problem.moments.each], dtype=np.int64)
        return np.maximum(stamps + np.round(self._late * 1e9).astype(np.int64), self.start)

    @cached_property
    def _spread(self) -> Vector:
        """Standard deviations of these instants, shape (K,), s."""
        d, motion = self.fit.x.shape[1], self.fit.motion
        roots = self.fit.back.nodes.root[2::2, :d]
        moved = np.einsum("kd,kdm->km", motion.own_late_by_x, roots)
        return np.asarray(np.linalg.norm(moved, axis=1))

    def impacts(self) -> Iterator[SmoothedImpact]:
        """All impacts and releases, in the order of the moments."""
        names = self.run.system.contact_names
        for k, moment in enumerate(self.fit.problem.moments.each):
            hit, _, before, held = moment.switching
            ruling = Ruling.APPLIED if moment.is_measured else Ruling.INSERTED
            reported = moment.stamp if moment.is_measured else 0
            for i in sorted({*hit, *({*before} - {*held} - {*hit})}):
                yield SmoothedImpact(
                    int(self.instants[k]), reported, moment.sequence, names[i], ruling,
                    float(self._spread[k]),
                )  # fmt: skip

    def impact_estimates(self) -> Iterator[ImpactEstimate]:
        """The estimates of all impacts, in the order of the moments."""
        names = self.run.system.contact_names
        for k, moment in enumerate(self.fit.problem.moments.each):
            if not (hit := moment.switching.hit):
                continue
            ruling = Ruling.APPLIED if moment.is_measured else Ruling.INSERTED
            values, deviations = self._balance(k)
            for i, *own in zip(hit, values.tolist(), deviations.tolist(), strict=True):
                stamp, sequence = int(self.instants[k]), moment.sequence
                yield ImpactEstimate(stamp, names[i], ruling, sequence, *own[0], *own[1])

    def _balance(self, k: int) -> tuple[Matrix, Matrix]:
        """Return speeds, impulse and energy of the contacts that hit, and their deviations."""
        fit, system = self.fit, self.fit.tangent.system
        hit, pressed, before, _ = fit.problem.moments.each[k].switching
        active, n, d = tuple(sorted({*hit, *before})), system.n, 2 * system.n
        t, family = fit.problem.moments.each[k].t, fit.problem.family
        late, x = float(self._late[k]), fit.states[0][k + 1]
        to = fit.tangent.flights([t], np.array([late]), before)
        there, root = to.of(x[None])[0], fit.back.nodes.root[2 * (k + 1)]
        rate = fit.tangent.rates([t + late], there[None], before)[0][0]
        moved = (to.Phi[0] + np.outer(rate, fit.motion.own_late_by_x[k])) @ root[:d]
        moved += to.Gamma(x[None])[0] @ root[d:]
        W = system.W[:, list(active)].T
        gamma, theta = W @ there[n:], fit.tangent.theta
        least = self.uncertainty.least_deviations(there, fit.tangent.phases.scales.sizes(there))
        values, deviations = uncertain_balance(
            lambda own: family.near(own) if np.any(own != theta) else system,
            active,
            pressed,
            gamma=gamma,
            theta=theta,
            root=np.block(
                [[W @ moved[n:], W * least[n:]], [root[d:], np.zeros((family.size, n))]]
            ),
            scatter=fit.sizes.scatter * np.abs(gamma),
        )
        rows = [active.index(i) for i in hit]
        return values[rows], deviations[rows]

    def estimates(self, stamps: Stamps) -> Iterator[Estimates]:
        """The states at ``stamps``, ns, ascending; none before the start.

        The state at an impact is that just after the impact.
        """
        stamps = stamps[np.searchsorted(stamps, self.start) :]
        for begin in range(0, stamps.size, _AT_ONCE):
            yield from self._estimates(stamps[begin : begin + _AT_ONCE])

    def _estimates(self, stamps: Stamps) -> Iterator[Estimates]:
        fit, system = self.fit, self.fit.tangent.system
        n, moments, names = system.n, fit.problem.moments, system.contact_names
        scales = fit.tangent.phases.scales
        instants = stamps - self.run.epoch
        states = smoothed_states(fit, [Elapsed(ns) for ns in instants.tolist()])
        x = system.from_frame(instants, states.x)
        for i, stamp in enumerate(stamps.tolist()):
            flight = int(states.flight[i])
            moment = moments.each[flight - 1] if flight else None
            root = np.column_stack([states.root[i], *self._other_sides(stamp)])
            sizes = scales.sizes(states.x[i])
            covariance = self.uncertainty.published_covariance(root, states.x[i], sizes)
            first = Estimate(
                stamp=stamp,
                law=LAW,
                q=x[i, :n],
                u=x[i, n:],
                covariance=covariance,
                closed=tuple(names[j] for j in (moment.switching.held if moment else ())),
                synchronized=self.found.verdict.fits,
                misfit=self.misfit,
                parameters=self.parameters,
                last_sequence=moment.sequence if moment else 0,
                last_event=moment.stamp if moment else 0,
            )
            yield Estimates(first, np.array([stamp]), x[i][None])

    def _other_sides(self, stamp: int) -> Iterator[Vector]:
        """Yield errors of a state that may be on the other side of an impact."""
        n, (before, after) = self.fit.tangent.n, self.fit.states
        away = np.abs(stamp - self.instants) * 1e-9
        near = (self._spread > EXACT) & (away < REACH * self._spread)
        for k in np.flatnonzero(near).tolist():
            share = float(special.ndtr(-away[k] / self._spread[k]))
            yield side_error(share, (after[k + 1] - before[k + 1])[n:])
