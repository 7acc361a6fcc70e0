# SPDX-License-Identifier: Apache-2.0
"""The covariance that ``identify`` writes into a model file, and what it keeps of another one."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from systems import EPOCH, run

from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent
from impact_observer.identify.fit_report import model_text
from impact_observer.identify.identification import Identification, identify
from impact_observer.identify.written_uncertainty import (
    refuse_scales_of_parts,
    written_uncertainty,
)
from impact_observer.model import Model, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.model.model_file import ModelText
from impact_observer.plant import SensorModel, simulate_sensor

RIG = """\
# a rig
name: rig
bodies: [{name: x1, mass: {value: 1, deviation: 0.002}}, {name: x2, mass: 1}]    # weighed
springs:
  - {between: [ground, x1], stiffness: 10.2, damping: 0.1}
  - {between: [x1, x2], stiffness: 10.2, damping: 0.1}
forces:
  - {body: x2, amplitude: {value: 4.4, deviation: 0.5}, frequency: {value: 2.5, deviation: 1e-6}}
stops:
  - {name: stop, body: x2, limit: {value: 0.51, deviation: 0.01}, side: above,
     restitution: {value: 0.75, deviation: 0.1}}
uncertainty:
  names: [forcing-phase.1, damping-scale]
  covariance: [[0.0004, 1.0e-5], [1.0e-5, 0.0009]]
  fitted_to: {first: 1, last: 2}
"""
TRUE = """\
name: rig
bodies: [{name: x1, mass: 1}, {name: x2, mass: 1}]
springs:
  - {between: [ground, x1], stiffness: 10, damping: 0.1}
  - {between: [x1, x2], stiffness: 10, damping: 0.1}
forces: [{body: x2, amplitude: 4, frequency: 2.5}, {body: x2, constant: 0.3}]
stops: [{name: stop, body: x2, limit: 0.5, side: above, restitution: 0.7}]
initial_state: {position: [0.1, -0.2], velocity: [0.5, 0]}
"""
FREE = ("restitution", "forcing-amplitude", "damping-scale")


@cache
def recorded(jitter: float, text: str = TRUE) -> tuple[ImpactEvent, ...]:
    """The events of a minute of the true rig."""
    model = parse_model(text, "true")
    made = run(model.system, *model.initial_state(), seconds=60.0, rate=1.0)
    messages = simulate_sensor(
        SensorModel(jitter=jitter),
        model.system,
        made.switchings,
        epoch=EPOCH,
        last=int(made.stamps[-1]),
        seed=1,
    )
    return tuple(sorted((each.event for each in messages), key=lambda each: each.stamp))


def fitted(model: Model, free: tuple[str, ...] = FREE, jitter: float = 1e-4) -> Identification:
    """A fit to the impacts of the rig without the constant force."""
    text = TRUE.replace(", {body: x2, constant: 0.3}", "")
    family = parametric_family(model.system, free, model.elements)
    return identify(family, [*recorded(jitter, text)], clock=jitter)


def written(found: Identification, text: str) -> str:
    """The text of the file that ``identify`` writes."""
    return model_text(found, ModelText(text, "rig.yaml"), Path("bag"), Path("out.yaml"))


@pytest.mark.slow
def test_the_written_covariance_is_that_of_a_fit_of_the_written_file() -> None:
    """Ratios are relative to the file that is written; the stamps are those of the recording."""
    given = RIG.replace("10.2", "10")
    text = written(fitted(parse_model(given, "rig")), given)
    model = parse_model(text, "written")
    known = model.uncertainty
    assert known is not None
    again = fitted(model)
    names = again.family.names
    own = [known.names.index(name) for name in names]
    first = again.start.size
    wanted = again.covariance[first:, first:]
    scale = np.outer(again.errors, again.errors)
    np.testing.assert_allclose(
        known.covariance[np.ix_(own, own)] / scale, wanted / scale, atol=0.01
    )
    assert abs(again.values[names.index("forcing-amplitude.1")] - 1) < 1e-6
    stamps = [
        each.stamp for each in recorded(1e-4, TRUE.replace(", {body: x2, constant: 0.3}", ""))
    ]
    assert known.fitted_to == (min(stamps), max(stamps))


def test_deviations_of_what_is_not_fitted_stay_where_they_are() -> None:
    """Those of what is fitted are replaced, beside numbers as in the covariance."""
    given = RIG.replace("10.2", "10")
    text = written(fitted(parse_model(given, "rig")), given)
    assert "mass: {value: 1, deviation: 0.002}" in text
    assert "frequency: {value: 2.5, deviation: 1e-6}" in text
    assert "limit: {value: 0.51, deviation: 0.01}" in text
    assert text.count("deviation:") == 3
    assert text.count("#") == given.count("#")
    known = parse_model(text, "written").uncertainty
    assert known is not None
    found = dict(zip(known.names, known.deviations.tolist(), strict=True))
    assert len(found) == 7
    assert found["forcing-phase.1"] == pytest.approx(0.02)
    assert found["mass.x1"] == pytest.approx(0.002)
    assert found["restitution.stop"] < 0.001
    phase, damping = (known.names.index(name) for name in ("forcing-phase.1", "damping-scale"))
    assert known.covariance[phase, damping] == 0.0


def test_the_offset_of_a_clock_is_left_out() -> None:
    """It belongs to the sensor; a fit of nothing else keeps what was known."""
    model = parse_model(RIG, "rig")
    found = fitted(
        parse_model(TRUE.replace("constant: 0.3", "constant: 0"), "rig"), ("clock-offset",)
    )
    assert written_uncertainty(found, None) is None
    known = written_uncertainty(found, model.uncertainty)
    assert known is not None
    assert known.names == model.uncertainty.names  # type: ignore[union-attr]
    assert known.fitted_to is None


def test_a_scale_beside_a_deviation_of_its_part_is_refused() -> None:
    """And the part beside that of its scale; both are parameters of the same numbers."""
    known = parse_model(RIG, "rig").uncertainty
    for free, kept in (("mass-scale", "mass.x1"), ("damping.x1-x2", "damping-scale")):
        with pytest.raises(UsageError, match=f"--free {free}: .* deviation of {kept}"):
            refuse_scales_of_parts([free], known)
    refuse_scales_of_parts(["mass.x1", "mass.x2", "stiffness-scale"], known)


@pytest.mark.parametrize("right", [True, False])
def test_a_constant_force_and_a_frequency_are_found(right: bool) -> None:
    """From exact stamps, also where the model has no constant force; the file then has one."""
    given = TRUE.replace("frequency: 2.5", "frequency: 2.501")
    given = given.replace("constant: 0.3", "constant: 0.2")
    if not right:
        given = given.replace(", {body: x2, constant: 0.2}", "")
    model = parse_model(given, "guess")
    family = parametric_family(model.system, ("constant-force.x2", "forcing-frequency"))
    found = identify(family, [*recorded(0.0)], clock=1e-9)
    np.testing.assert_allclose(found.values, [0.3, 2.5], rtol=1e-6)
    system = parse_model(written(found, given), "written").system
    np.testing.assert_allclose(system.forcing.constant, [0.0, 0.3], rtol=1e-6)
    np.testing.assert_allclose(system.forcing.frequency, [2.5], rtol=1e-6)
