"""Flow under a sampled forcing, exact between the samples and from one to the next.

The motion is that without samples plus the response ``r`` of a system at rest to the samples. Over
a time ``h`` in which the force is ``a + b s``, the response goes from ``r`` to ::

    r + D(h) r + P1(h) a + P2(h) b,    D = e^{Ah} - 1,    P1, P2 = once and twice integrated e^{As}

``D`` and not ``e^{Ah}``: many short steps then add up without a bias. The steps are taken once,
in order and in blocks of fixed size from the phase's start, so that the result does not depend
on which instants are asked for, to the bit.
"""

from abc import ABC, abstractmethod
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.dynamics.flow.flow import Flow, Motion
from impact_observer.model.force_samples import Samples
from impact_observer.states import Matrix, Vector

ResponseValues: TypeAlias = NDArray[np.inexact[Any]]
"""Real or complex response in coordinates of a ``Response``, columns (samples, ..., size, 1)."""

_TERMS = 18
"""Terms of the power series over times that are short against the fastest rate."""
_BLOCK = 128
"""Samples that are stepped over together."""
_ENTRIES = 1 << 22
"""Most entries of propagators that are held at once."""


class Propagators(NamedTuple):
    """``D``, ``P1`` and ``P2`` for several times, each of shape (times, ..., size, columns)."""

    change: ResponseValues
    step: ResponseValues
    ramp: ResponseValues

    def applied(
        self, y: ResponseValues, value: ResponseValues, slope: ResponseValues
    ) -> ResponseValues:
        """The responses after these times, begun at ``y``, under loads ``value + slope s``."""
        return np.asarray(y + (self.change @ y + self.loaded(value, slope)))

    def loaded(self, value: ResponseValues, slope: ResponseValues) -> ResponseValues:
        """The responses from rest."""
        return np.asarray(self.step @ value + self.ramp @ slope)

    def of(self, times: NDArray[np.intp]) -> "Propagators":
        """Those for some of the times, by index."""
        return Propagators(self.change[times], self.step[times], self.ramp[times])


class Response(ABC):
    """How a system at rest responds to forces: ``dy/dt = A y + B load``, in blocks side by side.

    Attributes:
        A: blocks, shape (..., size, size), 1/s.
        B: shape (..., size, columns).
        entries: numbers in the propagators for one time.
    """

    def __init__(self, A: ResponseValues, B: ResponseValues, short: bool) -> None:
        """Where all times are ``short`` against the fastest rate, a power series does it all."""
        self.A, self.B = A, B
        self.entries = A.size
        self._coefficients: list[ResponseValues] | None = None
        if short:
            powers = [B]
            for _ in range(_TERMS - 1):
                powers.append(A @ powers[-1])
            change = [A]
            for _ in range(_TERMS - 1):
                change.append(A @ change[-1])
            self._coefficients = [np.stack(change), np.stack(powers)]

    @property
    def rest(self) -> ResponseValues:
        """The response at the start, shape (..., size, 1)."""
        return np.zeros_like(self.A[..., :1])

    def propagators(self, h: Vector) -> Propagators:
        """Propagators over times ``h``, shape (times,), s."""
        if self._coefficients is None:
            return self.closed_form(h)
        change, powers = self._coefficients
        # h^k / k! from k = 1 on
        weights = np.cumprod(h[:, None] / np.arange(1, _TERMS + 2), axis=1)
        return Propagators(
            np.tensordot(weights[:, :-1], change, axes=1),
            np.tensordot(weights[:, :-1], powers, axes=1),
            np.tensordot(weights[:, 1:], powers, axes=1),
        )

    @abstractmethod
    def loads(self, force: Matrix) -> ResponseValues:
        """Forces, shape (samples, n), as loads of the coordinates, (samples, ..., columns, 1)."""

    @abstractmethod
    def closed_form(self, h: Vector) -> Propagators:
        """Propagators over times ``h``, shape (times,), s, of any length."""

    @abstractmethod
    def states(self, y: ResponseValues) -> Matrix:
        """States (q, u) of responses, shape (samples, 2n)."""


class SampledFlow(Flow):
    """A flow without samples, and the response to them added."""

    def __init__(self, smooth: Flow, response: Response, samples: Samples) -> None:
        """Join a flow and a response of the same system."""
        self._smooth = smooth
        self._response = response
        self._samples = samples

    def start(self, t: float, x: Vector) -> Motion:
        """The motion through ``x`` at ``t``.

        Raises:
            DynamicsError: there is no sample at ``t``.
        """
        return _SampledMotion(self._smooth.start(t, x), self._response, self._samples)

    def transition(self, s: float) -> Matrix:
        """That of the flow without samples."""
        return self._smooth.transition(s)


class _SampledMotion(Motion):
    """Intervals are counted from the phase's start; the first one begins there."""

    def __init__(self, smooth: Motion, response: Response, samples: Samples) -> None:
        self.t = smooth.t
        self._smooth, self._response, self._samples = smooth, response, samples
        now = np.array([self.t])
        self._from = int(samples.index(now)[0])
        self._force = samples.values(now)
        # The last sample begins an interval only for a phase that starts there.
        stop = max(samples.time.size - 1, self._from + 1)
        self._begins = np.concatenate([[0.0], samples.time[self._from + 1 : stop] - self.t])
        self._blocks: list[ResponseValues] = []
        self._next = response.rest

    def states(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        self._samples.check(self.t + s)
        free = self._smooth.states(s)
        if not s.size:
            return free
        interval = np.searchsorted(self._begins, s, side="right") - 1
        at_once = max(1, _ENTRIES // self._response.entries)
        responses = [
            self._responses(interval[i : i + at_once], s[i : i + at_once])
            for i in range(0, s.size, at_once)
        ]
        return np.asarray(free + np.concatenate(responses))

    def _responses(self, interval: NDArray[np.intp], s: Vector) -> Matrix:
        first, last = int(interval.min()) // _BLOCK, int(interval.max()) // _BLOCK
        while len(self._blocks) <= last:
            self._blocks.append(self._step_over_next())
        y = np.concatenate(self._blocks[first : last + 1])[interval - first * _BLOCK]
        propagators = self._response.propagators(s - self._begins[interval])
        return self._response.states(propagators.applied(y, *self._loads(interval)))

    def _step_over_next(self) -> ResponseValues:
        """Responses where each interval of the next block begins."""
        start = len(self._blocks) * _BLOCK
        interval = np.arange(start, min(start + _BLOCK, self._begins.size))
        h = self._samples.steps[np.minimum(self._from + interval, self._samples.steps.size - 1)]
        if start == 0 and self._begins.size > 1:
            h = np.concatenate([self._begins[1:2], h[1:]])
        distinct, which = np.unique(h, return_inverse=True)
        each = self._response.propagators(distinct).of(which)
        loaded = each.loaded(*self._loads(interval))
        y, found = self._next, []
        for change, load in zip(each.change, loaded, strict=True):
            found.append(y)
            y = y + (change @ y + load)
        self._next = y
        return np.stack(found)

    def _loads(self, interval: NDArray[np.intp]) -> tuple[ResponseValues, ResponseValues]:
        """Value at the begin and slope of the load in each interval."""
        sample = self._from + interval
        force = np.where((interval == 0)[:, None], self._force, self._samples.force[sample])
        slope = self._samples.slope[sample]
        return self._response.loads(force), self._response.loads(slope)
