# SPDX-License-Identifier: Apache-2.0
"""The model: a validated impacting system, and the file it is read from."""

from impact_observer.model.forcing import Forcing
from impact_observer.model.model_file import Model, parse_model, read_model
from impact_observer.model.parameter_uncertainty import ParameterUncertainty
from impact_observer.model.system import Contact, System

__all__ = [
    "Contact",
    "Forcing",
    "Model",
    "ParameterUncertainty",
    "System",
    "parse_model",
    "read_model",
]
