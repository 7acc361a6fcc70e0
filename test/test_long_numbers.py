# SPDX-License-Identifier: Apache-2.0
"""Whole numbers beyond a float, and of 5000 digits."""

from argparse import ArgumentTypeError
from typing import Any

import pytest

from impact_observer.cli.arguments import value_of
from impact_observer.errors import UsageError
from impact_observer.options import OBSERVER_OPTIONS, Option, Options

NUMBERS = [each for each in OBSERVER_OPTIONS if each.type in {"int", "double"}]


@pytest.mark.parametrize("option", NUMBERS, ids=lambda each: each.name)
def test_numbers_of_any_length_are_refused(option: Option) -> None:
    """As arguments and from Python."""
    for digits in (300, 5000):
        with pytest.raises((ArgumentTypeError, UsageError, ValueError)):
            value_of(option)("9" * digits)
    given: dict[str, Any] = {option.name: 10**400}
    with pytest.raises(UsageError):
        Options(**given)
