# SPDX-License-Identifier: Apache-2.0
"""Calls a kernel with wrong arguments: ``python -m kernel_fuzz SEED CALLS``, a process of its own.

KERNEL_FILE names the kernel. Plants and observers run while its calls are recorded. Then recorded
calls are repeated with wrong arguments. Each may return or raise an error. Prints how many did
what, by function; where the process does not come to its end, the last line of the standard error
has the call at fault.
"""

import json
import os
import random
import resource
import signal
import sys
from collections import Counter
from collections.abc import Callable
from types import ModuleType, WrapperDescriptorType
from typing import Any, NamedTuple

import kernel_loaded  # before the package
import numpy as np

MODELS = ("two_mass", "three_mass")
EACH = 30
"""Calls of a function that are kept."""
MEMORY = 4 << 30
"""Bytes that all calls together may use."""
SECONDS = 10
"""Processor time, s. A call that takes longer has no end."""
ERRORS = (ArithmeticError, IndexError, MemoryError, RuntimeError, TypeError, ValueError)
NUMBERS: tuple[object, ...] = (
    *(0, -1, 1, 3, 2**31, 2**62, 2**63, -(2**63), 2**64, 1.5, -1.5, 1e-300, 1e300, 5e-324),
    *(float("nan"), float("inf"), -float("inf"), True, None, "1", b"1", [], [[1.0]], 1j),
)


class Call(NamedTuple):
    """A call of a function, method or class; ``given`` and ``named`` are its arguments."""

    name: str
    function: Callable[..., object]
    given: tuple[Any, ...]
    named: dict[str, Any]


class Recorder:
    """Keeps the first calls of every callable of a module.

    Attributes:
        calls: by the name of what is called.
        classes: of the module.
    """

    def __init__(self, module: ModuleType) -> None:
        """Put itself between the module's callables and their callers."""
        self.calls: dict[str, list[Call]] = {}
        self.classes: list[Any] = []
        for name, value in list(vars(module).items()):
            if isinstance(value, type):
                self.classes.append(value)
                for method, function in list(vars(value).items()):
                    if is_callable(method, function):
                        setattr(value, method, self._between(f"{name}.{method}", function, value))
            elif callable(value):
                setattr(module, name, self._between(name, value))

    def _between(
        self,
        name: str,
        function: Callable[..., object],
        owner: Any = None,  # noqa: ANN401
    ) -> Callable[..., object]:
        calls = self.calls[name] = []
        makes = name.endswith(".__init__")  # again on the same object it would do nothing

        def between(*given: object, **named: object) -> object:
            if len(calls) < EACH:
                again, copy = owner if makes else function, copied(given)
                calls.append(Call(name, again, copy[1:] if makes else copy, named))
            return function(*given, **named)

        return between


def is_callable(name: str, value: object) -> bool:
    """Whether this attribute of a class is a method, or a constructor that Python may call."""
    public = name == "__init__" or not name.startswith("_")
    return public and callable(value) and not isinstance(value, WrapperDescriptorType)


