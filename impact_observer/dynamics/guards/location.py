# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The first instant at which a watched function falls below zero, found with a guarantee."""

from typing import NamedTuple

from impact_observer.dynamics.flow.phase import Phase
from impact_observer.dynamics.guards.watched import Watched
from impact_observer.kernel import PhaseMotion, RootSearch

DEPTH = 1e-13
"""Depth below zero that may be passed over, relative to what a function is rounded against."""


class Crossing(NamedTuple):
    """The instant at which watched functions reach zero.

    Attributes:
        s: seconds since the start of the motion.
        which: indices of all functions that are zero then.
    """

    s: float
    which: tuple[int, ...]


class Search:
    """Looks for the first crossing of watched functions along motions of one phase.

    Attributes:
        window: a time in which the fastest part of motions turns once or twice, s.
        guards: the functions, as the kernel has them.
    """

    def __init__(self, phase: Phase, watched: Watched, window: float) -> None:
        """Prepare the functions of ``phase`` that must not fall below zero."""
        self.window = window
        self.guards = phase.flow.guards(watched.functions(phase.equations.forcing))

    def first(self, motion: PhaseMotion, horizon: float, start: float = 0.0) -> Crossing | None:
        """Seconds until the first function falls below zero; None if none does.

        Args:
            motion: of (p, u), with no function below zero at its start but for rounding.
            horizon: where to stop looking, s; the end of the forcing, if that is earlier.
            start: where to begin, s; nothing crosses before.

        Returns:
            Where in [start, horizon] the first function reaches zero from above, with all others
            that are zero there. Crossings no deeper than ``DEPTH`` of a function's scale may be
            passed over.
        """
        found = self.along(motion, start).first(horizon)
        return None if found is None or found.s > horizon else found

    def along(self, motion: PhaseMotion, start: float = 0.0) -> "Hunt":
        """A search along ``motion`` from ``start`` s on, which can be extended again and again."""
        return Hunt(RootSearch(self.guards, motion, self.window, start))


class Hunt:
    """A search along one motion that goes on where it has stopped.

    What it finds does not depend on who asks when.
    """

    def __init__(self, search: RootSearch) -> None:
        """Take the kernel's search."""
        self._search = search

    def first(self, horizon: float) -> Crossing | None:
        """The first crossing, if all before ``horizon`` s had to be looked at to find it."""
        found = self._search.first(horizon)
        return None if found is None else Crossing(*found)
