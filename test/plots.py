# SPDX-License-Identifier: Apache-2.0
"""A recording that tests draw."""

import numpy as np

from impact_observer.draw.plot.impact_marks import Mark
from impact_observer.draw.plot.quantities import quantities_of
from impact_observer.draw.plot.series import PlotContent, Series
from impact_observer.events import Ruling

SECONDS = np.linspace(0.0, 2.0, 21)


def series(label: str, law: str, count: int, deviation: float = np.nan) -> Series:
    """Straight lines from 0 to 2."""
    t = np.repeat(SECONDS[:, None], count, axis=1)
    return Series(label, law, t, t, np.full(t.shape, deviation), t.shape[0])


def recording(count: int = 4, deviation: float = 100.0, **others: object) -> PlotContent:
    """Truth and one estimate of some quantities, with three impacts."""
    quantities = tuple(quantities_of([f"x{i}" for i in range(count)], None).values())[:count]
    drawn = (
        series("truth", "", count),
        series("minimum-variance", "minimum-variance", count, deviation),
    )
    marks = {
        Mark("stop", "minimum-variance", Ruling.APPLIED): np.array([0.5, 1.0]),
        Mark("stop", "minimum-variance", Ruling.INSERTED): np.array([1.5]),
    }
    given = {"marks": marks, "start": 0.0, "end": 2.0, **others}
    return PlotContent("rig <1>", quantities, drawn, **given)  # type: ignore[arg-type]