def copied(value: Any) -> Any:  # noqa: ANN401
    """The same with arrays of its own: the caller may change them later."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, (tuple, list)):
        return [*map(copied, value)] if isinstance(value, list) else tuple(map(copied, value))
    return value


def use_what_only_tests_use(calls: dict[str, list[Call]]) -> None:
    """Call what plants and observers do not call, on objects that they have made."""
    from impact_observer.kernel._kernel import falls_at

    w = calls["Impact.__init__"][0].given[1]
    falls_at(lambda s: 1.0 - s, 0.0, 2.0)
    motion = calls["Family.__init__"][0].given[0]
    motion.moved(0.1, np.ones(2 * w.size), 0.2)
    impact, t, _, states, _ = calls["Impact.posteriors"][0].given
    impact.missed(np.full(len(states), t), states)


def estimate_parameters() -> None:
    """Correct and predict a state with parameters, by kernel and general methods."""
    from systems import PRESSED, corrected

    from impact_observer.filter.contact_change import ContactChange
    from impact_observer.filter.gaussian_state import GaussianState
    from impact_observer.filter.impact_filter import ImpactFilter
    from impact_observer.filter.unknown_parameters import UnknownParameters

    unknowns = UnknownParameters.named(PRESSED, ["stiffness-scale", "restitution", "gap"])
    filter_, theta = ImpactFilter(PRESSED, 0.0, unknowns), unknowns.family.nominal
    d, p = 4 + theta.size, theta.size
    state = GaussianState(np.full(4, 0.1), theta, 1e-3 * np.eye(d), np.ones((d, 1)), (), p)
    corrected(filter_, ContactChange(0.1, (), (0,), ()), state, 1e-6)
    filter_.priors(0.1, 0.2, [state], [0.1])
    filter_.predict(0.1, state, 0.1).prior(0.2)
    filter_.members.parameters.bounded(np.append(state.x, theta), state.root, 4)
    gaps = filter_.members.free_gaps
    gaps.dips(np.array([0.1]), np.array([5.0]), [state], np.zeros(1))
    gaps.root(0.1, state, 0.0, 0, 0.0, 0.5, 3.0)


def work() -> None:
    """Let plants and observers use the kernel in all phases and hypotheses that they have."""
    from systems import EPOCH, PRESSED

    from impact_observer import Options, Plant, System, grid, make_observer, read_model, simulate
    from impact_observer.model.measurement import Measurement
    from impact_observer.observer.laws.geometric import Geometric
    from impact_observer.observer.laws.robot_variance import RobotVariance
    from impact_observer.observer.samples import SensorSample

    class LinearVariance(RobotVariance):
        """The filter of robots, which calls the kernel for linear systems."""

        takes = (System,)

    stamps = grid(EPOCH, EPOCH + 2_000_000_000, 10.0)
    starts = [(model.system, *model.initial_state()) for model in map(read_model, MODELS)]
    starts.append((PRESSED, np.array([0.1, -0.2]), np.array([0.5, 0.0])))
    for system, q, u in starts:
        events = simulate(Plant(system, q, u, epoch=EPOCH), stamps).events
        for law in (Geometric, LinearVariance):
            encoder = Measurement("e", "/e", system.coordinates[0], "position", deviation=1.0)
            options = Options(initial_state="random:1", epoch=EPOCH)
            observer = make_observer(system, options, law=law, measurements=[encoder])
            for k, event in enumerate(events):
                if k % 5 != 3:  # missed
                    observer.receive(event)
            for stamp in stamps.tolist():
                observer.estimate(stamp)
                observer.measure([SensorSample(0, stamp + 1, 0.1)])


class Wrong:
    """Arguments that differ from good ones, drawn from a seed.

    Attributes:
        last: what was changed in the last ones.
    """

    def __init__(self, seed: int, recorder: Recorder) -> None:
        """Take objects of the kernel from what was recorded."""
        self._draw = random.Random(seed)
        self.last = ""
        found = [
            value for kept in recorder.calls.values() for call in kept for value in call.given
        ]
        self._objects = [value for value in found if isinstance(value, tuple(recorder.classes))]

    def arguments(self, call: Call) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """Those of a call, one or two of them wrong."""
        given, named = list(call.given), dict(call.named)
        self.last = ""
        places = [*range(len(given)), *named]
        for place in self._draw.sample(places, min(len(places), self._draw.choice((1, 1, 2)))):
            self.last += f"; argument {place}"
            if isinstance(place, str):
                named[place] = self.value(named[place])
            else:
                given[place] = self.value(given[place])
        if self._draw.random() < 0.02:
            given.append(self._draw.choice(NUMBERS))
        return tuple(given), named

    def value(self, good: Any) -> Any:  # noqa: ANN401
        """Something else of the same kind, or now and then of another."""
        if isinstance(good, (tuple, list)) and good and self._draw.random() < 0.95:
            parts = list(good)
            k = self._draw.randrange(len(parts))
            if self._draw.random() < 0.2:
                del parts[k]
            else:
                parts[k] = self.value(parts[k])
            return tuple(parts) if isinstance(good, tuple) else parts
        found = self._single(good)
        self.last += f"; instead of {good!r:.500}: {found!r:.500}"
        return found

    def _single(self, good: Any) -> Any:  # noqa: ANN401
        if self._draw.random() < 0.05:
            return self._draw.choice(NUMBERS)
        if isinstance(good, np.ndarray):
            return self._draw.choice(ARRAYS)(good.copy(), self._draw)
        if self._objects and isinstance(good, tuple({type(each) for each in self._objects})):
            return self._draw.choice(self._objects)
        if isinstance(good, (int, float)) and self._draw.random() < 0.3:
            return good * self._draw.choice((-1, 2, 20))
        return self._draw.choice(NUMBERS)


def spoiled(array: Any, draw: random.Random, values: tuple[float, ...]) -> Any:  # noqa: ANN401
    """The array with one value replaced."""
    if array.size and array.dtype.kind == "f":
        array.flat[draw.randrange(array.size)] = draw.choice(values)
    return array


def unaligned(array: Any) -> Any:  # noqa: ANN401
    """The same values, each between two addresses that the processor prefers."""
    data = np.frombuffer(b"x" + array.tobytes(), dtype=array.dtype, offset=1, count=array.size)
    return data.reshape(array.shape)


ARRAYS: tuple[Callable[[Any, random.Random], object], ...] = (
    lambda a, _: a.T,
    lambda a, _: a[..., ::-1],
    lambda a, _: np.repeat(a, 2, axis=-1)[..., ::2] if a.ndim else a,
    lambda a, _: np.asfortranarray(a),
    lambda a, _: np.broadcast_to(a.flat[0] if a.size else 0.0, a.shape),
    lambda a, _: unaligned(a),
    lambda a, _: a.astype(a.dtype.newbyteorder()),
    lambda a, _: a.setflags(write=False) or a,
    lambda a, _: a[:0],
    lambda a, _: a[..., :0],
    lambda a, _: a[1:],
    lambda a, _: a[..., :-1] if a.ndim else a,
    lambda a, _: a[None],
    lambda a, _: a[..., None],
    lambda a, _: a.reshape(-1),
    lambda a, _: np.concatenate([a, a]) if a.ndim else a,
    lambda a, _: np.concatenate([a, a], axis=-1) if a.ndim else a,
    lambda a, _: a.tolist(),
    lambda a, draw: a.astype(draw.choice(("f4", "i8", "i1", "u8", "?", "c16", "O", "U3", "V8"))),
    lambda a, _: np.empty((0,) * a.ndim),
    lambda a, _: np.zeros(a.shape),
    lambda a, _: np.zeros((3, 0, 2)[: a.ndim + 1]),
    lambda a, _: np.broadcast_to(0.5, (2**40, *a.shape[1:])),
    lambda a, draw: spoiled(a, draw, (float("nan"), float("inf"), -float("inf"))),
    lambda a, draw: spoiled(a, draw, (0.0, -1.0, 1e300, -1e300, 1e-300, 5e-324, 2.0**63)),
)
"""Shapes, orders, types and values that a function may not have been made for."""


def tried(call: Call, wrong: Wrong) -> str:
    """The name of the error that wrong arguments cause, ``returned`` or ``accepted NaN``.

    Raises:
        SystemError: the kernel returned without a result and without an error.
    """
    given, named = wrong.arguments(call)
    sys.stderr.write(f"{call.name} {' '.join(wrong.last.split())}\n")
    sys.stderr.flush()
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    try:
        call.function(*given, **named)
    except ERRORS as error:
        return type(error).__name__
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
    return "accepted NaN" if any(map(has_nan, (*given, *named.values()))) else "returned"


def has_nan(value: object) -> bool:
    """Whether a NaN is in an array, or in an array of a tuple or list."""
    if isinstance(value, (tuple, list)):
        return any(map(has_nan, value))
    if isinstance(value, np.ndarray) and value.dtype.kind in "fc":
        return bool(np.isnan(value).any())
    return False


def main(seed: int, count: int) -> None:
    """Record, then make ``count`` wrong calls of each function."""
    recorder = Recorder(kernel_loaded.MODULE)
    estimate_parameters()
    work()
    use_what_only_tests_use(recorder.calls)
    calls = {name: [*kept] for name, kept in recorder.calls.items()}
    wrong = Wrong(seed, recorder)
    if "asan" not in os.environ.get("LD_PRELOAD", ""):  # which reserves far more than it uses
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    found = {
        name: Counter(tried(kept[k % len(kept)], wrong) for k in range(count if kept else 0))
        for name, kept in calls.items()
    }
    sys.stdout.write(f"{json.dumps(found)}\n")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
