# SPDX-License-Identifier: Apache-2.0
"""The file of ``--sources``: sensors that notice impacts, and the form of a table."""

import io
from collections.abc import Iterable
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path

from ruamel.yaml import YAML

from impact_observer.detector import Source
from impact_observer.detector.sensor_file import sources_in
from impact_observer.errors import ModelError, UsageError
from impact_observer.io.table_times import UNITS
from impact_observer.io.tables import SEPARATORS, TableForm
from impact_observer.model.document import Section
from impact_observer.model.model_file import load_yaml
from impact_observer.resources import read_file_or_sample

_TABLE_KEYS = tuple(each.name for each in fields(TableForm))


@dataclass(frozen=True, slots=True)
class FitSources:
    """What is declared of a recording.

    Attributes:
        sources: the sensors; empty where the only column or topic is the sensor.
        form: how a table is to be read.
    """

    sources: tuple[Source, ...]
    form: TableForm


def read_fit_sources(path: Path | None, form: TableForm | None = None) -> FitSources:
    """Read a file of sensors that may have a key ``table`` beside ``sources``.

    Args:
        path: the file; None without one.
        form: of a table, as options give it; None where there are none.

    Raises:
        UsageError: one line that names the file, the key and what is wanted; also where both the
            file and options say how a table is to be read.
    """
    form = form or TableForm()
    if path is None:
        return FitSources((), form)
    file, text = read_file_or_sample(path, "config/detector", "a file of sensors, or a sample")
    try:
        section = Section("", load_yaml(text), ("sources", "table"))
        if "table" in section:
            if form != TableForm():
                raise ModelError("table", "options of a table found beside it; expected one")
            form = _form(section)
        return FitSources(sources_in(section, str(file)), form)
    except ModelError as error:
        raise UsageError(f"{file}: {error}") from None


def sources_text(sources: Iterable[Source]) -> str:
    """Return the text of a file that declares these sensors."""
    names = [each.name for each in fields(Source) if each.name != "origin"]
    items = [
        {name: value for name in names if (value := getattr(each, name)) is not None}
        for each in sources
    ]
    written = io.StringIO()
    YAML().dump({"sources": items}, written)
    return written.getvalue()


def _form(section: Section) -> TableForm:
    """Return the form of a table under the key ``table``."""
    table = Section("table", section.value("table"), _TABLE_KEYS)
    given: dict[str, object] = {}
    for key in (each for each in _TABLE_KEYS if each in table):
        if key == "sort":
            given[key] = table.value(key) is True
        elif key == "skip_rows":
            given[key] = int(table.number(key))
        elif key == "frame_rate":
            given[key] = Fraction(str(table.number(key)))
        else:
            given[key] = table.text(key)
    for key, allowed in (
        ("separator", SEPARATORS),
        ("time_unit", UNITS),
        ("decimal", ("point", "comma")),
    ):
        if key in given and given[key] not in allowed:
            raise ModelError(
                table.key(key), f"{given[key]} found; expected one of {', '.join(allowed)}"
            )
    return TableForm(**given)  # type: ignore[arg-type]
