# SPDX-License-Identifier: Apache-2.0
"""The chain of a recording: its moments, rests, and samples of sensors in between.

The first linearisation is about the path of the filter through the account. The samples of a
flight without process noise are functions of the state at the flight's start: all are measured
there at once. In a flight with noise each sample is a step of the chain. Samples near an uncertain
instant, or too soon after an impact, are left out.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.model_error import ErrorKind
from impact_observer.filter.readings import Place, Reading, Row
from impact_observer.filter.sample_update import SampleFilter
from impact_observer.kernel._kernel import TINY
from impact_observer.smooth.account import Moment
from impact_observer.smooth.chain import Step
from impact_observer.smooth.linearised import Linearised, Path, followed, level_of
from impact_observer.smooth.used_samples import NO_SAMPLES, UsedSamples, measured
from impact_observer.states import Vector

_MARGIN = 5.0
"""Distance of a sample from an instant, in deviations, below which the order is uncertain."""


class Node(NamedTuple):
    """A step of the chain.

    Attributes:
        moment: its index; -1 for the start.
        is_rest: whether the step measures that contacts rest after the moment.
        group: number of the measured group of samples in the flight after the moment; 0 for none.
    """

    moment: int
    is_rest: bool = False
    group: int = 0

    @property
    def is_after(self) -> bool:
        """Whether the state is after the moment, without the error ``e`` of the instant."""
        return self.is_rest or bool(self.group)


class _Group(NamedTuple):
    """Samples of a flight that are measured at once.

    Attributes:
        since: s since the epoch at which their step of the chain is; None for where the flight
            begins.
        readings: the samples.
    """

    since: float | None
    readings: Sequence[Reading]


class Arc(Linearised):
    """A recording from its first state on, by its account.

    Attributes:
        samples: samples of sensors beside the impacts.
    """

    def __init__(
        self,
        filter_: ImpactFilter,
        t: float,
        first: GaussianState,
        moments: Sequence[Moment],
        samples: UsedSamples = NO_SAMPLES,
    ) -> None:
        """The state ``first`` holds at ``t``, s since the epoch; no contact is closed then."""
        super().__init__(filter_, t, first, moments)
        self.samples, self._sample_filter = samples, SampleFilter(filter_)
        self._measured: tuple[Path | None, dict[int, list[_Group]]] = (None, {})

    def predicted(self) -> Path:
        """The path of the filter from the first state.

        Raises:
            DynamicsError: the filter's state grows beyond all bounds.
        """
        count, filter_ = len(self.moments), self.filter
        conditioning = filter_.conditioning
        early, doubt, x = np.zeros(count), np.zeros(count), np.zeros((count, self._size))
        state, t = self._state, self._t
        start = state.x
        margins = np.array([self._margin(each) for each in self.moments])
        flights = self._flights(np.array([each.change.t for each in self.moments]), margins)
        for k, moment in enumerate(self.moments):
            change = moment.change
            for reading in (self.samples.readings[i] for i in flights.get(k - 1, ())):
                state, t = self._corrected(t, state, reading, moment), reading.t
            prediction = filter_.predict(t, state, level_of(moment, ErrorKind.ACCELERATION))
            prior = prediction.prior(change.t - t)
            x[k], t = followed(prior.x), change.t
            doubt[k] = self.gap_deviation(k, prior.x, prior.root)
            if moment.is_inserted:
                state = filter_.posterior_of_missed(change, prior)
            else:
                joint = conditioning.joint_prior(change, prior, moment.clock)
                joint = conditioning.joint_posterior(change, joint)
                early[k], x[k] = change.t - joint.t, followed(joint.x)
                state = conditioning.after_jump(change, joint, math.inf if moment.until else 0.0)
            followed(state.x)
        return Path(start, early, x, doubt, state.constants)

    @property
    def is_of_robot(self) -> bool:
        """Whether torques move the motion away from the path, and encoders tell where to.

        Then the filter alone decides which samples count, and samples after the last moment do.
        """
        return self.filter.is_of_robot

    def nodes(self, path: Path) -> list[Node]:
        """The steps of the chain: moments, rests and samples after them."""
        groups, nodes = self._groups(path), list[Node]()
        for k in range(-1, len(self.moments)):
            nodes += [Node(k)] if k >= 0 else []
            nodes += [Node(k, is_rest=True)] if self.rests(k) else []
            nodes += [Node(k, group=j + 1) for j in range(len(groups.get(k, ())))]
        return nodes

    def step(self, path: Path, node: Node) -> Step:
        """The step of the chain that leads to ``node``."""
        if node.group:
            return self.sampling(path, node.moment, node.group - 1)
        return (self.resting if node.is_rest else self.arrival)(path, node.moment)

    def gated(self, path: Path) -> "Arc":
        """The arc in which samples are rejected that are too far from a smoothed path."""
        rejected = {
            i
            for k, some in self._flights(*self._places(path), everything=True).items()
            for i in some
            if self._is_far(path, k, self.samples.readings[i])
        }
        samples = self.samples._replace(rejected=frozenset(rejected))
        return Arc(self.filter, self._t, self._state, self.moments, samples)

    def used_samples(self, path: Path) -> list[Reading]:
        """The samples that a path uses."""
        flights = self._flights(*self._places(path)).values()
        return [self.samples.readings[i] for some in flights for i in some]

    def left_out(self, path: Path) -> float:
        """Logarithm of the density of the samples that are not used."""
        used = sum(len(g.readings) for some in self._groups(path).values() for g in some)
        return self.samples.left_out(used)

    def sampled(
        self, path: Path, times: Mapping[int, Sequence[float]]
    ) -> tuple["Arc", Path, list[int]]:
        """Arc and path with more moments, without a switch, at ``times``; indices of these.

        ``times`` (s since the epoch) are ascending, by the moment that they follow.
        """
        moments, early, states, wanted = list[Moment](), list[float](), list[Vector](), list[int]()
        for k in range(-1, len(self.moments)):
            if k >= 0:
                moments.append(self.moments[k])
                early.append(float(path.early[k]))
                states.append(path.x[k])
            closed = self.closed_after(k)
            for at in times.get(k, ()):
                wanted.append(len(moments))
                error = self.moments[min(k + 1, len(self.moments) - 1)].error
                moments.append(Moment(ContactChange(at, closed, (), closed), 0.0, error))
                early.append(0.0)
                states.append(self._state_at(path, k, at))
        used = {i for some in self._flights(*self._places(path)).values() for i in some}
        others = frozenset(range(len(self.samples.readings))) - used
        samples = self.samples._replace(rejected=others)
        arc = Arc(self.filter, self._t, self._state, moments, samples)
        doubt = np.zeros(len(moments))
        own = [k for k in range(len(moments)) if k not in {*wanted}]
        doubt[own], roots = path.doubt, path.roots
        if roots is not None:
            roots = np.zeros((len(moments), *roots.shape[1:]))
            roots[own] = path.roots
        path = path._replace(early=np.array(early), x=np.array(states), doubt=doubt, roots=roots)
        return arc, path, wanted

    def arrival(self, path: Path, k: int) -> Step:
        """From the node before the ``k``-th moment to the moment, and its measurement."""
        t = self.instant(path, k)
        groups = self._groups(path).get(k - 1)
        if groups:
            flown = self.flight(path, k - 1, t, groups[-1].since)
        else:
            flown = self.flight(path, k - 1, t).preceded_by(self.left(path, k - 1))
        return self._stamped(path, k).preceded_by(flown)

    def sampling(self, path: Path, k: int, j: int) -> Step:
        """The flight to the ``j``-th group of samples after the ``k``-th moment, and the group."""
        groups = self._groups(path)[k]
        since = groups[j].since
        if j:
            assert since is not None, "groups have instants of their own"
            moved = self.flight(path, k, since, groups[j - 1].since)
        else:
            moved = self.left(path, k)
            if since is not None:
                moved = self.flight(path, k, since).preceded_by(moved)
        rows, values, deviations = list[Vector](), list[float](), list[float]()
        about = np.append(self._state_at(path, k, since), path.constants)
        for each in groups[j].readings:
            x, A = about[: self._size], np.eye(about.size)
            if each.t != since:
                flown = self.flight(path, k, each.t, since, noisy=False)
                x, A = (flown.A @ about + flown.b)[: self._size], flown.A
            row, noise = self._row(path, k, each, x)
            h = np.concatenate([row.h, row.of_theta, np.zeros(about.size)])[: about.size]
            rows.append(h @ A)
            deviations.append(noise)
            values.append(each.value - row.value(x) + float(rows[-1] @ about))
        step = measured(np.array(rows), np.array(values), np.array(deviations))
        return step.preceded_by(moved)

    def _groups(self, path: Path) -> dict[int, list[_Group]]:
        """The samples of each flight of a path, by the moment before it."""
        if self._measured[0] is not path:
            flights = dict[int, list[_Group]]()
            for k, some in self._flights(*self._places(path)).items():
                readings = [self.samples.readings[i] for i in some]
                flights[k] = [_Group(None, readings)]
                if self.noise_after(k):
                    flights[k] = [
                        _Group(t, [*same]) for t, same in groupby(readings, attrgetter("t"))
                    ]
            self._measured = path, flights
        return self._measured[1]

    def _margin(self, moment: Moment) -> float:
        """Largest distance of a sample from a moment that leaves the sample out, s.

        Negative without a switch, which leaves no sample out.
        """
        if not moment.change.contacts:
            return -1.0
        return _MARGIN * moment.clock

    def _places(self, path: Path) -> tuple[Vector, Vector]:
        """The instants of all moments of a path, and their margins for samples, s."""
        instants, margins = list[float](), list[float]()
        for k, moment in enumerate(self.moments):
            instants.append(self.instant(path, k))
            margins.append(self._margin(moment))
            if moment.is_inserted and moment.change.hit:
                n, near = self._size // 2, self.filter.near(path.x[k])
                speed = float(near.W[:, moment.change.hit[0]] @ path.x[k, n:])
                margins[k] += _MARGIN * path.doubt[k] / max(abs(speed), TINY)
        return np.array(instants), np.array(margins)

    def _flights(
        self, instants: Vector, margins: Vector, *, everything: bool = False
    ) -> dict[int, list[int]]:
        """Indices of used samples in each flight; with ``everything`` also of rejected ones."""
        if not self.samples.readings:
            return {}
        some = self.samples._replace(rejected=frozenset()) if everything else self.samples
        return some.flights(instants, [bool(each.change.hit) for each in self.moments], margins)

    def _row(self, path: Path, k: int, reading: Reading, x: Vector) -> tuple[Row, float]:
        """Returns the row of a sample after the ``k``-th moment near ``x``, and its deviation."""
        at = Place(reading.t, reading.instant, x, self.closed_after(k))
        sensor, theta = reading.sensor, path.constants[: self._p]
        moving = self._members.given.moving
        row = sensor.row_of(self._members, theta, at) if self._p else sensor.row(moving, at)
        return row, math.hypot(sensor.measurement.deviation, row.rounding(self._sizes(x)))

    def _is_far(self, path: Path, k: int, reading: Reading) -> bool:
        """Whether the gate of a sample after the ``k``-th moment rejects it."""
        row, deviation = self._row(path, k, reading, x := self._state_at(path, k, reading.t))
        return abs(reading.value - row.value(x)) > reading.sensor.measurement.gate * deviation

    def _corrected(
        self, t: float, state: GaussianState, reading: Reading, moment: Moment
    ) -> GaussianState:
        """The filter's posterior of a sample, from the ``state`` at ``t``, s since the epoch."""
        level = level_of(moment, ErrorKind.ACCELERATION)
        prior = self.filter.predict(t, state, level).prior(reading.t - t)
        return self._sample_filter.after(reading, prior).state
