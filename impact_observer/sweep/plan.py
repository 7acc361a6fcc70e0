# SPDX-License-Identifier: Apache-2.0
"""A sweep and its cases.

Both are immutable values that can be pickled. A case has everything that its outcome depends
on, and its random numbers come from its own seed, so order and place of the runs do not matter.
Cases of the same run share the seed: laws, sensors and models are compared on equal initial
states and equal random numbers of the sensor.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from itertools import islice, product

from impact_observer import __version__
from impact_observer.compare.comparison import SETTLED
from impact_observer.errors import UsageError
from impact_observer.io.simulated_samples import SampleFaults, SampleSimulation
from impact_observer.model import Model, parse_model
from impact_observer.model.measurement import Measurement
from impact_observer.observer import (
    Options,
    ReplicaLaw,
    law_named,
    make_observer,
    options_of_laws,
)
from impact_observer.plant import Plant, Run, SensorModel, SensorSimulation, simulate
from impact_observer.sensor_faults import SENSOR_FAULTS
from impact_observer.stamps import from_seconds, grid
from impact_observer.states import Stamps
from impact_observer.sweep.model_variants import ModelVariant

BATCH = 512
"""Most cases that are computed at once."""
_FEW = 8
"""Most cases at once if contacts stay closed: each replica then moves by itself, at more cost."""
_SAMPLES = 2**22
"""Most samples of all cases that are computed at once."""
MOST_CASES = 10_000_000
"""Most cases of a sweep, whose outcomes are kept in memory."""
FORMAT = 1
"""Version of the description; a file with another version is of another sweep."""
RANDOM = "random"
"""The initial state ``random:SEED`` with the seed of the run."""
Label = str | int | float | bool
SENSOR = "sensor_"
OFF = "off_"


@dataclass(frozen=True, slots=True)
class PlantSetup:
    """A run of the plant, from the initial state of its model.

    Attributes:
        text: a model file in matrix form, with an initial state.
        duration: s.
        rate: of the samples at which estimates are compared, Hz; if it is too low, samples between
            the jumps of truth and estimate count as errors (see ``mismatch``).
        epoch: stamp of ``t = 0``, ns.
    """

    text: str
    duration: float = 30.0
    rate: float = 100.0
    epoch: int = 1_000_000_000

    @property
    def stamps(self) -> Stamps:
        """Stamps of the samples, ns."""
        return grid(self.epoch, self.epoch + from_seconds(self.duration), self.rate)


@lru_cache(maxsize=64)
def parsed(text: str) -> Model:
    """The model in a text, which many cases share.

    Raises:
        ModelError: the model is invalid.
    """
    return parse_model(text, "model")


@lru_cache(maxsize=4)
def plant_run(plant: PlantSetup) -> Run:
    """The run of the plant, which all cases of a sweep share.

    Raises:
        ModelError: the model is invalid, or has no initial state.
        ImpactLawError, DynamicsError: its motion has no solution.
    """
    model = parsed(plant.text)
    return simulate(Plant(model.system, *model.initial_state(), epoch=plant.epoch), plant.stamps)


@dataclass(frozen=True, slots=True)
class Case:
    """One run of plant, sensor and observer, with everything that the run depends on.

    Attributes:
        number: its place in the sweep.
        run: number of the seed, from 0.
        seed: of everything random in the run.
        plant: the run of the plant.
        sensor: the sensor with its faults.
        variant: the model of the observer.
        observer: options of the observer without the initial state.
        initial_state: initial state of the observer, as users write it.
        settled: V over V at the start below which an estimate has settled.
        measurements: of sensors beside the impacts, at the stamps of the plant's run.
    """

    number: int
    run: int
    seed: int
    plant: PlantSetup
    sensor: SensorModel
    variant: ModelVariant
    observer: Options
    initial_state: str
    settled: float = SETTLED
    measurements: tuple[Measurement, ...] = ()

    @property
    def options(self) -> Options:
        """Options of the observer with the initial state."""
        return replace(self.observer, initial_state=self.initial_state)

    @property
    def labels(self) -> dict[str, Label]:
        """The values that differ between cases of a sweep; all cases have the same names."""
        return {
            "case": self.number,
            "law": self.observer.law,
            "run": self.run,
            "seed": self.seed,
            "initial": self.initial_state,
            **_labels(self.sensor, self.variant),
        }


@lru_cache
def _labels(sensor: SensorModel, variant: ModelVariant) -> dict[str, Label]:
    """The labels of a sensor and a model, which all runs share."""
    values = {field.name: getattr(sensor, field.name) for field in fields(SensorModel)}
    return {
        **{SENSOR + k: v if isinstance(v, bool) else float(v) for k, v in values.items()},
        **{OFF + each.name: each.value for each in variant.parameters},
    }


@dataclass(frozen=True, slots=True)
class Sweep:
    """Every combination of law, sensor and model, each with several seeds.

    Attributes:
        plant: the run of the plant, the same in all cases.
        laws: names of the observers' laws.
        sensors: the sensors with their faults.
        variants: the models of the observers.
        runs: number of seeds.
        seed: of the first run; run k has ``seed + k``.
        options: of the observers except the law; ``initial`` may be ``RANDOM``.
        settled: V over V at the start below which an estimate has settled.
        measurements: of sensors beside the impacts, the same in all cases but for their noise.
    """

    plant: PlantSetup
    laws: tuple[str, ...]
    sensors: tuple[SensorModel, ...]
    variants: tuple[ModelVariant, ...]
    runs: int = 20
    seed: int = 0
    options: Options = Options(initial_state=RANDOM)  # noqa: RUF009 (it is immutable)
    settled: float = SETTLED
    measurements: tuple[Measurement, ...] = ()

    def __post_init__(self) -> None:
        """Check the values that all cases have in common.

        Raises:
            UsageError, ModelError: a law, a sensor, an option, a model that cannot be used.
        """
        if not 0 < self.size <= MOST_CASES:
            raise UsageError(f"sweep: {self.size} cases found; expected 1 to {MOST_CASES}")
        plant = self.plant
        if plant.stamps.size < 2:
            raise UsageError(
                f"sweep: one sample found in {plant.duration:g} s at {plant.rate:g} Hz;"
                " expected two"
            )
        system = parse_model(plant.text, "plant").system
        for sensor in self.sensors:
            SensorSimulation(sensor, system, epoch=plant.epoch)
        variant = parse_model(self.variants[0].text, "replica")
        for case in self._cases(self.sensors[:1], self.variants[:1], 1):
            make_observer(variant, case.options, measurements=self.measurements)
        SampleSimulation(self.measurements, system, SampleFaults(), self.seed)

    @property
    def size(self) -> int:
        """Number of cases."""
        return len(self.laws) * len(self.sensors) * len(self.variants) * self.runs

    def cases(self) -> Iterator[Case]:
        """All cases, in order of their numbers."""
        return self._cases(self.sensors, self.variants, self.runs)

    def batches(self, done: Collection[int] = ()) -> Iterator[tuple[Case, ...]]:
        """All cases in parts that run together, without the parts whose cases are all ``done``.

        Cases that differ only in their start are an ensemble: ``run_batch`` computes them at once.
        The parts are always the same, so that outcomes do not depend on what is done.

        Raises:
            ModelError, ImpactLawError, DynamicsError: as ``plant_run``.
        """
        samples = self.plant.stamps.size
        most = max(min(BATCH, _SAMPLES // samples), 1)
        persist = any(each.closed for each in plant_run(self.plant).switchings)
        cases = self.cases()
        while alike := (*islice(cases, self.runs),):
            size = most if _differ_in_start(alike[0]) else 1
            if persist and not alike[0].sensor.impacts_only:
                size = min(size, _FEW)
            for start in range(0, self.runs, size):
                batch = alike[start : start + size]
                if not all(case.number in done for case in batch):
                    yield batch

    def _cases(
        self, sensors: Sequence[SensorModel], variants: Sequence[ModelVariant], runs: int
    ) -> Iterator[Case]:
        own = replace(self.options, ensemble=1, epoch=self.plant.epoch)  # no estimate needs more
        by_law = options_of_laws(own, self.laws)
        combinations = product(by_law, sensors, variants, range(runs))
        for number, (observer, sensor, variant, run) in enumerate(combinations):
            seed, start = self.seed + run, self.options.initial_state
            start = f"{RANDOM}:{seed}" if start == RANDOM else start
            yield Case(
                number,
                run,
                seed,
                self.plant,
                sensor,
                variant,
                observer,
                start,
                self.settled,
                self.measurements,
            )

    @property
    def swept(self) -> dict[str, tuple[Label, ...]]:
        """The values of each label that has several, except law and run."""
        labels: dict[str, dict[Label, None]] = {}
        for sensor, variant in product(self.sensors, self.variants):
            case = Case(0, 0, 0, self.plant, sensor, variant, self.options, "")
            for name, value in case.labels.items():
                labels.setdefault(name, {})[value] = None
        return {name: (*values,) for name, values in labels.items() if len(values) > 1}

    def title(self, label: str) -> str:
        """The heading of a label of ``swept``, with its unit."""
        name = label.removeprefix(OFF).removeprefix(SENSOR)
        if label.startswith(OFF):
            units = {each.name: each.unit for each in self.variants[0].parameters}
            words = f"observer's {name}"
        else:
            units = {each.name: each.unit for each in SENSOR_FAULTS}
            words = name.replace("_", " ")
        return f"{words} [{units[name]}]" if units[name] else words

    def description(self) -> dict[str, object]:
        """Everything that the outcomes depend on, as values for JSON."""
        left_out = {"law", "ensemble", "epoch"}  # set by each case
        options = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(self.options).items()
            if name not in left_out
        }
        return {
            "format": FORMAT,
            "version": __version__,
            "model": self.plant.text,
            "duration": self.plant.duration,
            "rate": self.plant.rate,
            "epoch": self.plant.epoch,
            "laws": [*self.laws],
            "sensors": [each.faults for each in self.sensors],
            "off": [
                {each.name: each.value for each in variant.parameters} for variant in self.variants
            ],
            "replicas": [each.text for each in self.variants],
            "runs": self.runs,
            "seed": self.seed,
            "options": options,
            "settled": self.settled,
            **(
                {"measurements": [repr(each) for each in self.measurements]}
                if self.measurements
                else {}
            ),
        }


def _differ_in_start(case: Case) -> bool:
    """Whether the runs of a case differ only in their start, so that they can move together.

    Runs with hits that last cannot move together: each run has its own state from onset to jump.
    """
    law = law_named(case.observer.law)
    together = issubclass(law, ReplicaLaw) and law.phase is not ReplicaLaw.phase
    if not together or case.sensor.is_random or case.measurements:
        return False
    return not parsed(case.variant.text).system.contact_time.any()


def sensors_of(faults: Mapping[str, Sequence[float | bool]]) -> tuple[SensorModel, ...]:
    """A sensor for every combination of the values of ``faults``; an ideal one for none.

    Raises:
        UsageError: a value that a fault cannot have.
    """
    return tuple(
        SensorModel(**dict(zip(faults, values, strict=True)))  # type: ignore[arg-type]
        for values in product(*faults.values())
    )
