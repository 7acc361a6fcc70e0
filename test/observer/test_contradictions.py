# SPDX-License-Identifier: Apache-2.0
"""Faults of a sensor that is declared without faults end certainty, and are warned of."""

from dataclasses import replace

import numpy as np
import pytest
from systems import run, sample

from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, model_of
from impact_observer.observer import make_observer, replay
from impact_observer.options import Options
from impact_observer.resources import shared
from impact_observer.states import Estimate

FAULTY = ("jitter", "missed", "spurious", "missed_and_spurious", "mislabelled")
"""Sample bags of sensors with faults."""
FAULTLESS = Options(
    law="minimum-variance",
    clock_error=0.0,
    missed=0.0,
    spurious=0.0,
    mislabelled=0.0,
    model_error=0.0,
)
FAR = 0.05
"""Error of an estimate that is not synchronized with its plant, m or m/s."""


class Judged:
    """Estimates of a sample bag with true states, with every fault and error declared zero.

    Attributes:
        distances: largest error of any component of each estimate, m or m/s.
        errors: the same in standard deviations.
        synchronized: whether each estimate is.
        misfit: the warning of each estimate.
    """

    def __init__(self, bag: str) -> None:
        """Observe the sample ``bag`` at the stamps of its true states."""
        with BagReader(shared("bags") / bag) as reader:
            model, events = model_of(reader, None), events_in(reader)
            topic = reader.truth_topic()
            assert topic is not None, "true states"
            truth = reader.joint_states(topic)
        observer = make_observer(model, FAULTLESS)
        states = dict(zip(truth.stamps.tolist(), np.hstack([truth.q, truth.u]), strict=True))
        replayed = replay(observer, events, np.array(sorted(states)))
        estimates = [each for each in replayed if isinstance(each, Estimate)]
        size = 2 * model.system.n
        deviations = [np.sqrt(np.diag(np.reshape(e.covariance, (size,) * 2))) for e in estimates]
        errors = [np.abs(np.concatenate([e.q, e.u]) - states[e.stamp]) for e in estimates]
        pairs = zip(errors, deviations, strict=True)
        self.distances = np.array([each.max() for each in errors])
        self.errors = np.array([np.max(e / np.maximum(d, 1e-150)) for e, d in pairs])
        self.synchronized = np.array([each.synchronized for each in estimates])
        self.misfit = [each.misfit for each in estimates]


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
