# SPDX-License-Identifier: Apache-2.0
"""A search that ends after so many flights."""

import pytest

from impact_observer.errors import IdentificationError
from impact_observer.identify.fit_progress import FitProgress


def test_a_search_computes_no_more_flights_than_it_may() -> None:
    """All flights that follow are refused, too, and those after the search are free again."""
    progress = FitProgress()
    progress.spend(10**9)
    with progress.at_most(100):
        progress.spend(99)
        for flights in (2, 1):
            with pytest.raises(IdentificationError):
                progress.spend(flights)
    progress.spend(10**9)


def test_progress_names_the_step() -> None:
    """The step alone, then how far it is."""
    lines = list[str]()
    progress = FitProgress(lines.append)
    progress.stage("a fit")
    progress("1 of 2")
    assert lines == ["a fit", "a fit: 1 of 2"]
