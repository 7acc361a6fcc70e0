# SPDX-License-Identifier: Apache-2.0
"""Films: where everything is between samples, never across an impact."""

from collections.abc import Sequence

import numpy as np
import pytest
from systems import EPOCH, run, sample

from impact_observer.draw.scene.film import ContactHistory, Distance, Film, Track, scene_of
from impact_observer.dynamics.lyapunov import distance
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io.bag_part import TimeZero
from impact_observer.stamps import NS_PER_S

MS = NS_PER_S // 1000
SYSTEM = sample("two_mass").system


def track(stamps: Sequence[int], q: Sequence[float], jumps: Sequence[int] = ()) -> Track:
    """A track of one coordinate."""
    column = np.array(q, float)[:, None]
    return Track.of_states("plant", "", (np.array(stamps), column, 0 * column), jumps)


def place(moving: Track, stamp: int) -> float:
    """The only coordinate at a stamp within the track."""
    found = moving.position(stamp)
    assert found is not None
    return float(found[0])


def switch(stamp: int, kind: Kind, sequence: int, contact: str = "stop") -> ImpactEvent:
    """An event of one contact."""
    return ImpactEvent(stamp, (Switch(contact, kind),), sequence)


def test_track_is_linear_between_samples() -> None:
    """At the stamp of a sample the track has the sample's value."""
    moving = track([100, 200, 400], [0.0, 1.0, 3.0])
    assert [place(moving, t) for t in (100, 150, 200, 300, 400)] == [0.0, 0.5, 1.0, 2.0, 3.0]


def test_track_holds_its_sample_until_the_impact_and_is_after_it_from_then_on() -> None:
    """No state lies between the two sides of a jump."""
    moving = track([100, 200, 300], [0.0, 5.0, 6.0], jumps=[150])
    assert [place(moving, t) for t in (101, 149, 150, 199, 250)] == [0.0, 0.0, 5.0, 5.0, 5.5]


def test_sample_at_the_stamp_of_an_impact_is_after_it() -> None:
    """The sample before the impact is held; behind the impact the motion is linear."""
    moving = track([100, 200, 300], [0.0, 5.0, 6.0], jumps=[200])
    assert [place(moving, t) for t in (150, 199, 200, 250)] == [0.0, 0.0, 5.0, 5.5]


def test_track_of_two_impacts_between_samples_waits_for_the_last() -> None:
    """A track holds its sample until the last of two impacts without a sample between them."""
    moving = track([100, 200], [0.0, 5.0], jumps=[120, 180])
    assert [place(moving, t) for t in (119, 150, 179, 180)] == [0.0, 0.0, 0.0, 5.0]


def test_track_has_no_state_before_its_first_and_after_its_last() -> None:
    """A track without samples has no state at any stamp."""
    moving = track([100, 200], [0.0, 1.0])
    assert moving.position(99) is None
    assert moving.position(201) is None
    assert track([], []).position(0) is None


def test_last_state_of_a_stamp_counts_and_order_does_not() -> None:
    """A live estimate comes again, corrected, when a late event arrives."""
    moving = track([300, 100, 200, 100], [3.0, 9.0, 2.0, 1.0])
    assert moving.stamps.tolist() == [100, 200, 300]
    assert [place(moving, t) for t in (100, 200, 300)] == [1.0, 2.0, 3.0]


def test_sampled_plant_is_never_inside_of_its_stop() -> None:
    """Straight lines between states have no negative gap at any instant."""
    ran = run(SYSTEM, [0.1, -0.2], [0.5, 0.0], seconds=8.0, rate=50.0)
    jumps = [event.stamp for event in ran.events]
    moving = Track.of_states(
        "plant", "", (ran.stamps, ran.states[:, :2], ran.states[:, 2:]), jumps
    )
    assert len(jumps) > 3
    for stamp in range(EPOCH, EPOCH + 8 * NS_PER_S, 7 * MS + 1):
        q = moving.position(stamp)
        assert q is not None
        assert SYSTEM.gap(q)[0] >= -1e-9


def test_distance_is_taken_at_common_stamps() -> None:
    """Without common stamps V has no samples."""
    x = np.arange(12.0).reshape(3, 4)
    truth = Track.of_states("plant", "", (np.array([10, 20, 30]), x[:, :2], x[:, 2:]), ())
    other = Track.of_states("e", "e", (np.array([20, 25, 30]), 0 * x[:, :2], 0 * x[:, 2:]), ())
    found = Distance.between(SYSTEM, truth, other)
    assert found.stamps.tolist() == [20, 30]
    np.testing.assert_allclose(found.V, distance(SYSTEM, x[1:, :2], x[1:, 2:]))
    late = Track.of_states("e", "e", (np.array([11]), x[:1, :2], x[:1, 2:]), ())
    assert Distance.between(SYSTEM, truth, late).V.size == 0


def test_impact_is_highlighted_and_fades() -> None:
    """The highlight falls from 1 at the instant to 0; without hits the highlight is 0."""
    contacts = ContactHistory.of_events(
        SYSTEM, [switch(1000, Kind.IMPACT, 1), switch(5000, Kind.IMPACT, 2)]
    )
    found = [contacts.highlight(0, stamp, 1000) for stamp in (999, 1000, 1250, 2000, 4999, 5500)]
    assert found == [0.0, 1.0, 0.75, 0.0, 0.0, 0.5]
    assert ContactHistory.of_events(SYSTEM, []).highlight(0, 1000, 1000) == 0.0
    assert not contacts.is_closed(0, 1100)


def test_contact_is_closed_from_close_to_open() -> None:
    """A closing is an impact too; closing a closed contact changes nothing."""
    events = [
        switch(1000, Kind.CLOSE, 1),
        switch(2000, Kind.CLOSE, 2),
        switch(3000, Kind.OPEN, 3),
        switch(3500, Kind.OPEN, 4),
        switch(4000, Kind.IMPACT, 5),
        switch(5000, Kind.CLOSE, 6),
    ]
    contacts = ContactHistory.of_events(SYSTEM, events)
    at = [contacts.is_closed(0, stamp) for stamp in (999, 1000, 2999, 3000, 4000, 5000, 10**9)]
    assert at == [False, True, True, False, False, True, True]
    assert contacts.highlight(0, 1000, 10) == 1.0
    assert contacts.highlight(0, 3500, 10) == 0.0


def test_contacts_of_other_models_are_left_out() -> None:
    """A detector may name a contact that the model lacks."""
    contacts = ContactHistory.of_events(SYSTEM, [switch(1000, Kind.CLOSE, 1, "door")])
    assert dict(contacts.hits) == dict(contacts.closed) == {}


@pytest.mark.parametrize(
    ("fps", "speed", "count", "step"), [(25.0, 1.0, 26, 40 * MS), (30.0, 0.1, 301, 3333333)]
)
def test_pictures_are_evenly_spaced_and_the_last_one_is_the_end(
    fps: float, speed: float, count: int, step: int
) -> None:
    """Each stamp is rounded to a nanosecond, so rounding does not add up."""
    moving = track([0, NS_PER_S], [0.0, 1.0])
    model = sample("bouncing_ball").system
    contacts = ContactHistory({}, {})
    film = Film(scene_of(model, [moving]), moving, (), (), contacts, TimeZero(0), 0, NS_PER_S)
    stamps = film.stamps(fps, speed)
    assert stamps.size == count
    assert stamps[1] == step
    assert abs(stamps[-1] - NS_PER_S) <= 1
    assert film.seconds(stamps)[-1] == pytest.approx(1.0)
    assert film.tracks == (moving,)
