# SPDX-License-Identifier: Apache-2.0
"""A debounced switch reports first edges of rows of bounces: the fit has the other bounces."""

import numpy as np
import pytest
from systems import press

from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.identify import fit_report
from impact_observer.identify.fit_check import check_fit
from impact_observer.identify.identification import identify
from impact_observer.model import Model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import from_seconds, grid

EPOCH = 1_700_000_000 * 10**9
CLOCK = 1e-5
ROW = 0.16
"""Longest time between two hits of a row, s."""


def hits_of(model: Model, start: float, seconds: float) -> list[tuple[int, Kind]]:
    """Stamps, ns, and kinds of all switches from rest at a position of both bodies, m."""
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), 50.0)
    run = simulate(Plant(model.system, np.full(2, start), np.zeros(2), epoch=EPOCH), stamps)
    return [(s.instant.stamp, each.kind) for s in run.switchings for each in s.switches]


def first_edges(hits: list[tuple[int, Kind]]) -> list[tuple[int, Kind]]:
    """The first edge of each row, as CLOSE if the row ends at rest, and each OPEN."""
    found, last = list[tuple[int, Kind]](), 0
    for stamp, kind in hits:
        if kind is Kind.OPEN or stamp - last > from_seconds(ROW):
            found.append((stamp, kind))
        elif kind is Kind.CLOSE:
            found[-1] = found[-1][0], Kind.CLOSE
        last = stamp
    return found


def events(hits: list[tuple[int, Kind]], contact: str = "die") -> list[ImpactEvent]:
    """Numbered events with stamps that jitter by ``CLOCK``."""
    late = CLOCK * np.random.default_rng(3).standard_normal(len(hits))
    return [
        ImpactEvent(stamp + from_seconds(dt), (Switch(contact, kind),), k, 1, EPOCH)
        for k, ((stamp, kind), dt) in enumerate(zip(hits, late.tolist(), strict=True), start=1)
    ]


@pytest.mark.slow
@pytest.mark.parametrize("phase", [0.3, pytest.param(4.0, marks=pytest.mark.long)])
def test_rows_of_bounces_tell_the_phase_of_the_drive_too(phase: float) -> None:
    """The model's drive is ahead of the press's by up to most of a turn."""
    reported = first_edges(hits_of(press(), -0.2, 10.0))
    free, guess = ("forcing-phase", "restitution"), press(restitution=0.35).system
    begin = parametric_family(guess, free[:1]).system_at(np.array([phase]))
    fitted = identify(parametric_family(begin, free), events(reported), clock=CLOCK)
    assert check_fit(fitted).fits
    error = (fitted.values[0] + phase + np.pi) % (2 * np.pi) - np.pi
    assert abs(error) < 4 * fitted.errors[0] < 0.001
    assert abs(fitted.values[1] - 0.3) < 4 * fitted.errors[1] < 0.01


@pytest.mark.parametrize("opens", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_rows_of_bounces_inside_a_closed_contact_tell_its_restitution(
    opens: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Closings at the first edge are fitted as rows, whether or not openings are reported."""
    reported = [
        each for each in first_edges(hits_of(press(), -0.2, 10.0)) if opens or each[1] != Kind.OPEN
    ]
    guess = press(restitution=0.35)
    family = parametric_family(guess.system, ("restitution",), guess.elements)
    fitted = identify(family, events(reported), clock=CLOCK)
    assert check_fit(fitted).fits
    assert fitted.values[0] == pytest.approx(0.3, abs=4 * fitted.errors[0])
    assert fitted.errors[0] < 0.01
    assert fitted.lost.all()  # a rest takes away a body's speed
    fit_report.print_parameters(fitted, check_fit(fitted))
    said = " ".join(capsys.readouterr().out.split())
    assert "of rows of bounces, of which" in said
    assert ("OPENs not reported" in said) is not opens
    assert "ram at the start not determined m" in said
    assert not fitted.recording.outliers


@pytest.mark.parametrize("dead_time", [pytest.param(0.25, marks=pytest.mark.long), 0.0])
def test_impacts_alone_may_be_first_edges_of_rows(
    dead_time: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """A switch that reports no closings gives the restitution; the length of rows is named."""
    hits = hits_of(press(), -0.2, 14.0)
    reported = [(stamp, Kind.IMPACT) for stamp, kind in first_edges(hits) if kind is not Kind.OPEN]
    last = {stamp: stamp for stamp, _ in reported}
    for stamp, kind in hits:
        if kind is not Kind.OPEN:
            last[max(first for first in last if first <= stamp)] = stamp
    longest = max(end - first for first, end in last.items()) * 1e-9
    guess = press(restitution=0.35)
    family = parametric_family(guess.system, ("restitution",), guess.elements)
    fitted = identify(family, events(reported), clock=CLOCK, dead_time=dead_time)
    assert check_fit(fitted).fits
    assert fitted.values[0] == pytest.approx(0.3, abs=4 * fitted.errors[0])
    assert not fitted.recording.outliers
    fit_report.print_parameters(fitted, check_fit(fitted))
    said = " ".join(capsys.readouterr().out.split())
    assert "IMPACTs report the first" in said
    assert f"debounced: bounces up to {longest:.2g} s after an event are not reported" in said


@pytest.mark.parametrize(("seconds", "dead_time"), [(12.0, 0.02), (10.3, 0.0), (10.3, 0.25)])
def test_a_check_takes_a_dead_time_beside_closings(seconds: float, dead_time: float) -> None:
    """The right model fits first edges with and without the dead time, five closings too."""
    family = parametric_family(press().system, (), press().elements)
    reported = first_edges(hits_of(press(), -0.2, seconds))
    fitted = identify(family, events(reported), clock=CLOCK, dead_time=dead_time)
    assert check_fit(fitted).fits
    assert fitted.recording.bouncing
    assert not fitted.recording.outliers
