# SPDX-License-Identifier: Apache-2.0
"""The file that declares the sensors of a rig."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import UNSET, Meta, UnsetType

from impact_observer.detector.source import Source
from impact_observer.errors import ModelError, UsageError
from impact_observer.model.document import Keys, Name, Number, converted
from impact_observer.model.yaml_text import load_yaml
from impact_observer.resources import read_file_or_sample


class SourceKeys(Keys, frozen=True, kw_only=True):
    """The keys of a sensor; what they mean says ``Source``, which checks them."""

    contact: Name
    topic: Name
    kind: Name | UnsetType = UNSET
    field: Name | UnsetType = UNSET
    threshold: Number | UnsetType = UNSET
    hysteresis: Number | UnsetType = UNSET
    direction: Name | UnsetType = UNSET
    instant: Name | UnsetType = UNSET
    baseline: Number | UnsetType = UNSET
    dead_time: Number | UnsetType = UNSET
    decay: Number | UnsetType = UNSET
    latency: Number | UnsetType = UNSET
    min_contact_duration: Number | UnsetType = UNSET
    inverted: bool | UnsetType = UNSET
    stamp: Name | UnsetType = UNSET


class _Sources(Keys, frozen=True):
    sources: Annotated[tuple[SourceKeys, ...], Meta(min_length=1)]
    table: dict[str, object] | UnsetType = UNSET  # how ``detect`` and ``fit`` read a table


def read_sources(path: str | Path) -> tuple[Source, ...]:
    """Returns the sensors that a file or a sample such as ``switch`` declares.

    Raises:
        UsageError: one line that names the file, the key and what is wanted.
    """
    file, text = read_file_or_sample(path, "config/detector", "a file of sensors, or a sample")
    return parse_sources(text, str(file))


def parse_sources(text: str, name: str) -> tuple[Source, ...]:
    """Returns the sensors that the text of a file declares, called ``name`` in errors.

    Raises:
        UsageError: one line that names the file, the key and what is wanted.
    """
    try:
        return checked_sources(converted(load_yaml(text), _Sources).sources, name)
    except ModelError as error:
        raise UsageError(f"{name}: {error}") from None


def checked_sources(given: Sequence[SourceKeys], name: str) -> tuple[Source, ...]:
    """Returns the sensors by their keys in a file of this ``name``, one a contact.

    Raises:
        UsageError: one line that names the key and what is wanted.
    """
    sources = tuple(
        Source(**msgspec.to_builtins(keys), origin=f"{name}: sources[{i}].")
        for i, keys in enumerate(given)
    )
    first: dict[str, Source] = {}
    for source in sources:
        if (other := first.setdefault(source.contact, source)) is not source:
            both = f"{other.topic} and {source.topic}"
            raise source.wrong(
                "contact", f"{source.contact!r} has two sensors, {both}; expected one a contact"
            )
    return sources
