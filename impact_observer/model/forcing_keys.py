# SPDX-License-Identifier: Apache-2.0
"""The keys of a forcing that systems of matrices and robots share."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from impact_observer.model import sampled_files
from impact_observer.model.document import Section, Value
from impact_observer.model.forcing import Forcing

KEYS = ("constant", "harmonics", *sampled_files.KEYS)
_HARMONIC = ("frequency", "cosine", "sine")


def read_forcing(
    forcing: Section, coordinates: Sequence[str], folder: Path | None, meaning: str = ""
) -> Forcing:
    """The forcing of ``coordinates`` by ``KEYS``; ``meaning`` is that of ``Section.vector``.

    CSV files lie in ``folder``.

    Raises:
        ModelError: a value is wrong; the error names the key and the expected value.
    """
    n = len(coordinates)
    harmonics = [Section(*item, _HARMONIC) for item in forcing.items("harmonics")]
    cosine, sine = (
        [each.vector(name, n, optional=True, meaning=meaning) for each in harmonics]
        for name in _HARMONIC[1:]
    )
    return Forcing(
        constant=forcing.vector("constant", n, optional=True, meaning=meaning),
        frequency=np.array([each.positive("frequency") for each in harmonics]),
        cosine=np.reshape(cosine, (len(harmonics), n)),
        sine=np.reshape(sine, (len(harmonics), n)),
        sampled=sampled_files.read_samples(forcing, coordinates, folder),
    )


def written_forcing(forcing: Forcing, coordinates: Sequence[str]) -> dict[str, Value]:
    """The values of ``KEYS`` from which ``read_forcing`` makes ``forcing``, with its samples."""
    parts = (getattr(forcing, name).tolist() for name in _HARMONIC)
    return {
        "constant": forcing.constant.tolist(),
        "harmonics": [
            dict(zip(_HARMONIC, each, strict=True)) for each in zip(*parts, strict=True)
        ],
        **sampled_files.written_samples(forcing.sampled, coordinates),
    }
