# SPDX-License-Identifier: Apache-2.0
"""Events that name the wrong contact count for the contact that the motion hits."""

import numpy as np
import pytest
from systems import EPOCH, run, sample

from impact_observer.events import ImpactEvent, Switch
from impact_observer.identify import fit_report
from impact_observer.identify.fit_check import check_fit
from impact_observer.identify.identification import Identification, identify
from impact_observer.model import Model, parse_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.plant import SensorModel, simulate_sensor

CLOCK = 1e-4
RESTITUTIONS = [0.6, 0.8]
"""Of the contacts right and left of three_mass."""
Labels = dict[int, str]


def sensed(mislabelled: float, seconds: float = 60.0) -> tuple[list[ImpactEvent], Labels]:
    """Events of three_mass, and the true contacts of the mislabelled ones by their stamps."""
    model = sample("three_mass")
    made = run(model.system, *model.initial_state(), seconds=seconds, rate=1.0)
    true, reported = (
        [
            each.event
            for each in simulate_sensor(
                SensorModel(jitter=CLOCK, mislabelled=share),
                model.system,
                made.switchings,
                epoch=EPOCH,
                last=int(made.stamps[-1]),
                seed=0,
            )
        ]
        for share in (0.0, mislabelled)
    )
    pairs = zip(true, reported, strict=True)
    wrong = {a.stamp: a.switches[0].contact for a, b in pairs if a.switches != b.switches}
    return reported, wrong


def counted_for(fitted: Identification) -> Labels:
    """The contacts for which mislabelled events count, by their stamps."""
    names = fitted.family.system.contact_names
    return {stamp: names[i] for stamp, i in fitted.recording.counted_for_others}


@pytest.mark.slow
@pytest.mark.parametrize("declared", [0.01, pytest.param(0.05, marks=pytest.mark.long)])
def test_mislabelled_impacts_are_named_and_none_is_lost(
    declared: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """Declared or not, each counts for its contact; none is rejected, none inserted."""
    events, wrong = sensed(0.05)
    assert wrong
    family = parametric_family(sample("three_mass").system, ("restitution",))
    fitted = identify(family, events, clock=CLOCK, mislabelled=declared)
    assert counted_for(fitted) == wrong
    assert not fitted.recording.outliers
    assert check_fit(fitted).fits
    assert np.all(np.abs(fitted.values - RESTITUTIONS) < 4 * fitted.errors)
    fit_report.print_parameters(fitted, check_fit(fitted))
    said = " ".join(capsys.readouterr().out.split())
    (stamp, contact), *_ = wrong.items()
    assert "reported for another contact" in said
    assert f"{contact} at {(stamp - EPOCH) * 1e-9:.3f} s (as " in said
    names = fit_report.for_json(fitted, check_fit(fitted))["mislabelled"]
    other = {"right": "left", "left": "right"}
    assert names == [[s, other[contact], contact] for s, contact in sorted(wrong.items())]


@pytest.mark.slow
def test_impacts_that_are_never_mislabelled_are_outliers() -> None:
    """With a probability of 0 an impact of the wrong contact is a false and a missed one."""
    events, wrong = sensed(0.05)
    family = parametric_family(sample("three_mass").system, ("restitution",))
    fitted = identify(family, events, clock=CLOCK, mislabelled=0.0)
    assert {stamp for stamp, _ in fitted.recording.rejected} == {*wrong}
    assert len(fitted.recording.inserted) == len(wrong)
    assert not fitted.recording.counted_for_others


@pytest.mark.parametrize("clock", [CLOCK, None])
def test_one_sensor_of_two_contacts_needs_a_declared_share(clock: float | None) -> None:
    """All impacts of both contacts are reported as those of one."""
    events, _ = sensed(0.0, 30.0)
    rights = {each.stamp for each in events if each.switches == (Switch("right"),)}
    renamed = [
        ImpactEvent(each.stamp, (Switch("left"),), each.sequence, 0, EPOCH) for each in events
    ]
    family = parametric_family(sample("three_mass").system, ("restitution", "gap"))
    fitted = identify(family, renamed, clock=clock, mislabelled=0.5)
    assert counted_for(fitted) == dict.fromkeys(rights, "right")
    assert not fitted.recording.outliers
    errors = fitted.values - [*RESTITUTIONS, 0.3, 0.25]
    assert np.all(np.abs(errors) < np.minimum(4 * fitted.errors, 0.02))


def gears(phase: float, restitution: float) -> Model:
    """A tooth between two flanks."""
    return parse_model(
        f"""
        name: gears
        unit: rad
        bodies: [{{name: tooth, mass: 0.01}}]
        springs: [{{between: [ground, tooth], stiffness: 0.2, damping: 0.01}}]
        forces: [{{body: tooth, amplitude: 0.4, frequency: 25, phase: {phase}}}]
        stops:
          - {{name: left, body: tooth, limit: -0.05, side: below, restitution: {restitution}}}
          - {{name: right, body: tooth, limit: 0.05, side: above, restitution: {restitution}}}
        """,
        "gears",
    )


@pytest.mark.slow
def test_one_sensor_of_two_flanks_tells_the_phase_of_the_drive_too() -> None:
    """Up to half a turn, since the mirrored motion hits the other flank at the same times."""
    rig = gears(2.0, 0.7).system
    made = run(rig, [0.0], [0.0], seconds=8.0, rate=1.0)
    sensor, last = SensorModel(jitter=CLOCK), int(made.stamps[-1])
    sent = simulate_sensor(sensor, rig, made.switchings, epoch=EPOCH, last=last, seed=1)
    events = [
        ImpactEvent(each.event.stamp, (Switch("left"),), each.event.sequence, 1, EPOCH)
        for each in sent
    ]
    family = parametric_family(gears(5.1, 0.5).system, ("forcing-phase", "restitution"))
    fitted = identify(family, events, clock=CLOCK, mislabelled=0.5)
    assert check_fit(fitted).fits
    turned = (fitted.values[0] + 5.1 - 2.0 + np.pi / 2) % np.pi - np.pi / 2
    assert abs(turned) < 4 * fitted.errors[0] < 0.01
    assert np.all(np.abs(fitted.values[1:] - 0.7) < 4 * fitted.errors[1:])
