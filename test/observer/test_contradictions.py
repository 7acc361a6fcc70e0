# SPDX-License-Identifier: Apache-2.0
"""Faults of a sensor that is declared without faults end certainty, and are warned of."""

from dataclasses import replace

import numpy as np
import pytest
from systems import run, sample

from benchmarks.silence import FAR, FAULTY, Judged
from impact_observer.observer import make_observer
from impact_observer.options import Options


@pytest.mark.parametrize("bag", FAULTY)
def test_faults_that_are_excluded_end_certainty(bag: str) -> None:
    """From the first contradiction on four errors of five are within three deviations."""
    judged = Judged(bag)
    first = next(k for k, each in enumerate(judged.misfit) if each)
    assert np.mean(judged.errors[first:] > 3) <= 0.2
    assert not np.any(judged.synchronized[judged.distances > FAR])
    assert "declare larger ones" in judged.misfit[-1] or "not reported" in judged.misfit[-1]


def test_a_sensor_without_faults_is_trusted() -> None:
    """Its deviations are those of rounded stamps, and nothing is warned of."""
    judged = Judged("two_mass")
    assert not any(judged.misfit)
    assert np.all(judged.errors < 3)
    assert np.mean(judged.synchronized) > 0.5


def test_a_missed_impact_is_remembered_after_the_next_event() -> None:
    """The clock and the model are not declared; the warning lasts for 32 events or so."""
    model = sample("two_mass")
    whole = run(model.system, *model.initial_state(), seconds=120.0, rate=1.0)
    trusting = Options(law="minimum-variance", missed=0.0, spurious=0.0, mislabelled=0.0)
    observer, warned = make_observer(model, trusting), []
    for k, each in enumerate(whole.events):
        if k != 30:
            observer.receive(each)
            warned.append(bool(observer.estimate(each.stamp).misfit))
    assert not any(warned[:30])
    assert all(warned[30:50])
    assert not warned[-1]


def test_late_stamps_are_no_missed_impacts() -> None:
    """All impacts are reported, with 1 ms of jitter, and none may be missed as declared."""
    model, random = sample("two_mass"), np.random.default_rng(1)
    whole = run(model.system, *model.initial_state(), seconds=60.0, rate=1.0)
    late = Options(law="minimum-variance", missed=0.0, clock_error=1e-3)
    observer = make_observer(model, late)
    said = []
    for k, each in enumerate(whole.events):
        stamp = each.stamp + round(1e6 * random.normal())
        said.append(k and observer.silence(stamp - 1))
        observer.receive(replace(each, stamp=stamp))
    assert len(said) > 40
    assert not any(said)
