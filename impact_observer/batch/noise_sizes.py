# SPDX-License-Identifier: Apache-2.0
"""The sizes of the noises of the largest density of all that is measured.

Start and parameters are integrated over (restricted maximum likelihood; Patterson and Thompson,
Recovery of inter-block information when block sizes are unequal, 1971). The innovations of a pass
with sizes nearby are linear in all noises: each is a sum of columns times numbers of unit
variance. So the covariance of R innovations is

    V = F_0 + clock^2 F_1 + scatter^2 F_2 + model^2 F_3

with fixed (R, R) matrices, ``F_0`` of start, parameters and samples. It is the unit matrix at the
sizes of the pass, which makes the numbers well conditioned whatever the motion does, and the
density at other sizes is one factorisation of Cholesky. Innovations far apart are independent at
the sizes of the pass, so long recordings are cut into blocks; each begins with the unknown as the
pass has it there.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve, lapack

from impact_observer.batch.passes import WORTH, Array, Forward, Gaussian, LinearStep, NoiseSizes
from impact_observer.states import Matrix, Vector

ROUNDED = 1e-9 / float(np.sqrt(12))
"""Standard deviation of a stamp that is wrong by its rounding only, s."""
LARGEST_CLOCK = 1.5e-3
"""Largest error of stamps that is found where none is declared, s: larger ones would explain
errors of the model away."""
LARGEST_MODEL = 0.3
"""Largest error of accelerations that is found."""
_LEAST = NoiseSizes(ROUNDED, 1e-4, 1e-7)
_LARGEST = NoiseSizes(LARGEST_CLOCK, 0.3, LARGEST_MODEL)
"""Range of the sizes that are found; scatter and model error may be zero, too."""
_UNLIKELY = 2.0
"""Logarithm of the odds by which a size of a noise may be less likely than the likeliest one."""
_AS_GOOD = 0.5
"""Logarithm of the odds that makes no difference."""
_FIRST_GRID, _GRIDS = (30.0,), (4.0, 1.4)
"""Factors within which sizes are searched, one after the other: at first, and later."""
_TRIED = 7
"""Sizes that are tried within a factor and its inverse."""
_BLOCK = 160
"""Innovations in a block."""


class _Block(NamedTuple):
    """Innovations, shape (R,), and covariances by kind of noise at unit size, shape (4, R, R)."""

    nu: Vector
    F: Array


class NoiseDensity:
    """The density of all that is measured as a function of the sizes, near those of a pass.

    Attributes:
        is_finite: whether the motion of the pass has not left all bounds.
    """

    def __init__(
        self,
        prior: Gaussian,
        steps: Sequence[LinearStep],
        way: Forward,
        sizes: NoiseSizes,
        least_clock: float = ROUNDED,
    ) -> None:
        """Take a pass with ``sizes``; stamps are no better than ``least_clock``, s."""
        self._least = _LEAST._replace(clock=least_clock)
        self._blocks = [*_blocks(prior, steps, way)]
        is_bounded = all(np.isfinite(each.F).all() for each in self._blocks)
        of_blocks = sum(self._of(each, sizes) for each in self._blocks) if is_bounded else np.inf
        self._rest = way.log_density - of_blocks
        self.is_finite = bool(np.isfinite(self._rest))

    def log_density(self, sizes: NoiseSizes) -> float:
        """Logarithm of the density of all that is measured."""
        return self._rest + sum(self._of(each, sizes) for each in self._blocks)

    @staticmethod
    def _of(block: _Block, sizes: NoiseSizes) -> float:
        V = np.tensordot([1.0, *np.square(sizes)], block.F, 1)
        root, failed = lapack.dpotrf(V, lower=True, overwrite_a=True)
        if failed:
            return -np.inf
        white = cho_solve((root, True), block.nu)
        return float(-np.sum(np.log(np.diag(root))) - block.nu @ white / 2)

    def likeliest(
        self,
        near: NoiseSizes,
        clock: float | None,
        *,
        is_first: bool = False,
        is_late: bool = False,
    ) -> NoiseSizes:
        """The sizes of the largest density, from sizes ``near``.

        At first, where a motion is far off, only those of the clock, unless declared, and of the
        model count. When it ``is_late`` no kind of noise comes or goes, so that a search settles.
        """
        now, kinds = near, ("model", "clock") if is_first else ("model", "clock", "scatter")
        for number, factor in enumerate(_FIRST_GRID if is_first else _GRIDS):
            for kind in kinds:
                is_absent = not getattr(now, kind)
                if not (is_absent and (number or is_late)):
                    now = self._moved(now, kind, clock, factor, is_optional=not is_late)
        return now

    def likeliest_of_all(self, near: NoiseSizes, clock: float | None) -> NoiseSizes:
        """The sizes of the largest density, of any kinds; ``near`` where these are as good."""
        best, most = near, self.log_density(near) - near.price + _AS_GOOD
        for kinds in ((), ("scatter",), ("model",), ("model", "scatter")):
            now = NoiseSizes(clock or LARGEST_CLOCK)
            for factor in (None, *_GRIDS):
                for kind in (*kinds, "clock"):
                    now = self._moved(now, kind, clock, factor)
            worth = self.log_density(now) - now.price
            if worth > most:
                best, most = now, worth
        return best

    def allows(self, limits: NoiseSizes, sizes: NoiseSizes, clock: float | None) -> bool:
        """Whether sizes within ``limits`` are not much less likely than ``sizes``."""
        now = NoiseSizes(*np.minimum(sizes, limits).tolist())
        for factor in (None, *_GRIDS):
            for kind in ("model", "clock", "scatter"):
                now = self._moved(now, kind, clock, factor, limits=limits)
        return bool(self.log_density(now) >= self.log_density(sizes) - WORTH)

    def largest_model_error(self, sizes: NoiseSizes) -> float:
        """The largest error of accelerations that is not much less likely than that found."""
        least = self.log_density(sizes) - _UNLIKELY
        tried = np.geomspace(max(sizes.model, _LEAST.model), LARGEST_MODEL, 4 * _TRIED).tolist()
        likely = [r for r in tried if self.log_density(sizes._replace(model=r)) >= least]
        return float(max([sizes.model, *likely]))

    def _moved(
        self,
        now: NoiseSizes,
        kind: str,
        clock: float | None,
        factor: float | None,
        *,
        is_optional: bool = False,
        limits: NoiseSizes = _LARGEST,
    ) -> NoiseSizes:
        """Return sizes of which that of one kind is the best within a factor, or of all."""
        if kind == "clock" and clock is not None:
            return now._replace(clock=clock)
        low = getattr(self._least, kind)
        high = max(getattr(limits, kind), low)
        size = getattr(now, kind)
        tried = np.geomspace(low, high, 2 * _TRIED)
        if size and factor is not None:
            exponents = np.linspace(-1, 1, _TRIED)
            tried = np.unique(np.clip(size * factor**exponents, low, high))
        trial = [now._replace(**{kind: each}) for each in tried.tolist()]
        density = [self.log_density(each) for each in trial]
        if is_optional and kind != "clock":
            trial.append(now._replace(**{kind: 0.0}))
            density.append(self.log_density(trial[-1]) + WORTH)
        return trial[int(np.argmax(density))]


def _blocks(prior: Gaussian, steps: Sequence[LinearStep], way: Forward) -> Iterator[_Block]:
    """Yield the innovations as linear functions of the noises."""
    N, first, root = prior.mean.size, 0, prior.root
    while first < len(steps):
        count, last = 0, first
        while last < len(steps) and count < _BLOCK:
            count += len(steps[last].rows)
            last += 1
        if count:
            yield _block(root, steps[first:last], way, first, N)
        first, root = last, way.traces[last - 1].root


def _block(root: Matrix, steps: Sequence[LinearStep], way: Forward, first: int, N: int) -> _Block:
    """Return the innovations of some steps, of which the unknown before has this root.

    A column is what a noise of unit size adds to the unknown that the pass does not know of.
    """
    rows = [len(step.rows) for step in steps]
    size = N + sum(rows) + sum(step.noise.shape[1] for step in steps)
    E, kinds, used = np.zeros((N, size)), np.zeros(size, dtype=np.intp), N
    seen, nu = np.zeros((sum(rows), size)), list[float]()
    E[:, :N] = root
    for step, trace in zip(steps, way.traces[first:], strict=False):
        d, q = len(step.T), step.noise.shape[1]
        E[:d, :used] = step.T @ E[:, :used]
        E[:d, used : used + q] = step.noise
        kinds[used : used + q] = 2 if step.is_jump else 3
        used += q
        for row, update in zip(step.rows, trace.updates, strict=True):
            own = seen[len(nu)]
            own[:used] = row.h @ E[:, :used]
            own[used], kinds[used] = row.deviation, int(row.is_instant)
            used += 1
            own[:used] /= update.spread
            E[:, :used] -= np.outer(update.gain, own[:used])
            nu.append(update.innovation)
    with np.errstate(over="ignore", invalid="ignore"):  # of a motion that grows without bounds
        F = [seen[:, kinds == kind] @ seen[:, kinds == kind].T for kind in range(4)]
    return _Block(np.array(nu), np.array(F))
