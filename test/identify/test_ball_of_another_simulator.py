# SPDX-License-Identifier: Apache-2.0
"""A ball above a table that moves, by another simulator and the detection of its clicks."""

import numpy as np
import pytest
from systems import EPOCH

from impact_observer.events import ImpactEvent, Switch
from impact_observer.identify.identification import identify
from impact_observer.model import parse_model
from impact_observer.model.free_parameters import parametric_family

MICROSECONDS = """
139642 300875 319776 334970 418419 523778 536465 547559 628069 762583 971850 1211930 1330949
1532101 1683320 1873789 1895536 1986104 2117595 2325533 2548373 2810372 2912536 3060713 3202332
3351622 3456524 3474454 3571195 3607765 3705903 3783902 3824419 3958480 4041059 4188839 4400558
4642472 4749404 4879673 4893072 4904540 4985660 5118067 5326657 5555220 5791309 5838889 5977801
6187420 6433841 6484679 6612028 6790054 6827870 6972686 7180089 7386445 7497304 7544871 7699837
7883726 7968139 8110910 8284096 8344711 8461565 8561215 8672599 8698300 8772132 8900175 9098976
9192256 9361111 9398914 9542940 9746139 9896104 10068703 10138229 10188049 10344370 10511137
10534300 10621292 10780067 10889348 10980846 11137794 11241160 11256980 11345595 11463303
11596589 11612748 11700184 11832099
"""
"""Stamps; of 99 impacts the one at 10.557 s, of 0.06 m/s, is a missed detection."""
RESTITUTION, AMPLITUDE = 0.63, 1.03
"""Of that simulator; the amplitude over that of the model."""
MODEL = """
name: ball
bodies: [{name: ball, mass: 0.11}]
grounds:
  - {name: table, motion: {harmonics: [{amplitude: 0.004, frequency: 87.9645943}]}}
forces: [{body: ball, constant: -1.0791}]
stops: [{name: plate, between: [table, ball], gap: 0, restitution: 0.6}]
"""


@pytest.mark.long
def test_a_missed_hit_leaves_no_true_hit_rejected() -> None:
    """The fit from wrong values has four true hits twice: rejected, and inserted beside."""
    stamps = [EPOCH + 1000 * int(each) for each in MICROSECONDS.split()]
    switches = (Switch("plate"),)
    events = [ImpactEvent(t, switches, k, 0, EPOCH) for k, t in enumerate(stamps, start=1)]
    model = parse_model(MODEL, "ball")
    free = ["restitution", "ground-amplitude", "ground-phase"]
    family = parametric_family(model.system, free, model.elements)
    found = identify(family, events, clock=2e-5, dead_time=0.008)
    assert found.converged
    assert not found.recording.rejected
    ((missed, _),) = found.recording.inserted
    assert abs(missed - EPOCH - 10_557_000_000) < 1_000_000
    np.testing.assert_allclose(found.values[:2], [RESTITUTION, AMPLITUDE], rtol=2e-4)
    assert found.rms < 1e-5
