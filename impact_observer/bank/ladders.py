# SPDX-License-Identifier: Apache-2.0
"""The two ladders of doubt, and the tuned numbers of the bank.

``./dev bench accuracy honesty`` shows what a change of a number does.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.states import Vector

Rungs = NDArray[np.intp]


class Numbers(NamedTuple):
    """The tuned numbers; names that begin with ``log`` are logarithms of probabilities.

    Deviations are standard deviations. The time scale of a model is the inverse of its fastest
    rate.

    Attributes:
        errors: relative errors of a model, the first ladder.
        clocks: deviations of a stamp, the second ladder, s.
        first_errors: places in ``errors`` at a start or restart.
        first_clocks: places in ``clocks`` at a start or restart.
        log_move: that a rung of one ladder changes before an event, for each rung up to
            ``farthest`` away.
        farthest: rungs by which a hypothesis moves at most.
        log_leading: how likely a hypothesis is that changes its rungs, beside the likeliest.
        impulses: relative errors of an impulse, where encoders tell the jump.
        false_rate: of a contact that only gives false positives, over the fastest rate.
        log_restart: of a restart beside false positives, where two events were not expected.
        log_sudden: of a restart beside a false positive, where only the last one was not.
        log_least_spurious: of a false positive, for these where none is declared.
        restart_deviation: at a restart, over the size of the motion.
        shallow: dips that are not deeper, in deviations, are no missed impacts.
        confident: the depth from which on an impact must have been missed, in deviations.
        most_missed: missed impacts of one flight.
        most: hypotheses that are kept; ``least`` of a large state.
        least: see ``most``.
        numbers: in the roots of all hypotheses, between the two.
        log_kept: how likely a hypothesis is that is kept, beside the likeliest.
        scan: decisions by which two hypotheses differ, in coordinates.
        near: deviations up to which two states count as the same.
        forgetting: weight of the earlier motion in its size, at each event.
        unpublished: probability of the least likely hypotheses that are not published.
        brief: flights after a missed impact that are rest, over the inverse of the fastest rate.
        bounce: the same after a reported impact.
        persistence: of published deviations, where the model is in error.
        least_error: the relative error of a model from which on users are warned.
        exact: probability of a smaller one below which they are.
        log_inside: of a dip that lasts, below which the sensor may be dead.
        patience: how long a dip may last until its report is due, over the inverse of the
            fastest rate.
        contradiction: the innovation that the declared errors exclude, in standard deviations.
        remembered: events for which a contradiction is told.
        most_silent: missed impacts in a row after which no others are looked for.
        recentre: deviations by which an estimated parameter leaves that of the flights.
    """

    errors: tuple[float, ...] = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
    clocks: tuple[float, ...] = (0.0, 1e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3)
    first_errors: tuple[int, ...] = (0, 4, 6)
    first_clocks: tuple[int, ...] = (0, 5)
    log_move: float = math.log(0.01)
    farthest: int = 2
    log_leading: float = -8.0
    impulses: tuple[float, ...] = (0.0, 1.0)
    false_rate: float = 0.1
    log_restart: float = math.log(2.5e-3)
    log_sudden: float = math.log(5e-4)
    log_least_spurious: float = math.log(1e-2)
    restart_deviation: float = 1.0
    shallow: float = 0.5
    confident: float = 3.0
    most_missed: int = 4
    most: int = 64
    least: int = 8
    numbers: int = 8192
    log_kept: float = -14.0
    scan: int = 3
    near: float = 3.0
    forgetting: float = 0.95
    unpublished: float = 1e-3
    brief: float = 1e-2
    bounce: float = 1e-5
    persistence: float = 3.0
    recentre: float = 0.5
    least_error: float = 1e-4
    exact: float = 0.01
    log_inside: float = -18.0
    patience: float = 0.1
    contradiction: float = 6.0
    remembered: int = 32
    most_silent: int = 32


NUMBERS = Numbers()
ROUNDING = 1e-9 / math.sqrt(12)
"""Standard deviation of rounding a stamp to 1 ns, s."""


class Ladders(NamedTuple):
    """What the rungs of a bank stand for.

    Attributes:
        errors: relative error of the model, shape (R,).
        kicks: relative error of an impulse, shape (R,).
        clocks: standard deviation of a stamp, s, shape (C,).
        moves: changes of both rungs at an event, shape (K, 2), and their log priors, (K,).
        log_moves: see ``moves``.
        persistence: factor of published deviations, shape (R,).
        is_learned: whether errors of the model are weighed, and an impulse errs as much.
    """

    errors: Vector
    kicks: Vector
    clocks: Vector
    moves: NDArray[np.intp]
    log_moves: Vector
    persistence: Vector
    is_learned: bool

    @classmethod
    def of(
        cls,
        clock: float | None,
        error: float | None,
        numbers: Numbers,
        *,
        has_encoders: bool = False,
    ) -> "Ladders":
        """The ladders; those whose size is declared have one rung.

        Args:
            clock: declared deviation of a stamp besides its rounding, s; None if unknown.
            error: declared relative error of the model; None if unknown.
            numbers: the tuned numbers.
            has_encoders: whether jumps are measured, so that errors of impulses can be weighed
                where that of the model is declared.
        """
        errors, is_learned = np.array(numbers.errors), error is None
        kicks = errors
        if error is not None:
            kicks = np.array(numbers.impulses if has_encoders else (0.0,))
            errors = np.full(kicks.size, error)
        clocks = np.hypot(numbers.clocks if clock is None else (clock,), ROUNDING)
        far = numbers.farthest
        by = [range(-far, far + 1) if each.size > 1 else range(1) for each in (errors, clocks)]
        moves = np.array([(i, j) for i in by[0] for j in by[1]])
        persistence = np.where((errors > 0) & is_learned, numbers.persistence, 1.0)
        log_moves = numbers.log_move * np.count_nonzero(moves, axis=1)
        return cls(errors, kicks, clocks, moves, log_moves, persistence, is_learned)

    def first(self, numbers: Numbers) -> tuple[Rungs, Rungs, Vector]:
        """Rungs of both ladders at a start, and the logarithms of their probabilities."""
        r = numbers.first_errors if self.is_learned else (0,)
        c = numbers.first_clocks if self.clocks.size > 1 else (0,)
        pairs = np.array([(i, j) for i in r for j in c])
        return pairs[:, 0], pairs[:, 1], np.full(len(pairs), -math.log(len(pairs)))

    def moved(self, r: Rungs, c: Rungs, leads: NDArray[np.bool_]) -> tuple[Rungs, ...]:
        """The hypotheses on new rungs: index of the old one, both rungs, number of the move.

        Only those that ``lead`` move at all.
        """
        to_r, to_c = r[:, None] + self.moves[:, 0], c[:, None] + self.moves[:, 1]
        stays = self.log_moves == 0
        allowed = (to_r >= 0) & (to_r < self.errors.size) & (to_c >= 0) & (to_c < self.clocks.size)
        h, k = np.nonzero(allowed & (leads[:, None] | stays))
        return h, to_r[h, k], to_c[h, k], k
