# SPDX-License-Identifier: Apache-2.0
"""Cases of a sweep: a run of the plant, its sensor, an observer, and metrics of its estimate.

The random numbers of a case come from its own seed, so order and place of the cases do not matter.
Cases of the same run share the seed: laws, sensors and models are compared on equal initial states
and equal random numbers of the sensor.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import product

import numpy as np

from impact_observer.compare.comparison import compare_replicas
from impact_observer.compare.metrics import METRICS
from impact_observer.errors import ImpactObserverError, ModelError, UsageError
from impact_observer.io.pairing import samples_of
from impact_observer.io.simulated_samples import SampleSimulation, samples_of_run
from impact_observer.model import Model, parse_model
from impact_observer.model.free_parameters import parametric_family, with_unit
from impact_observer.model.measurement import Measurement
from impact_observer.observer import Observer, Options, law_named, make_observer
from impact_observer.observer.laws import ReplicaLaw
from impact_observer.observer.make_observer import initial_state
from impact_observer.observer.samples import SensorSample
from impact_observer.plant import (
    Plant,
    Run,
    SensorModel,
    SensorSimulation,
    simulate,
    simulate_sensor,
)
from impact_observer.sensor_faults import SENSOR_FAULTS
from impact_observer.stamps import from_seconds, grid
from impact_observer.states import Stamps

Value = str | int | float | bool | None
RANDOM = "random"
"""The initial state ``random:SEED`` with the seed of the run."""
SENSOR, OFF = "sensor_", "off_"
"""Prefixes of columns: faults of the sensor, and parameters of the observer's model."""
FIGURES = (
    "settling_time",
    "V_start",
    "V_end",
    "V_ratio",
    "V_largest_rise",
    "rate_per_second",
    "rate_per_impact",
)
"""Metrics of ``compare`` that a row has."""
COUNTS = ("events", "impacts_used", "switches_rejected", "impacts_inserted")
"""Whole numbers of a row: events of the sensor, and what the observer made of their impacts."""
_TOGETHER = 250
"""Most cases whose replicas run together: more would need more memory."""
_METRICS = {each.key: each for each in METRICS}


