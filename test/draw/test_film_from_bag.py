# SPDX-License-Identifier: Apache-2.0
"""Films of bags: a part of the time, and chosen observers."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from impact_observer.draw.film_from_bag import MOST_ESTIMATES, read_film
from impact_observer.draw.scene.film import Film
from impact_observer.errors import BagError, UsageError
from impact_observer.events import ImpactEvent, Ruling, Switch, Verdict
from impact_observer.io import BagReader, BagWriter, JointState
from impact_observer.io.messages import bag_messages
from impact_observer.model import read_model
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Estimate, Vector

SYSTEM = read_model("two_mass").system
EPOCH = NS_PER_S


def film_of(reader: BagReader, *observers: str) -> Film:
    """The whole bag as a film, with all observers or some."""
    return read_film(reader, SYSTEM, start=0.0, duration=60.0, observers=observers or None)


def bag_of(folder: Path, write: Callable[[BagWriter, int, Vector], None]) -> Path:
    """A bag that ``write`` adds a state to every 10 ms, for half a second."""
    with BagWriter(folder / "bag") as writer:
        for k in range(51):
            write(writer, EPOCH + k * 10_000_000, np.array([0.01 * k, -0.01 * k]))
    return folder / "bag"


def write_joint_states(topic: str) -> Callable[..., None]:
    """A function that writes joint states on a topic."""
    make, names = bag_messages(), SYSTEM.coordinates

    def write(writer: BagWriter, stamp: int, q: Vector) -> None:
        state = JointState(stamp, names, q, np.zeros(2))
        writer.write(topic, stamp, make.joint_state(state))

    return write


def test_film_of_a_bag_has_plant_and_estimates(sample_bag: Path) -> None:
    """An estimate has its law as name, V at the samples, and the impacts."""
    with BagReader(sample_bag) as reader:
        film = film_of(reader)
    assert film.truth is not None
    assert [each.label for each in film.tracks] == ["plant", "geometric"]
    assert film.truth.stamps.size == film.estimates[0].stamps.size == 51
    assert (film.start, film.end, film.zero.stamp) == (EPOCH, EPOCH + NS_PER_S // 2, EPOCH)
    assert film.distances[0].V.tolist() == [0.0] * 51
    assert film.contacts.hits[0].size == 11
    assert film.truth.jumps.tolist() == film.contacts.hits[0].tolist()


def test_only_the_chosen_part_is_kept(sample_bag: Path) -> None:
    """The part has its first and its last stamp."""
    with BagReader(sample_bag) as reader:
        film = read_film(reader, SYSTEM, start=0.1, duration=0.2)
    assert film.truth is not None
    for track in film.tracks:
        assert track.stamps.size == 21
        assert track.q.base is None
    assert (film.start, film.end) == (EPOCH + 100_000_000, EPOCH + 300_000_000)


def test_part_without_states_is_one_line(sample_bag: Path) -> None:
    """The error names the stamps."""
    with BagReader(sample_bag) as reader, pytest.raises(BagError) as error:
        read_film(reader, SYSTEM, start=100.0, duration=1.0)
    assert "no states between 101.000000000 and 102.000000000 s" in str(error.value)


def test_plant_alone_and_estimate_alone_are_films(tmp_path: Path) -> None:
    """Time without events begins at the first state, and nothing is highlighted."""
    for topic, truth in (("/plant/joint_states", True), ("/observer_rig/joint_states", False)):
        folder = tmp_path / str(truth)
        folder.mkdir()
        with BagReader(bag_of(folder, write_joint_states(topic))) as reader:
            film = film_of(reader)
        assert (film.truth is not None) is truth
        assert [each.label for each in film.tracks] == ["plant" if truth else "observer_rig"]
        assert film.distances == ()
        assert film.zero.stamp == film.start == EPOCH


def test_bag_without_states_is_one_line(tmp_path: Path) -> None:
    """The error names the expected topics."""
    make = bag_messages()

    def write(writer: BagWriter, stamp: int, _: object) -> None:
        event = ImpactEvent(stamp, (Switch("stop"),), 1, 0, EPOCH)
        writer.write("/impacts", stamp, make.event(event))

    problem = "nothing that moves; expected true states on /plant"
    with BagReader(bag_of(tmp_path, write)) as reader, pytest.raises(BagError, match=problem):
        film_of(reader)


def test_observers_of_one_law_are_named_by_their_topics(tmp_path: Path) -> None:
    """Only chosen observers are shown, whether chosen with or without a slash."""
    make, names = bag_messages(), SYSTEM.coordinates
    several = {"observer_a": "geometric", "observer_b": "geometric", "observer_c": "kinematic"}

    def write(writer: BagWriter, stamp: int, q: Vector) -> None:
        for owner, law in several.items():
            estimate = Estimate(stamp, law, q, np.zeros(2))
            writer.write(f"/{owner}/state", stamp, make.estimate(estimate, names))

    with BagReader(bag_of(tmp_path, write)) as reader:
        film = film_of(reader)
        labels = [each.label for each in film.estimates]
        assert labels == ["geometric (observer_a)", "geometric (observer_b)", "kinematic"]
        chosen = film_of(reader, "observer_c", "/observer_a", "observer_c")
        assert [each.label for each in chosen.estimates] == ["kinematic", "geometric"]
        with pytest.raises(
            UsageError, match=r"observer /observer_d: not in .*; it has /observer_a"
        ):
            film_of(reader, "observer_d")


def test_too_many_observers_are_refused(tmp_path: Path) -> None:
    """The error has the names to choose from."""

    def write(writer: BagWriter, stamp: int, q: Vector) -> None:
        for i in range(MOST_ESTIMATES + 1):
            write_joint_states(f"/observer_{i}/joint_states")(writer, stamp, q)

    with BagReader(bag_of(tmp_path, write)) as reader:
        with pytest.raises(UsageError, match="7 observers: too many; name at most 6"):
            film_of(reader)
        names = [f"observer_{i}" for i in range(MOST_ESTIMATES)]
        assert len(film_of(reader, *names).estimates) == MOST_ESTIMATES


def test_estimate_jumps_where_its_observer_inserted_an_impact(tmp_path: Path) -> None:
    """An impact without an event is a jump too."""
    make, names = bag_messages(), SYSTEM.coordinates

    def write(writer: BagWriter, stamp: int, q: Vector) -> None:
        estimate = Estimate(stamp, "minimum-variance", q, np.zeros(2))
        writer.write("/observer/state", stamp, make.estimate(estimate, names))
        if stamp == EPOCH + 200_000_000:
            missed = Verdict(stamp - 3_000_000, Ruling.INSERTED, 0, "stop", "missed")
            writer.write("/observer/verdicts", stamp, make.verdict(missed))

    with BagReader(bag_of(tmp_path, write)) as reader:
        (track,) = film_of(reader).estimates
    assert track.jumps.tolist() == [EPOCH + 197_000_000]


def test_inserted_impact_makes_no_earlier_estimate_late(tmp_path: Path) -> None:
    """Estimates need not contain an inserted impact, which has no event."""
    make, names = bag_messages(), SYSTEM.coordinates
    received = EPOCH + 50_000_000

    def write(writer: BagWriter, stamp: int, q: Vector) -> None:
        last = received if stamp >= received else 0
        estimate = Estimate(stamp, "minimum-variance", q, np.zeros(2), last_event=last)
        writer.write("/observer/state", stamp, make.estimate(estimate, names))
        if stamp == EPOCH:
            event = ImpactEvent(received, (Switch("stop"),), 1, 0, EPOCH)
            writer.write("/impacts", stamp, make.event(event))
        if stamp == EPOCH + 200_000_000:
            missed = Verdict(stamp - 3_000_000, Ruling.INSERTED, 0, "stop", "missed")
            for verdict in (Verdict(received, Ruling.APPLIED, 1, "stop"), missed):
                writer.write("/observer/verdicts", stamp, make.verdict(verdict))

    with BagReader(bag_of(tmp_path, write)) as reader:
        (track,) = film_of(reader).estimates
    assert track.stamps.size == 51
    assert track.jumps.tolist() == [received, EPOCH + 197_000_000]


def test_estimates_published_before_their_event_arrived_are_left_out(tmp_path: Path) -> None:
    """A node may receive an event late; earlier estimates lack the jump."""
    make, names = bag_messages(), SYSTEM.coordinates
    hit, received = EPOCH + 195_000_000, EPOCH + 230_000_000

    def write(writer: BagWriter, stamp: int, q: Vector) -> None:
        last = (
            hit if stamp >= received else 0 if stamp < EPOCH + 50_000_000 else EPOCH + 50_000_000
        )
        jumped = q - 1.0 if stamp >= received else q
        estimate = Estimate(stamp, "geometric", jumped, np.zeros(2), last_event=last)
        if stamp == EPOCH:
            for i, instant in enumerate((EPOCH + 50_000_000, hit), start=1):
                event = ImpactEvent(instant, (Switch("stop"),), i, 0, EPOCH)
                writer.write("/impacts", stamp, make.event(event))
        writer.write("/observer/state", stamp, make.estimate(estimate, names))

    with BagReader(bag_of(tmp_path, write)) as reader:
        (track,) = film_of(reader).estimates
    left_out = {EPOCH + k * 10_000_000 for k in (20, 21, 22)}
    assert track.stamps.size == 51 - len(left_out)
    assert not left_out & set(track.stamps.tolist())
    before, after = track.position(hit - 1), track.position(hit)
    assert before is not None
    assert after is not None
    np.testing.assert_allclose(before, [0.19, -0.19])
    np.testing.assert_allclose(after, [-0.77, -1.23])
