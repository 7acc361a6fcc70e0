# SPDX-License-Identifier: Apache-2.0
"""``fit`` and ``Observer.run`` of seconds by contact, in Python and in the notebook."""

import json

import numpy as np
import pytest
from systems import EPOCH, run, sample

from impact_observer import Options, fit, make_observer
from impact_observer.errors import UsageError
from impact_observer.model import parse_model
from impact_observer.resources import shared
from impact_observer.stamps import seconds_between


def seconds_of(name: str, seconds: float) -> dict[str, list[float]]:
    """Seconds of the impacts of a sample by contact."""
    model = sample(name)
    times = dict[str, list[float]]()
    for each in run(model.system, *model.initial_state(), seconds=seconds).events:
        times.setdefault(each.switches[0].contact, []).append(seconds_between(EPOCH, each.stamp))
    return times


def test_fit_finds_parameters_impacts_and_states() -> None:
    """Of two stops; states against the plant, with deviations; the picture has all states."""
    model, times = sample("three_mass"), seconds_of("three_mass", 30.0)
    found = fit(times, model, free=("restitution",))
    assert found.fits
    for name, true in {"restitution.right": 0.6, "restitution.left": 0.8}.items():
        value, error = found.parameters[name]
        assert abs(value - true) < max(4 * error, 1e-6)
    assert found.impacts.contact.count("left") == len(times["left"])
    np.testing.assert_allclose(found.impacts.seconds, np.sort(np.concatenate([*times.values()])))
    assert np.all(found.impacts.speed_before > 0)
    truth = run(model.system, *model.initial_state(), seconds=30.0, rate=2.0)
    at = np.array([seconds_between(EPOCH, each) for each in truth.stamps.tolist()])
    motion = found.states(at[1:])
    np.testing.assert_allclose(motion.states, truth.states[1:], atol=1e-5)
    assert np.all(motion.deviations > 0)
    assert len(found.plot().axes) == 6


def test_a_model_fits_only_where_stamps_are_left_to_judge_by() -> None:
    """Start and restitution of a ball are three numbers, which three stamps cannot contradict."""
    ball = parse_model(
        "{name: ball, bodies: [{name: h, mass: 1}], forces: [{body: h, constant: -9.81}],"
        " stops: [{name: floor, body: h, limit: 0, side: below,"
        " restitution: {value: 0.8, deviation: 0.05}}]}",
        "ball",
    )
    flight = 2 * np.sqrt(2 * 0.4 / 9.81) * 0.84 ** np.arange(9)
    times = 0.286 + np.cumsum(np.append(0.0, flight))
    assert [fit(times[:count], ball).fits for count in (2, 3, 6, 10)] == [False, False, True, True]


def test_an_observer_runs_through_seconds_by_contact() -> None:
    """The last state is that of the plant, within its deviations; before, only the past counts."""
    model, times = sample("two_mass"), seconds_of("two_mass", 30.0)
    observer = make_observer(model.system, Options(law="minimum-variance"))
    seen = observer.run(times, np.arange(0.0, 30.0, 0.5))
    truth = run(model.system, *model.initial_state(), seconds=30.0, rate=2.0)
    np.testing.assert_allclose(seen.states[-1], truth.states[-2], atol=1e-6)
    assert np.all(seen.deviations[-1] < 1e-3 * seen.deviations[0])


def test_times_alone_are_those_of_the_only_contact() -> None:
    """By any law: from its start the default one moves as the plant; it knows no deviations."""
    model, times = sample("two_mass"), seconds_of("two_mass", 30.0)
    start = ",".join(map(str, np.concatenate(model.initial_state()).tolist()))
    observer = make_observer(model.system, Options(initial_state=start))
    seen = observer.run(times["stop"], np.arange(0.0, 30.0, 0.5))
    truth = run(model.system, *model.initial_state(), seconds=30.0, rate=2.0)
    np.testing.assert_allclose(seen.states, truth.states[2:-1], atol=1e-6)  # after an impact
    assert np.all(np.isnan(seen.deviations))
    found, named = (fit(each, model, free=("gap",)) for each in (times["stop"], times))
    assert found.parameters == named.parameters


@pytest.mark.parametrize(
    ("times", "fault"),
    [
        ({"bell": [1.0]}, "bell"),
        ([1.0], "no contact"),
        ({"left": [1.0, np.nan]}, "left"),
        ({"left": [np.inf]}, "left"),
        ({"left": 1e12}, "left"),
        ({"left": ["noon"]}, "left"),
        ({"left": None}, "left"),
    ],
)
def test_times_that_are_none_of_the_model_are_refused(times: object, fault: str) -> None:
    """In one line, by ``fit`` and by an observer."""
    with pytest.raises(UsageError, match=fault):
        fit(times, sample("three_mass"), free=())  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=fault):
        make_observer("three_mass").run(times, [1.0])  # type: ignore[arg-type]


@pytest.mark.parametrize("seconds", [np.nan, -np.inf, 1e12, "noon"])
def test_instants_that_no_stamp_has_are_refused(seconds: float | str) -> None:
    """In one line."""
    with pytest.raises(UsageError, match="seconds"):
        make_observer("two_mass").run([1.0], [seconds])


def test_the_notebook_runs() -> None:
    """All of its cells, one after the other."""
    notebook = json.loads(shared("examples/impact_times.ipynb").read_text("utf-8"))
    names: dict[str, object] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert "found" in names
