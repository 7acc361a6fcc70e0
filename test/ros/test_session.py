"""Signals: noted until work is finished, or raised amid a long computation."""

import signal
import time
from contextlib import suppress

import pytest

from impact_observer.ros.session import Stop, interruptible


def test_the_first_signal_is_noted_and_the_second_raises() -> None:
    """So that a user who is in a hurry presses Ctrl-C twice."""
    with Stop() as stop:
        signal.raise_signal(signal.SIGINT)
        assert stop.requested
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_a_signal_within_a_long_computation_raises() -> None:
    """And is noted too; afterwards signals are only noted again."""
    with Stop() as stop:
        with pytest.raises(KeyboardInterrupt), interruptible():
            signal.raise_signal(signal.SIGTERM)
        assert stop.requested


def test_a_signal_just_before_a_long_computation_raises_too() -> None:
    """It does not wait for the end of the computation."""
    with Stop():
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt), interruptible():
            pytest.fail("it began")


def test_an_interrupt_that_is_swallowed_is_raised_again() -> None:
    """As one within a callback from C, where exceptions are ignored."""

    def swallow() -> None:
        with interruptible():
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            time.sleep(30.0)

    with Stop(), pytest.raises(KeyboardInterrupt):
        swallow()
