# SPDX-License-Identifier: Apache-2.0
"""The start of a fit whose motions are not linear in the initial state.

Guides that rub make the initial state hard to find, and where guides stick the motion forgets much
of the initial state. So the fit begins later, at the estimate of a geometric replica that has
followed the first impacts.
"""

from collections.abc import Sequence

import numpy as np

from impact_observer.events import ImpactEvent
from impact_observer.model import System
from impact_observer.observer import Observer, initial_state, law_named, replay
from impact_observer.observer.episode import Episode
from impact_observer.stamps import from_seconds
from impact_observer.states import Estimate, Vector

_SHARE = 0.25
"""Share of the impacts that the replica follows before the fit begins."""


def late_start(
    system: System, episode: Episode, events: Sequence[ImpactEvent]
) -> tuple[Episode, Vector | None]:
    """The rest of an episode, and the state (q, u) in the frame where it begins, shape (2n,).

    Returns the whole episode and None if no contact opens in time.
    """
    lasts = 1 + from_seconds(float(np.max(system.contact_time, initial=0.0)))
    after = [each.stamp for each in episode.keys[1:]]
    cut = next(
        (
            k
            for k, (each, stamp) in enumerate(zip(episode.changes, after, strict=False))
            if k >= _SHARE * len(after) and not each.closed and stamp - each.stamp > lasts
        ),
        None,
    )
    if cut is None:
        return episode, None
    start = episode.keys[cut].stamp + lasts
    observer = Observer(
        system,
        law_named("geometric")(system),
        *initial_state("zero", system),
        epoch=episode.epoch,
        ensemble=1,
    )
    estimates = replay(observer, events, np.array([start]))
    estimate = next((each for each in estimates if isinstance(each, Estimate)), None)
    if estimate is None:
        return episode, None
    x = np.concatenate([estimate.q, estimate.u])[None]
    state = system.to_frame(np.array([start - episode.epoch]), x)[0]
    return episode._replace(start=start, keys=episode.keys[cut + 1 :]), state
