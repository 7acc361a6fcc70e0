# SPDX-License-Identifier: Apache-2.0
"""What a fit says of how well parameters are known, for the model file that it writes."""

from collections.abc import Collection

import numpy as np
from scipy import linalg

from impact_observer.errors import UsageError
from impact_observer.events import Kind
from impact_observer.identify.identification import Identification
from impact_observer.model.free_parameters import OFFSET, is_phase
from impact_observer.model.parameter_uncertainty import ParameterUncertainty

_RATIOS = ("-scale", "-amplitude")
"""Ends of the kinds of parameters whose value is 1 in any model file."""
_HALF_TURN = np.pi * (1 - 1e-9)
"""Largest deviation of a phase, rad, below the one that a model file may have by rounding."""


def written_uncertainty(
    fitted: Identification, given: ParameterUncertainty | None
) -> ParameterUncertainty | None:
    """The covariance of the fitted parameters, and of those ``given`` that were not fitted.

    The initial state is marginalised. The clock's offset belongs to the sensor and is left out.
    The deviation of a phase is at most half a turn. None if nothing is left.
    """
    names, first = fitted.family.names, fitted.start.size
    own = [j for j, name in enumerate(names) if name != OFFSET]
    # A ratio is relative to the file that is written.
    ratios = [fitted.values[j] if _is_ratio(names[j]) else 1.0 for j in own]
    turns = [fitted.errors[j] / _HALF_TURN if is_phase(names[j]) else 1.0 for j in own]
    unit = np.multiply(ratios, np.maximum(turns, 1.0))
    rows = [first + j for j in own]
    blocks = [fitted.covariance[np.ix_(rows, rows)] / np.outer(unit, unit)]
    known = [names[j] for j in own]
    if given is not None:
        kept = [i for i, name in enumerate(given.names) if name not in names]
        known += [given.names[i] for i in kept]
        blocks.append(given.covariance[np.ix_(kept, kept)])
    if not known:
        return None
    keys = fitted.recording.episode.keys
    stamps = [k.stamp for k in keys if any(kind is not Kind.OPEN for _, kind in k.switches)]
    return ParameterUncertainty(
        tuple(known), linalg.block_diag(*blocks), (min(stamps), max(stamps)) if own else None
    )


def _is_ratio(name: str) -> bool:
    return name.partition(".")[0].endswith(_RATIOS)


def refuse_scales_of_parts(free: Collection[str], known: ParameterUncertainty | None) -> None:
    """Check that no deviation is ``known`` of a part of what is ``free``, or of its whole.

    Raises:
        UsageError: such as a stiffness with a deviation beside a free scale of all stiffness.
    """
    for name in (each for each in (known.names if known else ()) if each not in free):
        kind = name.partition(".")[0]
        for each in free:
            other = each.partition(".")[0]
            if other in (f"{kind}-scale", kind.removesuffix("-scale")) and other != kind:
                raise UsageError(
                    f"--free {each}: the model declares a deviation of {name}; free {name}, or"
                    " leave its deviation out of the model"
                )
