# SPDX-License-Identifier: Apache-2.0
"""The best estimate of a recording at every instant, from all of its events, before and after.

The filter's path through the account is a first guess. The motion is linearised about it and
smoothed, which gives a better path, until the change is small against the deviations: Gauss and
Newton's method for the likeliest motion (Bell, The iterated Kalman smoother as a Gauss-Newton
method, 1994).
"""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.errors import DynamicsError
from impact_observer.filter.square_root import triangular
from impact_observer.kernel._kernel import TINY
from impact_observer.model.system import LARGEST_STATE
from impact_observer.smooth.arc import Arc, Node
from impact_observer.smooth.chain import Chain, Normal, Step
from impact_observer.smooth.linearised import Path, followed

SETTLED = 1e-3
"""Change of the path, in standard deviations, that ends the linearisations."""
MOST_ROUNDS = 20
"""Most linearisations."""
_MOST_WORSE = 3
"""Most linearisations in a row that do not make the change smaller."""
_SETTLING = 1.0
"""Change by another linearisation below which a motion has settled."""
OTHER = 3.0
"""Deviations by which the first state of another motion differs."""
_MOST_GATES = 4
"""Most times that samples are chosen again by their distance from the smoothed motion."""
_ROOM = 0.4
"""Largest move of an instant at once, relative to the distance from its neighbour."""
_FEW_NUMBERS = 2**20
"""Most numbers in the covariances of all nodes for which steps are cached."""
_IN_MEMORY = 2**23
"""Most numbers that are kept in memory."""


class Smoothed(NamedTuple):
    """The smoothed motion.

    Attributes:
        arc: the recording.
        path: the path of the linearisation.
        first: the state (q, u, constants) at the start.
        known: the posterior at each node of the arc, of (e, q, u, constants) at a moment.
        evidence: logarithm of the probability density of the reported instants, 1/s each.
        change: that another linearisation would make, in standard deviations.
        rounds: linearisations.
    """

    arc: Arc
    path: Path
    first: Normal
    known: "KnownStates"
    evidence: float
    change: float
    rounds: int

    @property
    def is_settled(self) -> bool:
        """Whether another linearisation would change the motion by less than its deviations."""
        return self.change < _SETTLING

    def distance(self, other: "Smoothed") -> float:
        """Returns the largest distance of the first state from another one, in deviations."""
        size = 2 * self.arc.filter.system.n
        moved = np.abs(other.first.mean - self.first.mean)[:size]
        both = np.hypot(other.first.deviations, self.first.deviations)[:size]
        return float(np.max(moved / np.maximum(both, TINY)))

    def instant(self, k: int) -> tuple[float, float]:
        """The lead of the ``k``-th moment over its stamp, and the standard deviation, s."""
        z = self.known.state(Node(k))
        early = float(self.path.early[k] + z.mean[0])
        return early, float(z.deviations[0])

    def state_after(self, k: int) -> Normal:
        """The state (q, u, constants) just after the ``k``-th moment; -1 for the start.

        The state is that at the instant of the path.
        """
        if k < 0:
            return self.first
        step = self.arc.left(self.path, k)
        z = self.known.state(Node(k, self.arc.rests(k)))
        return z.mapped(step.A, step.b, step.N)


class KnownStates:
    """The results at the nodes of an arc; large results lie on the disk."""

    def __init__(self, nodes: Sequence[Node], d: int) -> None:
        """Room for ``nodes``, of vectors of up to ``d`` numbers."""
        self.nodes = nodes
        self._index = {node: i for i, node in enumerate(nodes)}
        self._means = _room(len(nodes), d)
        self._roots = _room(len(nodes), d * d)

    def set(self, i: int, z: Normal) -> None:
        """Keep the result ``z`` at the ``i``-th node."""
        d = z.mean.size
        self._means[i, :d] = z.mean
        self._roots[i, : d * d] = z.root.ravel()

    def state(self, node: Node) -> Normal:
        """Returns the result at ``node``."""
        i, width = self._index[node], self._means.shape[1]
        d = width - node.is_after
        return Normal(self._means[i, :d].copy(), self._roots[i, : d * d].reshape(d, d).copy())


def _room(rows: int, columns: int) -> NDArray[np.float64]:
    """Zeros, shape (rows, columns); large arrays are mapped to a file without a name."""
    if rows * columns <= _IN_MEMORY:
        return np.zeros((rows, columns))
    file = tempfile.TemporaryFile()  # noqa: SIM115 (the mapped array keeps the file open)
    return np.memmap(file, np.float64, "w+", shape=(rows, columns))


def smooth(
    arc: Arc, progress: Callable[[int, int], None] = lambda _done, _total: None
) -> Smoothed:
    """Smooth the motion through the moments of ``arc``.

    ``progress`` is called with the number of linearisations done, and the most that may be.

    Raises:
        DynamicsError: the motion grows beyond all bounds.
    """
    return _gated(_settled(arc, arc.predicted(), progress), progress)


def _gated(motion: Smoothed, progress: Callable[[int, int], None]) -> Smoothed:
    """The motion with the samples within their gates; the filter has made the first choice."""
    is_gated = bool(motion.arc.samples.readings) and not motion.arc.is_of_robot
    for _ in range(_MOST_GATES if is_gated else 0):
        arc = motion.arc.gated(motion.path)
        if arc.samples.rejected == motion.arc.samples.rejected:
            break
        motion = _settled(arc, motion.path, progress)
    return motion


