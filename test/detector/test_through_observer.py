# SPDX-License-Identifier: Apache-2.0
"""Estimates from the detected events of a switch equal those from an ideal sensor."""

from dataclasses import replace

import numpy as np
import pytest
from signals import MS, START, Scalar, switch
from systems import Harmonic, forcing, system

from impact_observer.detector import Detector
from impact_observer.events import ImpactEvent, Kind
from impact_observer.observer import Options, make_observer
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import grid


def signal_of(events: tuple[ImpactEvent, ...]) -> list[tuple[int, float]]:
    """A switch that closes for 5 ms at each impact, and during persistent contact."""
    signal = []
    for event in events:
        kind = event.switches[0].kind
        signal.append((event.stamp, float(kind is not Kind.OPEN)))
        if kind is Kind.IMPACT:
            signal.append((event.stamp + 5 * MS, 0.0))
    return signal


@pytest.mark.slow
@pytest.mark.parametrize(
    ("eps", "law"),
    [(0.0, "kinematic"), (0.0, "geometric"), (0.0, "minimum-variance"), (0.6, "geometric")],
)
def test_estimates_from_a_switch_are_those_from_an_ideal_sensor(eps: float, law: str) -> None:
    """Events are impacts, CLOSE and OPEN; superseded impacts have no effect."""
    force = forcing(2, np.array([0.0, 1.0]), [Harmonic(2.0, [0.0, 6.0], [0.0, 0.0])])
    model = system(
        np.eye(2),
        0.1 * np.eye(2),
        np.array([[20.0, -10.0], [-10.0, 10.0]]),
        contacts=[([0, -1], 0.3, eps)],
        force=force,
    )
    plant = Plant(model, np.zeros(2), np.zeros(2), epoch=START)
    run = simulate(plant, grid(START, START + 7000 * MS, 10.0))
    detector = Detector([replace(switch(), contact=model.contact_names[0])], epoch=START)
    detected = [d.event for s, v in signal_of(run.events) for d in detector.feed(0, Scalar(v), s)]
    detected += [d.event for d in detector.advance(START + 8000 * MS)]
    kinds = {event.switches[0].kind for event in detected}
    assert kinds == ({Kind.IMPACT} if eps else set(Kind))
    options = Options(law=law, initial_state="random:1", ensemble=1, epoch=START)
    ideal, real = make_observer(model, options), make_observer(model, options)
    for event in run.events:
        ideal.receive(event)
    for event in detected:
        real.receive(event)
    for stamp in run.stamps.tolist():
        wanted, found = ideal.estimate(stamp), real.estimate(stamp)
        assert found.q.tobytes() == wanted.q.tobytes()
        assert found.u.tobytes() == wanted.u.tobytes()
        assert found.closed == wanted.closed
