# SPDX-License-Identifier: Apache-2.0
"""The file of ``--sources``: sensors that notice impacts, and the form of a table."""

import io
from collections.abc import Iterable
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import UNSET, Meta, UnsetType
from ruamel.yaml import YAML

from impact_observer.detector import Source
from impact_observer.detector.sensor_file import SourceKeys, checked_sources
from impact_observer.errors import ModelError, UsageError
from impact_observer.io.tables import TableForm
from impact_observer.model.document import Keys, Name, Positive, converted
from impact_observer.model.yaml_text import load_yaml
from impact_observer.resources import read_file_or_sample


class _Form(Keys, frozen=True):
    """The key ``table``; what it means says ``TableForm``."""

    time_unit: Literal["s", "ms", "us", "ns", "min", "h"] | UnsetType = UNSET
    time_column: Name | UnsetType = UNSET
    sort: bool | UnsetType = UNSET
    separator: Literal["tab", "semicolon", "comma", "blank"] | UnsetType = UNSET
    decimal: Literal["point", "comma"] | UnsetType = UNSET
    skip_rows: Annotated[int, Meta(ge=0)] | UnsetType = UNSET
    frame_rate: Positive | UnsetType = UNSET


class _Recording(Keys, frozen=True):
    sources: tuple[SourceKeys, ...] = ()
    table: _Form | UnsetType = UNSET


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
        given = converted(load_yaml(text), _Recording)
        if not isinstance(given.table, UnsetType):
            if form != TableForm():
                raise ModelError("table", "options of a table found beside it; expected one")
            keys = msgspec.to_builtins(given.table)
            if "frame_rate" in keys:
                keys["frame_rate"] = Fraction(str(keys["frame_rate"]))
            form = TableForm(**keys)
        return FitSources(checked_sources(given.sources, str(file)), form)
    except ModelError as error:
        raise UsageError(f"{file}: {error}") from None


def table_keys(text: str) -> list[str]:
    """Return the keys of ``table`` whose options a ``text`` names, such as ``--time-unit``."""
    names = [each.name for each in fields(TableForm)]
    return [name for name in names if f"--{name.replace('_', '-')}" in text]


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
