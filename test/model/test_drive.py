# SPDX-License-Identifier: Apache-2.0
"""The phase of a drive by its index pulses, and the harmonics that turn with it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import EPOCH, examples, sample

from impact_observer.errors import ModelError
from impact_observer.model import parse_model
from impact_observer.model.drive import Drive
from impact_observer.model.live_signals import connected
from impact_observer.stamps import NS_PER_S

NOMINAL = 2 * np.pi
"""One revolution a second."""
TURNING = "{body: x, amplitude: 1, frequency: 2, order: 1}"
BODY = "name: a\nbodies: [{name: x, mass: 1}]\nforces: [%s]\n"


def drive(*seconds: float) -> Drive:
    """With pulses at these times since the epoch."""
    found = Drive(NOMINAL)
    for each in seconds:
        found.add_pulse(EPOCH + round(each * NS_PER_S))
    return found


def turns(of: Drive, *seconds: float) -> NDArray[np.float64]:
    """Revolutions and rates (1/s) at times since the epoch."""
    at = EPOCH + np.round(np.array(seconds) * NS_PER_S).astype(np.int64)
    return of.jets(at, EPOCH) / (2 * np.pi)


def test_phase_grows_evenly_between_pulses_and_on_by_the_last_period() -> None:
    """With the nominal frequency before the first one."""
    phase, rate = turns(drive(0.5, 1.6, 2.4), 0.25, 0.5, 1.05, 1.6, 2.0, 2.4, 2.8)
    np.testing.assert_allclose(phase, [-0.25, 0.0, 0.5, 0.0, 0.5, 0.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(rate, [1.0, *[1 / 1.1] * 2, *[1 / 0.8] * 4], rtol=1e-9)


def test_nominal_frequency_holds_before_there_are_two_pulses() -> None:
    """From the pulse on, or from the epoch where there is none."""
    for one, phase in ((drive(), [0.0, 0.7]), (drive(0.5), [-0.5, 0.2])):
        np.testing.assert_allclose(turns(one, 0.0, 0.7), np.array([phase, [1.0, 1.0]]), atol=1e-9)


def test_pulse_too_soon_is_left_out_and_a_missing_one_is_bridged() -> None:
    """After a gap the last good period goes on, and the phase starts again at zero."""
    one = drive(0.0, 1.1)
    _, problem = one.add_pulse(EPOCH + round(1.5 * NS_PER_S))
    assert "a period of 0.4 s found; expected 1 s within 30%: it is not used" in problem
    assert one.newest == EPOCH + round(1.1 * NS_PER_S)
    one.add_pulse(EPOCH + round(2.3 * NS_PER_S))
    np.testing.assert_allclose(turns(one, 1.7)[0], 0.5, atol=1e-9)
    _, problem = one.add_pulse(EPOCH + round(4.9 * NS_PER_S))
    assert "a period of 2.6 s found" in problem
    assert one.odd == 2
    phase, rate = turns(one, 2.9, 4.7, 4.9, 5.5)
    np.testing.assert_allclose(phase, [0.5, 2.0, 0.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(rate, 1 / 1.2, rtol=1e-9)


PULSES = st.lists(st.integers(0, 400), min_size=1, max_size=25, unique=True)


@examples(200)
@given(PULSES, st.data())
def test_phase_does_not_depend_on_the_order_of_arrival(
    pulses: list[int], data: st.DataObject
) -> None:
    """Equal bits; also what has been forgotten changes nothing after it; what changes is named."""
    stamps = [EPOCH + each * NS_PER_S // 20 for each in pulses]
    one, other = Drive(NOMINAL), Drive(NOMINAL)
    for stamp in sorted(stamps):
        one.add_pulse(stamp)
    at = EPOCH + np.arange(-5, 450) * (NS_PER_S // 20)
    for stamp in data.draw(st.permutations(stamps)):
        before = other.jets(at, EPOCH)
        changed, _ = other.add_pulse(stamp)
        assert changed is not None
        np.testing.assert_array_equal(
            before[:, at < changed], other.jets(at, EPOCH)[:, at < changed]
        )
    np.testing.assert_array_equal(one.jets(at, EPOCH), other.jets(at, EPOCH))
    cut = EPOCH + data.draw(st.integers(0, 400)) * NS_PER_S // 20
    other.forget_before(cut)
    for each in (one, other):
        each.add_pulse(EPOCH + 21 * NS_PER_S)
    np.testing.assert_array_equal(one.jets(at[at >= cut], EPOCH), other.jets(at[at >= cut], EPOCH))


def test_forces_follow_the_drive_with_all_derivatives() -> None:
    """By finite differences, at every order, between pulses and after the last."""
    system, live = connected(sample("hammer").system)
    assert live is not None
    for k in range(5):
        live.add_pulse(EPOCH + round((0.2 + 0.65 * k + 0.02 * k**2) * NS_PER_S))
    live.follow(EPOCH)
    t, h = np.array([0.05, 0.5, 1.3, 2.9, 4.0]), 1e-5
    found = system.forcing.derivatives(t, 3)
    for k in range(3):
        ends = [system.forcing.derivatives(t + s, k)[k] for s in (-h, h)]
        np.testing.assert_allclose(
            (ends[1] - ends[0]) / (2 * h), found[k + 1], rtol=1e-5, atol=1e-3
        )
    assert live.drive is not None
    phase = live.drive.jets(EPOCH + np.round(t * NS_PER_S).astype(np.int64), EPOCH)[0]
    np.testing.assert_allclose(
        found[0][:, 0], 20 * np.cos(phase) + 4 * np.cos(2 * phase + 0.7), atol=1e-9
    )


def test_order_is_kept_in_the_text_of_a_model() -> None:
    """In elements and in matrices, where it stands beside harmonics that do not turn."""
    for model in (
        sample("hammer"),
        parse_model(
            "name: a\ncoordinates: [x]\nmass: [[1]]\ndamping: [[0]]\nstiffness: [[1]]\n"
            "contacts: []\n"
            "forcing: {harmonics: [{frequency: 2, cosine: [1]},"
            " {frequency: 6, sine: [1], order: 2}]}\n",
            "a",
        ),
    ):
        again = parse_model(model.text(), "again").system.live
        assert again is not None
        assert model.system.live is not None
        assert (again.orders, again.nominal) == (
            model.system.live.orders,
            model.system.live.nominal,
        )


@pytest.mark.parametrize(
    ("force", "line"),
    [
        (
            "{body: x, amplitude: 1, frequency: 2, order: 0}",
            r"forces\[0\].order: is 0; expected a",
        ),
        ("{body: x, amplitude: 1, frequency: 2, order: 1.5}", "order: is 1.5; expected a whole"),
        ("{body: x, constant: 1, order: 1}", r"forces\[0\].order: stands beside constant"),
        (
            f"{TURNING}, {{body: x, amplitude: 1, frequency: 5, order: 2}}",
            "is 5, that of a drive of 2.5 rad/s, but another harmonic turns with one of 2; exp",
        ),
    ],
)
def test_order_that_cannot_be_is_one_line(force: str, line: str) -> None:
    """It names the key and what is wanted."""
    with pytest.raises(ModelError, match=line):
        parse_model(BODY % force, "a")
