# SPDX-License-Identifier: Apache-2.0
"""A node that is fed by ``play`` estimates what ``observe`` does, to the last bit."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import live_rig
import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from impact_observer_msgs.msg import ObserverState
from processes import PATIENCE, hosted

from impact_observer.cli.main import main
from impact_observer.io.interfaces import Quality
from impact_observer.io.messages import read_estimate
from impact_observer.io.reader import BagReader
from impact_observer.resources import shared
from impact_observer.ros.observer_node import ObserverNode
from impact_observer.ros.player import Player
from impact_observer.ros.session import ros_node
from impact_observer.ros.topics import qos_profile

pytestmark = [pytest.mark.ros, pytest.mark.usefixtures("ros_environment")]


class Case(NamedTuple):
    """A bag, what of it is played how fast, and an observer with a lag.

    Attributes:
        bag: makes the bag in a folder.
        topics: those that are played.
        speed: seconds of the bag in a second.
        lag: longer than what comes late, s.
        least: stamps that must be compared.
        options: of the observer, as of the command.
    """

    bag: Callable[[Path], Path]
    topics: list[str]
    speed: float
    lag: float
    least: int
    options: dict[str, str]


def robot(folder: Path) -> Path:
    """A robot with encoders and efforts at 40 Hz."""
    made = ["--duration", "2.7", "--rate", "40", "--jitter", "0.0002"]
    made += ["--measurements", "hammer_arm", "--measurement-rate", "40"]
    assert main(["simulate", "hammer_arm", *made, "-o", str(folder / "arm")]) == 0
    return folder / "arm"


CASES = {
    "impacts": Case(
        lambda _: shared("bags/two_mass"),
        ["/impacts", "/plant/joint_states"],
        speed=10.0,
        lag=1.0,
        least=500,
        options={"initial_state": "random:1", "rate": "50.0"},
    ),
    "pulses of a drive": Case(
        lambda _: shared("bags/hammer"),
        ["/impacts", "/phase_reference"],
        speed=8.0,
        lag=2.0,  # longer than a period
        least=500,
        options={"initial_state": "random:1", "rate": "50.0"},
    ),
    "a live force, a twentieth of it late": Case(
        lambda folder: live_rig.bag(folder / "rig"),
        ["/impacts", "/forcing"],
        speed=0.8,
        lag=1.0,
        least=250,
        options={"initial_state": "0.3,-0.2,0.5,-0.5"},
    ),
    "encoders and efforts of a robot": Case(
        robot,
        ["/impacts", "/joint_states"],
        speed=0.5,
        lag=1.3,
        least=30,
        options={
            "law": "minimum-variance",
            "clock_error": "0.0002",
            "measurements": "hammer_arm",
            "rate": "40.0",
        },
    ),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_node_fed_by_play_estimates_what_observe_does(case: Case, tmp_path: Path) -> None:
    """Events, samples and pulses may come late, but not later than the lag."""
    if case.bag is robot:
        pytest.importorskip("pinocchio", reason="not installed: extra robots")
    bag, output, model = case.bag(tmp_path), tmp_path / "out", tmp_path / "model.yaml"
    given = [f"--{name.replace('_', '-')}={value}" for name, value in case.options.items()]
    assert main(["observe", str(bag), *given, "-o", str(output)]) == 0
    with BagReader(output) as reader:
        offline = reader.observer_states("/observer/state")
        model.write_text(reader.model_text() or "", encoding="utf-8")
    options = {name: value for name, value in case.options.items() if name != "initial_state"}
    if "initial_state" in case.options:
        options["initial_state"] = f"'{case.options['initial_state']}'"
    states: list[ObserverState] = []
    parameters = {"model": model, "use_sim_time": True, "lag": case.lag, **options}
    with hosted(ObserverNode, parameters) as (node, spinner):
        many = qos_profile(Quality(depth=5000))
        spinner.probe.create_subscription(ObserverState, "observer/state", states.append, many)
        with (
            BagReader(bag) as reader,
            ros_node("player") as (other, _),
            ThreadPoolExecutor(1) as pool,
        ):
            player = Player(other, reader, case.topics, rate=case.speed)

            def play() -> None:
                player.wait_for_subscribers(PATIENCE)
                player.play()
                player.finish()

            spinner.until((playing := pool.submit(play)).done)
            playing.result()
        spinner.settle()
        told = {each.key: each.value for each in node.statuses()[0].values}
    where = {stamp: i for i, stamp in enumerate(offline.stamps.tolist())}
    final = {each.stamp: each for _, each in map(read_estimate, states)}
    compared = [(each, where[stamp]) for stamp, each in final.items() if stamp in where]
    assert len(compared) > case.least
    for estimate, i in compared:
        np.testing.assert_array_equal(estimate.q, offline.q[i])
        np.testing.assert_array_equal(estimate.u, offline.u[i])
        assert estimate.last_sequence == offline.last_sequence[i]
    if "/forcing" in case.topics:
        assert told["samples"] == str(len(live_rig.samples()))
        assert told["invalid samples"] == "0"
        assert "age of motor [s]" in told