@dataclass(frozen=True, slots=True)
class Sweep:
    """Every combination of law, sensor and model of the observer, each with several seeds.

    Attributes:
        model: text of the plant's model file, with an initial state.
        laws: names of the observers' laws.
        sensors: the sensors with their faults.
        models: texts of the observers' model files, with the swept parameters of each by name.
        duration: of the plant's run, s.
        rate: of the samples at which estimates are compared, Hz.
        epoch: stamp of ``t = 0``, ns.
        runs: number of seeds.
        seed: of the first run; run k has ``seed + k``.
        options: of the observers except the law; the initial state may be ``RANDOM``.
        measurements: of sensors beside the impacts.
    """

    model: str
    laws: tuple[str, ...]
    sensors: tuple[SensorModel, ...]
    models: tuple[tuple[str, Mapping[str, float]], ...]
    duration: float = 30.0
    rate: float = 100.0
    epoch: int = 1_000_000_000
    runs: int = 20
    seed: int = 0
    options: Options = Options(initial_state=RANDOM)  # noqa: RUF009 (it is immutable)
    measurements: tuple[Measurement, ...] = ()

    @property
    def stamps(self) -> Stamps:
        """Stamps of the samples, ns, shape (samples,)."""
        return grid(self.epoch, self.epoch + from_seconds(self.duration), self.rate)

    @property
    def plant_run(self) -> Run:
        """The run of the plant, the same in all cases.

        Raises:
            ImpactLawError, DynamicsError: its motion has no solution.
        """
        return _plant_run(self.model, self.epoch, self.duration, self.rate)

    @property
    def size(self) -> int:
        """Number of cases."""
        return len(self.laws) * len(self.sensors) * len(self.models) * self.runs

    def check(self) -> None:
        """Raise the error of a law, sensor, option or model that no case can use.

        Raises:
            UsageError, ModelError: by the name at fault.
        """
        if self.stamps.size < 2:
            raise UsageError(
                f"sweep: one sample found in {self.duration:g} s at {self.rate:g} Hz; expected two"
            )
        system, sensors = parsed(self.model).system, parsed(self.model).sensors
        for sensor in self.sensors:
            SensorSimulation(sensor, system, sensors=sensors, epoch=self.epoch)
        for law in self.laws:
            self._observer(law, self.models[0][0], 0)
        if self.measurements:
            SampleSimulation(self.measurements, system, self.rate, self.seed)

    @property
    def blocks(self) -> list[range]:
        """The cases in parts that differ in their run only."""
        return [
            range(first, min(first + _TOGETHER, begin + self.runs))
            for begin in range(0, self.size, self.runs)
            for first in range(begin, begin + self.runs, _TOGETHER)
        ]

    def rows(self, block: range) -> list[dict[str, Value]]:
        """Labels of the cases of a block, metrics (None for undefined ones), and error or "".

        V is the energy of the plant, also for another model. A case that fails gives a row with
        the error, and the sweep goes on.
        """
        rows = []
        for cases in self._alike(block):
            rows += self._rows(cases)
        return rows

    def _rows(self, cases: Sequence[int]) -> list[dict[str, Value]]:
        """The rows of cases with equal events, which run as replicas of one observer."""
        nothing = dict.fromkeys((*FIGURES, *COUNTS))
        try:
            found = self._metrics(cases)
            return [
                {**self.labels(number), **nothing, **each, "error": ""}
                for number, each in zip(cases, found, strict=True)
            ]
        except ImpactObserverError as error:
            problem = str(error)
        except Exception as error:  # noqa: BLE001 (a bug in one law must not stop the other cases)
            problem = " ".join(f"{type(error).__name__}: {error}".split())
        if len(cases) > 1:  # which one it is
            return [row for number in cases for row in self._rows([number])]
        return [{**self.labels(cases[0]), **nothing, "error": problem}]

    def labels(self, number: int) -> dict[str, Value]:
        """Law, seed, start, faults and parameters of a case."""
        law, sensor, (_, off), run = self._place(number)
        faults = {each.name: getattr(sensor, each.name) for each in fields(SensorModel)}
        return {
            "case": number,
            "law": law,
            "run": run,
            "seed": self.seed + run,
            "initial": self._start(run),
            **{SENSOR + k: v if isinstance(v, bool) else float(v) for k, v in faults.items()},
            **{OFF + name: value for name, value in off.items()},
        }

    @property
    def swept(self) -> list[str]:
        """The columns of faults and parameters that have several values."""
        rows = [self.labels(number) for number in range(0, self.size, self.runs)]
        columns = [name for name in rows[0] if name.startswith((SENSOR, OFF))]
        return [name for name in columns if len({row[name] for row in rows}) > 1]

    def title(self, column: str) -> str:
        """The heading of a swept column, with its unit."""
        if column.startswith(OFF):
            unit = parsed(self.model).system.unit
            return f"observer's {with_unit(column.removeprefix(OFF), unit)}"
        fault = next(each for each in SENSOR_FAULTS if SENSOR + each.name == column)
        words = fault.name.replace("_", " ")
        return f"{words} [{fault.unit}]" if fault.unit else words

    def _place(self, number: int) -> tuple[str, SensorModel, tuple[str, Mapping[str, float]], int]:
        """Law, sensor, model of the observer, and run of a case."""
        shape = len(self.laws), len(self.sensors), len(self.models), self.runs
        law, sensor, model, run = map(int, np.unravel_index(number, shape))
        return self.laws[law], self.sensors[sensor], self.models[model], run

    def _start(self, run: int) -> str:
        """The initial state of the observer in a run."""
        start = self.options.initial_state
        return f"{RANDOM}:{self.seed + run}" if start == RANDOM else start

    def _observer(self, law: str, model: str, run: int) -> Observer:
        """An observer with one replica."""
        options = replace(
            self.options,
            law=law,
            initial_state=self._start(run),
            ensemble=1,
            epoch=self.epoch,
        )
        return make_observer(parsed(model), options, measurements=self.measurements)

    def _alike(self, block: range) -> list[list[int]]:
        """The cases of a block, those with equal events together if the law has replicas."""
        law, sensor, _, _ = self._place(block[0])
        is_exact = not (sensor.faults or parsed(self.model).sensors)
        has_replicas = issubclass(law_named(law), ReplicaLaw)
        if is_exact and has_replicas and not self.measurements:
            return [[*block]]
        return [[number] for number in block]

    def _metrics(self, cases: Sequence[int]) -> list[dict[str, Value]]:
        law, sensor, (model, _), k = self._place(cases[0])
        run, system, seed = self.plant_run, parsed(self.model).system, self.seed + k
        starts = [self._start(self._place(number)[-1]) for number in cases]
        sensed = simulate_sensor(
            sensor,
            system,
            run.switchings,
            sensors=parsed(self.model).sensors,
            epoch=run.epoch,
            last=int(run.stamps[-1]),
            seed=seed,
        )
        events = sorted((each.event for each in sensed), key=lambda e: (e.stamp, e.sequence))
        samples = list[SensorSample]()
        if self.measurements:
            simulation = SampleSimulation(self.measurements, system, self.rate, seed)
            samples = samples_of_run(simulation, run)
        observer = self._observer(law, model, k)
        states = [np.concatenate(initial_state(each, system)) for each in starts]
        observer.start_from(np.array(states))
        comparisons = compare_replicas(
            observer,
            events,
            samples_of(run.stamps, run.states),
            system=system,
            needs_event=False,
            samples=samples,
        )
        keys = (*FIGURES, *COUNTS[1:])
        return [
            {**{key: _METRICS[key].value(each) for key in keys}, "events": len(events)}
            for each in comparisons
        ]


