# SPDX-License-Identifier: Apache-2.0
"""The model that a caller in Python gives, in any of its forms."""

from pathlib import Path
from typing import TypeAlias

from impact_observer.errors import UsageError
from impact_observer.model.model_file import Model, read_model
from impact_observer.model.system import System

ModelSource: TypeAlias = Model | System | str | Path
"""A model, a bare system, or the path of a model file or the name of a sample model."""


def model_of(source: ModelSource, asking: str) -> Model:
    """The model that ``source`` is or names; errors begin with ``asking``, who wants the model.

    Raises:
        ModelError: one line that names the file, the key and the expected value.
        UsageError: ``source`` is something else, or the file does not exist.
    """
    if isinstance(source, Model):
        return source
    if isinstance(source, System):
        return Model(source)
    if isinstance(source, str) and "\n" in source:
        raise UsageError(
            f"{asking}: a text of several lines found; expected parse_model(TEXT, NAME)"
        )
    if isinstance(source, (str, Path)):
        return read_model(source)
    raise UsageError(
        f"{asking}: {type(source).__name__} found; expected a Model, a System, or the path of a"
        " model file"
    )
