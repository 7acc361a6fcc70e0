# SPDX-License-Identifier: Apache-2.0
"""What is wrong before a fit begins: with the model, and with impacts for the model."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from impact_observer.check.model_check import ModelCheck
from impact_observer.check.model_report import for_json
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind
from impact_observer.io.table_times import UNITS
from impact_observer.model import Model
from impact_observer.recording.detection_choice import simulated_impacts
from impact_observer.stamps import NS_PER_S, seconds_between

_RATIO = 5.0
"""Ratio, or inverse ratio, of impacts found and expected that is worth a line."""
_PERIODS = 90.0
"""Usual time between two impacts, in slowest periods of the model, beyond which no fit begins."""

_CLOSED = 0.5
"""Share of a recording in which a contact is closed that is worth a line."""


def model_warnings(checked: ModelCheck) -> Iterator[str]:
    """Return the warnings of ``check-model``, a line each."""
    for finding in for_json(checked)["findings"]:
        if finding["kind"] == "warning":
            yield str(finding["text"])


def check_times(checked: ModelCheck, events: Sequence[ImpactEvent], recording: Path) -> None:
    """Check that impacts follow each other as fast as the model moves.

    Raises:
        UsageError: the usual time between two impacts is far beyond the periods of the model, as
            where times are in ms; a fit would take long and be wrong.
    """
    system, stamps = checked.system, np.unique([each.stamp for each in events])
    frequencies = np.append(checked.undamped, system.forcing.frequency)
    if stamps.size < 2 or not np.any(frequencies > 0):
        return
    usual = float(np.median(np.diff(stamps))) / NS_PER_S
    most = _PERIODS * 2 * np.pi / float(np.min(frequencies[frequencies > 0]))
    if usual > most:
        fitting = [unit for unit in ("ms", "us", "ns") if usual * UNITS[unit] <= most * NS_PER_S]
        unit = (*fitting, "ns")[0]
        raise UsageError(
            f"{recording}: {usual:.3g} s between two impacts found; expected at most {most:.3g} s,"
            f" {_PERIODS:g} periods of the slowest motion of {system.name}; if the times are in"
            f" {unit}, write table: {{time_unit: {unit}}} into a file for --sources"
        )


def long_contacts(events: Sequence[ImpactEvent]) -> Iterator[str]:
    """Return a line on each contact that is closed most of the time."""
    stamps = [each.stamp for each in events]
    begin, end = min(stamps), max(stamps)
    closed, since = Counter[str](), dict[str, int]()
    for each in sorted(events, key=lambda each: each.stamp):
        for switch in each.switches:
            if switch.kind == Kind.CLOSE:
                since.setdefault(switch.contact, each.stamp)
            elif switch.contact in since:
                closed[switch.contact] += each.stamp - since.pop(switch.contact)
    for name, stamp in since.items():
        closed[name] += end - stamp
    for name, ns in closed.items():
        if ns > _CLOSED * (end - begin):
            yield (
                f"{name}: closed for {100 * ns / (end - begin):.0f} % of the recording; of a"
                " switch that opens at a hit write `inverted: true` into a file for --sources"
            )


def doubtful_contacts(model: Model, events: Sequence[ImpactEvent]) -> Iterator[str]:
    """Return a line on each contact that the model reaches far less or far more often.

    Of a model that only its initial state moves nothing is said.
    """
    stamps = [each.stamp for each in events]
    seconds = seconds_between(min(stamps), max(stamps))
    simulated = simulated_impacts(model, seconds) if model.system.depends_on_time else None
    if simulated is None or not seconds:
        return
    expected = Counter(name for _, names in simulated.impacts for name in names)
    found = Counter(
        switch.contact for each in events for switch in each.switches if switch.kind != Kind.OPEN
    )
    for name, count in found.items():
        usual = expected[name] * seconds / simulated.seconds
        if not usual / _RATIO <= count <= usual * _RATIO:
            yield (
                f"{name}: {count} impacts found, about {usual:.3g} expected of the model at its"
                " given values: are limits, gaps, forces and frequencies in SI units (rad/s)?"
            )