def _settled(arc: Arc, path: Path, progress: Callable[[int, int], None]) -> Smoothed:
    """``smooth``, linearised about ``path`` at first."""
    worse = 0
    best: Smoothed | None = None
    for rounds in range(1, MOST_ROUNDS + 1):
        try:
            first, known, chain = _linear(arc, path)
        except DynamicsError:
            if best is None:
                raise
            break
        better, change = _improved(arc, path, first, known)
        progress(rounds, MOST_ROUNDS)
        worse += 1
        if best is None or change < best.change:
            evidence = chain.evidence + arc.left_out(path)
            best = Smoothed(arc, path, first, known, evidence, change, rounds)
            worse = 0
        if best.change <= SETTLED or worse == _MOST_WORSE or better is None:
            break
        path = better
    assert best is not None, "there was a round"
    return best


def with_remainders(smoothed: Smoothed) -> Smoothed:
    """The motion with the errors of linearising as noise of each moment.

    Errors that fade leave directions without deviations; the products of the errors that stay do
    not fade there. The variance of these products follows from the covariance at each moment
    (Garcia-Fernandez, Svensson and Särkkä, Iterated posterior linearization smoother, 2017).
    """
    arc, d, count = smoothed.arc, 1 + smoothed.arc.first.mean.size, len(smoothed.arc.moments)
    roots = _room(count, d * d).reshape(count, d, d)
    for k in range(count):
        roots[k] = triangular(smoothed.known.state(Node(k)).root)
    path = smoothed.path._replace(roots=roots)
    first, known, _ = _linear(arc, path)
    for i, node in enumerate(known.nodes):
        known.set(i, known.state(node)._replace(mean=smoothed.known.state(node).mean))
    first = first._replace(mean=smoothed.first.mean)
    return smoothed._replace(path=path, first=first, known=known)


def at_samples(smoothed: Smoothed, times: Mapping[int, Sequence[float]]) -> Iterator[Normal]:
    """The states (q, u, constants) at ``times`` (s since the epoch) in flights with noise.

    ``times`` are ascending, by the moment that the flight follows. Each time is a moment of its
    own without a switch.
    """
    arc, path, wanted = smoothed.arc.sampled(smoothed.path, times)
    _, known, _ = _linear(arc, path)
    for k in wanted:
        step = arc.left(path, k)
        yield known.state(Node(k, arc.rests(k))).mapped(step.A, step.b, step.N)


def _linear(arc: Arc, path: Path) -> tuple[Normal, KnownStates, Chain]:
    """The first state, those at all nodes, and their chain, linearised about ``path``.

    Raises:
        DynamicsError: the smoothed motion grows beyond all bounds.
    """
    nodes = arc.nodes(path)
    first, known = arc.first, KnownStates(nodes, 1 + arc.first.mean.size)

    def step(i: int) -> Step:
        return arc.step(path, nodes[i])

    is_small = len(nodes) * arc.first.root.size <= _FEW_NUMBERS
    chain = Chain(arc.first, len(nodes), cache(step) if is_small else step)
    for i, z in chain.states():
        begin = 0 if i < 0 or nodes[i].is_after else 1
        followed(z.mean[begin : begin + 2 * arc.filter.system.n])
        if i < 0:
            first = z
        else:
            known.set(i, z)
    return first, known, chain


def _improved(
    arc: Arc, path: Path, first: Normal, known: KnownStates
) -> tuple[Path | None, float]:
    """The path of the smoothed motion, and its distance from ``path``, in deviations.

    The path is None if its states grow beyond all bounds.
    """
    early, x, doubt, largest = path.early.copy(), path.x.copy(), path.doubt.copy(), 0.0
    constants = path.constants
    instants = [arc.instant(path, k) for k in range(-1, len(early))]
    room = _ROOM * np.maximum(np.diff(instants, append=np.inf), 0.0)
    for node in known.nodes:
        if node.is_after:
            continue
        k, z = node.moment, known.state(node)
        doubt[k] = arc.gap_deviation(k, z.mean[1:], z.root[1:])
        constants = z.mean[1 + x.shape[1] :]
        farthest = arc.filter.conditioning.farthest(arc.moments[k].change)
        on, back = min(float(room[k + 1]), farthest), min(float(room[k]), farthest)
        e = min(max(float(z.mean[0]), -on), back)
        early[k] += e
        is_measured = not arc.moments[k].is_inserted
        now = z.mean[1 : 1 + x.shape[1]]
        moved = np.append(now - path.x[k], constants - path.constants)
        x[k] = arc.moved_before(path, k, now, -e)
        deviations = np.hypot(z.deviations[1:], arc.rounding(now))
        # The instant of an inserted moment in a chattering sequence is rounding.
        far = np.abs(moved) / np.maximum(deviations, TINY)
        largest = max(largest, float(np.max(far)) * is_measured)
    if not np.max(np.abs(x), initial=0.0) <= LARGEST_STATE:
        return None, largest
    start = first.mean[: x.shape[1]]
    nothing = np.zeros((constants.size, 0))
    constants = arc.filter.members.parameters.bounded(constants, nothing, 0)
    return Path(start, early, x, doubt, constants), largest
