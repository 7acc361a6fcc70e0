"""Signals: noted until work is finished."""

import signal

import pytest

from impact_observer.ros.session import Stop


def test_the_first_signal_is_noted_and_the_second_raises() -> None:
    """So that a user who is in a hurry presses Ctrl-C twice."""
    with Stop() as stop:
        signal.raise_signal(signal.SIGINT)
        assert stop.requested
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
