"""One case of a sweep: the plant's run, what its sensor tells, an observer on that, figures."""

from dataclasses import dataclass
from functools import lru_cache

from impact_observer.compare.comparison import Comparison, compare_observer
from impact_observer.errors import ImpactObserverError
from impact_observer.events import Ruling
from impact_observer.io.pairing import Series
from impact_observer.model import Model, parse_model
from impact_observer.observer import make_observer
from impact_observer.plant import Plant, Run, simulate, simulate_sensor
from impact_observer.stamps import from_seconds, grid
from impact_observer.sweep.plan import Case, Rig


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came out of a case; its figures are None where they have no meaning.

    Attributes:
        case: number of the case.
        settling_time: from which on V was below the threshold, s since the epoch; None for never.
        V_start: V at the start, J.
        V_end: V at the end, J.
        V_ratio: V at the end over V at the start; None where they start equal.
        V_largest_rise: from one sample to the next, over V at the start.
        rate_per_second: by which ln V fell in a second; None where it did not.
        rate_per_impact: by which it fell an impact used; None likewise.
        events: told by the sensor.
        impacts_used: of those and of inserted ones.
        switches_rejected: of the told ones.
        impacts_inserted: that nobody told.
        error: why there are no figures; empty where there are.
    """

    case: int
    settling_time: float | None = None
    V_start: float | None = None
    V_end: float | None = None
    V_ratio: float | None = None
    V_largest_rise: float | None = None
    rate_per_second: float | None = None
    rate_per_impact: float | None = None
    events: int | None = None
    impacts_used: int | None = None
    switches_rejected: int | None = None
    impacts_inserted: int | None = None
    error: str = ""


def run_case(case: Case) -> Outcome:
    """What comes out of a case: a function of nothing else.

    One that fails, for whatever reason, has an outcome that says so: others go on.
    """
    try:
        return _outcome(case)
    except ImpactObserverError as error:
        return Outcome(case.number, error=str(error))
    except Exception as error:  # noqa: BLE001 (a mistake in a law must not lose all other cases)
        line = " ".join(f"{type(error).__name__}: {error}".split())
        return Outcome(case.number, error=line)


def plant_run(rig: Rig) -> Run:
    """What the plant does; all cases of a sweep share it.

    Raises:
        ModelError: its model is none, or has no initial state.
        ImpactLawError, DynamicsError: its motion has no solution.
    """
    return _simulated(rig)


@lru_cache(maxsize=4)
def _simulated(rig: Rig) -> Run:
    model = _parsed(rig.text)
    plant = Plant(model.system, *model.initial_state(), epoch=rig.epoch)
    return simulate(plant, grid(rig.epoch, rig.epoch + from_seconds(rig.duration), rig.rate))


@lru_cache(maxsize=64)
def _parsed(text: str) -> Model:
    return parse_model(text, "model")


def compared(case: Case) -> tuple[Comparison, int]:
    """The estimates of a case against the truth, as ``compare`` has it, and how many events came.

    V is by the energy of the plant, whatever the observer takes that for.

    Raises:
        ImpactObserverError: plant or observer cannot go on.
    """
    run, system = plant_run(case.rig), _parsed(case.rig.text).system
    sensed = simulate_sensor(
        case.sensor,
        system,
        run.switchings,
        epoch=run.epoch,
        last=int(run.stamps[-1]),
        seed=case.seed,
    )
    events = sorted((each.event for each in sensed), key=lambda each: (each.stamp, each.sequence))
    observer = make_observer(_parsed(case.replica.text).system, case.options)
    comparison = compare_observer(
        observer,
        events,
        lambda: [Series(run.stamps, run.states)],
        system=system,
        threshold=case.threshold,
        needs_event=False,
    )
    return comparison, len(events)


def _outcome(case: Case) -> Outcome:
    comparison, events = compared(case)
    rulings = comparison.outcomes.rulings
    return Outcome(
        case=case.number,
        settling_time=comparison.settling_time,
        V_start=float(comparison.V[0]),
        V_end=float(comparison.V[-1]),
        V_ratio=comparison.ratio,
        V_largest_rise=comparison.largest_rise,
        rate_per_second=comparison.rate_per_second,
        rate_per_impact=comparison.rate_per_impact,
        events=events,
        impacts_used=comparison.impacts,
        switches_rejected=None if rulings is None else rulings[Ruling.REJECTED],
        impacts_inserted=None if rulings is None else rulings[Ruling.INSERTED],
    )
