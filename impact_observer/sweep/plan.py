"""What is swept, and the cases of which a sweep consists.

All are plain values: equal ones are equal, they can be sent to another process or machine, and a
case has all that its run depends on. A run takes its random numbers from its own seed, so that
neither order nor place of the runs matters. Cases of the same run share the seed: laws, troubles
and models are compared on equal starts and equal draws of the sensor.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from itertools import product

from impact_observer import __version__
from impact_observer.compare.comparison import SETTLED
from impact_observer.errors import UsageError
from impact_observer.model import parse_model
from impact_observer.observer import Options, make_observer, options_of_laws
from impact_observer.plant import SensorModel, SensorSimulation
from impact_observer.sensor_faults import SENSOR_FAULTS
from impact_observer.stamps import from_seconds, grid
from impact_observer.sweep.model_variants import Replica

MOST_CASES = 10_000_000
"""The largest sweep: a table of its outcomes is held in memory."""
FORMAT = 1
"""Of the description; another one does not mean the same."""
RANDOM = "random"
"""The start of an observer that is ``random:SEED`` with the seed of its run."""
Label = str | int | float | bool
SENSOR = "sensor_"
OFF = "off_"


@dataclass(frozen=True, slots=True)
class Rig:
    """A plant's run, from the state that its model says.

    Attributes:
        text: a model file in matrix form, with an initial state.
        duration: s.
        rate: of the samples at which estimates are compared, Hz; where it is too low, a sample
            between the jumps of truth and estimate is not told from an error (``mismatch``).
        epoch: stamp of ``t = 0``, ns.
    """

    text: str
    duration: float = 30.0
    rate: float = 100.0
    epoch: int = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Case:
    """One run of plant, sensor and observer, with all that it depends on.

    Attributes:
        number: its place in the sweep.
        run: counts the seeds.
        seed: of everything random in it.
        rig: what moves.
        sensor: what is wrong with the sensor.
        replica: what the observer takes the plant for.
        options: of the observer.
        threshold: V over V at the start below which an estimate has settled.
    """

    number: int
    run: int
    seed: int
    rig: Rig
    sensor: SensorModel
    replica: Replica
    options: Options
    threshold: float = SETTLED

    @property
    def labels(self) -> dict[str, Label]:
        """What tells it from other cases of its sweep; all of them have the same names."""
        values = {field.name: getattr(self.sensor, field.name) for field in fields(SensorModel)}
        return {
            "case": self.number,
            "law": self.options.law,
            "run": self.run,
            "seed": self.seed,
            "initial": self.options.initial_state,
            **{SENSOR + k: v if isinstance(v, bool) else float(v) for k, v in values.items()},
            **{OFF + each.name: each.value for each in self.replica.off},
        }


@dataclass(frozen=True, slots=True)
class Sweep:
    """Every law with every sensor and every replica, each so many times.

    Attributes:
        rig: what moves, the same in all cases.
        laws: names of the observers' laws.
        sensors: what is wrong with the sensor.
        replicas: what the observer takes the plant for.
        runs: how many seeds.
        seed: of the first run; the others count on from it.
        options: of the observers but for the law; ``initial`` may be ``RANDOM``.
        threshold: V over V at the start below which an estimate has settled.
    """

    rig: Rig
    laws: tuple[str, ...]
    sensors: tuple[SensorModel, ...]
    replicas: tuple[Replica, ...]
    runs: int = 20
    seed: int = 0
    options: Options = Options(initial_state=RANDOM)  # noqa: RUF009 (it is immutable)
    threshold: float = SETTLED

    def __post_init__(self) -> None:
        """Check everything that all cases have in common.

        Raises:
            UsageError, ModelError: a law, a sensor, an option, a model that cannot be used.
        """
        if not 0 < self.size <= MOST_CASES:
            raise UsageError(f"sweep: {self.size} cases found; expected 1 to {MOST_CASES}")
        rig = self.rig
        if grid(rig.epoch, rig.epoch + from_seconds(rig.duration), rig.rate).size < 2:
            raise UsageError(
                f"sweep: one sample found in {rig.duration:g} s at {rig.rate:g} Hz; expected two"
            )
        system = parse_model(rig.text, "plant").system
        for sensor in self.sensors:
            SensorSimulation(sensor, system, epoch=rig.epoch)
        believed = parse_model(self.replicas[0].text, "replica").system
        for case in self._each(self.sensors[:1], self.replicas[:1], 1):
            make_observer(believed, case.options)

    @property
    def size(self) -> int:
        """How many cases there are."""
        return len(self.laws) * len(self.sensors) * len(self.replicas) * self.runs

    def cases(self) -> Iterator[Case]:
        """All cases, in order of their numbers."""
        return self._each(self.sensors, self.replicas, self.runs)

    def _each(
        self, sensors: Sequence[SensorModel], replicas: Sequence[Replica], runs: int
    ) -> Iterator[Case]:
        told = options_of_laws(self.options, self.laws)
        combinations = product(told, sensors, replicas, range(runs))
        for number, (own, sensor, replica, run) in enumerate(combinations):
            seed = self.seed + run
            initial = self.options.initial_state
            options = replace(
                own,
                initial_state=f"random:{seed}" if initial == RANDOM else initial,
                ensemble=1,  # no estimate depends on it
                epoch=self.rig.epoch,
            )
            yield Case(number, run, seed, self.rig, sensor, replica, options, self.threshold)

    @property
    def swept(self) -> dict[str, tuple[Label, ...]]:
        """The values of each label that has several, but for law and run."""
        labels: dict[str, dict[Label, None]] = {}
        for sensor, replica in product(self.sensors, self.replicas):
            for name, value in Case(
                0, 0, 0, self.rig, sensor, replica, self.options
            ).labels.items():
                labels.setdefault(name, {})[value] = None
        return {name: (*values,) for name, values in labels.items() if len(values) > 1}

    def title(self, label: str) -> str:
        """What a label of ``swept`` is called in a table or at an axis, with its unit."""
        name = label.removeprefix(OFF).removeprefix(SENSOR)
        if label.startswith(OFF):
            units = {each.name: each.unit for each in self.replicas[0].off}
            words = f"observer's {name}"
        else:
            units = {each.name: each.unit for each in SENSOR_FAULTS}
            words = name.replace("_", " ")
        return f"{words} [{units[name]}]" if units[name] else words

    def description(self) -> dict[str, object]:
        """All that the outcomes depend on, as JSON can hold it."""
        left_out = {"law", "ensemble", "epoch"}  # the case gives them
        if not self.options.compiled:  # machine code may differ in the last bit
            left_out.add("compiled")
        options = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in asdict(self.options).items()
            if name not in left_out
        }
        return {
            "format": FORMAT,
            "version": __version__,
            "model": self.rig.text,
            "duration": self.rig.duration,
            "rate": self.rig.rate,
            "epoch": self.rig.epoch,
            "laws": [*self.laws],
            "sensors": [each.faults for each in self.sensors],
            "off": [{off.name: off.value for off in each.off} for each in self.replicas],
            "replicas": [each.text for each in self.replicas],
            "runs": self.runs,
            "seed": self.seed,
            "options": options,
            "threshold": self.threshold,
        }


def sensors_of(troubles: Mapping[str, Sequence[float | bool]]) -> tuple[SensorModel, ...]:
    """A sensor for every combination of the values of ``troubles``; an ideal one for none.

    Raises:
        UsageError: a value that a trouble cannot have.
    """
    return tuple(
        SensorModel(**dict(zip(troubles, values, strict=True)))  # type: ignore[arg-type]
        for values in product(*troubles.values())
    )