@lru_cache(maxsize=64)
def parsed(text: str) -> Model:
    """The model in a text, which many cases share.

    Raises:
        ModelError: the model is invalid.
    """
    return parse_model(text, "model")


@lru_cache(maxsize=4)
def _plant_run(text: str, epoch: int, duration: float, rate: float) -> Run:
    model, stamps = parsed(text), grid(epoch, epoch + from_seconds(duration), rate)
    return simulate(Plant(model.system, *model.initial_state(), epoch=epoch), stamps)


def sensors_of(faults: Mapping[str, Sequence[float | bool]]) -> tuple[SensorModel, ...]:
    """A sensor for every combination of the values of ``faults``; an ideal one for none.

    Raises:
        UsageError: a value that a fault cannot have.
    """
    return tuple(
        SensorModel(**dict(zip(faults, values, strict=True)))  # type: ignore[arg-type]
        for values in product(*faults.values())
    )


def models_of(
    model: Model, off: Mapping[str, Sequence[float]]
) -> tuple[tuple[str, Mapping[str, float]], ...]:
    """Texts of model files with the parameters of each: one for every combination of values.

    Args:
        model: of the plant.
        off: values by the names of parameters as in ``identify``, such as ``gap.stop``; a name
            without a point sets all parameters of its kind.

    Raises:
        UsageError: the model has no such parameter.
        ModelError: the values make no valid model.
    """
    if not off:
        return ((Model(model.system).text(), {}),)
    try:
        family = parametric_family(model.system, [*off], model.elements)
    except UsageError as error:
        raise UsageError(f"off: {error}") from None
    # The name in ``off`` of each parameter: its own, or its kind.
    kinds = [name if name in off else name.partition(".")[0] for name in family.names]
    made = []
    for values in product(*off.values()):
        chosen = dict(zip(off, map(float, values), strict=True))
        try:
            system = family.system_at(np.array([chosen[kind] for kind in kinds]))
        except ModelError as error:
            shown = ", ".join(f"{name} {value:g}" for name, value in chosen.items())
            raise ModelError("", f"off: {shown}: {error}") from None
        made.append((Model(system).text(), chosen))
    return tuple(made)
