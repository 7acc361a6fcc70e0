"""The recorded bags: what they hold, what comes out of them, fed offline and live."""

from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from impact_observer.bag.comparisons import compare_bag
from impact_observer.bag.reader import BagReader
from impact_observer.bag.recordings import carried_model, events_in
from impact_observer.cli.main import main
from impact_observer.observer.laws import BUILT_IN
from impact_observer.plant import Plant, simulate
from impact_observer.shares import shared

EXPECTED = YAML(typ="safe").load(shared("bags/expected.yaml"))


@pytest.mark.parametrize("name", EXPECTED)
def test_a_recorded_bag_is_what_its_model_does(name: str) -> None:
    """Its events and its truth are those of the plant in it, started anew."""
    with BagReader(shared(f"bags/{name}")) as reader:
        model, events = carried_model(reader), events_in(reader)
        truth = reader.joint_states("/plant/joint_states")
    assert model.system.name == name
    assert model.provenance["version"] == "0.1.0"
    plant = Plant(model.system, *model.initial_state(), epoch=events[0].epoch)
    run = simulate(plant, truth.stamps)
    assert len(events) == EXPECTED[name]["impacts"]
    assert [e.switches for e in events] == [e.switches for e in run.events]
    stamps = [e.stamp for e in events]
    np.testing.assert_allclose(stamps, [e.stamp for e in run.events], rtol=0, atol=1)
    np.testing.assert_allclose(np.hstack([truth.q, truth.u]), run.states, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPECTED)
@pytest.mark.parametrize("law", BUILT_IN)
def test_observers_make_of_a_recorded_bag_what_is_expected(
    name: str, law: str, tmp_path: Path
) -> None:
    """V at the end over V at the start, for every law."""
    bag, output = shared(f"bags/{name}"), tmp_path / "out"
    arguments = ["observe", str(bag), "--law", law, "--initial", "random:1", "-o", str(output)]
    assert main(arguments) == 0
    with BagReader(output) as reader:
        comparison = compare_bag(reader, carried_model(reader).system).comparisons["/observer"]
    if law == "minimum-variance":  # down to where the stamps' rounding stands
        assert comparison.ratio is not None
        assert 0 < comparison.ratio <= EXPECTED[name][law]
        return
    assert comparison.ratio == pytest.approx(EXPECTED[name][law], rel=1e-6)
    if law != "open-loop":
        assert comparison.largest_rise() <= 1e-9


@pytest.mark.ros
def test_a_played_bag_makes_the_node_converge_as_it_did(
    ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """The node, fed by ``play`` with /clock, ends bit for bit where ``observe`` ends."""
    pytest.importorskip("impact_observer_msgs")
    from impact_observer_msgs.msg import ObserverState
    from processes import ros_arguments, running, spinning
    from sensor_msgs.msg import JointState

    from impact_observer.bag.interfaces import Quality
    from impact_observer.bag.messages import read_estimate
    from impact_observer.nodes.quality import qos_profile

    bag, output = shared("bags/two_mass"), tmp_path / "out"
    assert main(["observe", str(bag), "--initial", "random:1", "-o", str(output)]) == 0
    with BagReader(output) as reader:
        offline = reader.observer_states("/observer/state")
    where = {stamp: i for i, stamp in enumerate(offline.stamps.tolist())}
    parameters = {"model": "two_mass", "use_sim_time": True, "initial_state": "'random:1'"}
    node = ("impact_observer.nodes.observer", ros_arguments(parameters), ros_environment)
    heard: list[ObserverState] = []
    with running(*node), spinning() as spinner:
        spinner.probe.create_subscription(
            ObserverState, "observer/state", heard.append, qos_profile(Quality(depth=1000))
        )
        spinner.until(lambda: "observer" in spinner.probe.get_node_names())
        truth = qos_profile(Quality())
        spinner.probe.create_subscription(JointState, "plant/joint_states", id, truth)
        topics = ["/impacts", "/plant/joint_states"]
        play = ["play", str(bag), "--rate", "5", "--delay", "10", "--topics", *topics]
        with running("impact_observer", play, ros_environment) as player:
            spinner.until(lambda: player.poll() is not None)
            assert player.returncode == 0, player.communicate()
        spinner.settle()
    matched = 0
    for message in heard:
        _, estimate = read_estimate(message)
        i = where.get(estimate.stamp)
        if i is not None and offline.last_sequence[i] == estimate.last_sequence:
            assert estimate.q.tobytes() == offline.q[i].tobytes()
            assert estimate.u.tobytes() == offline.u[i].tobytes()
            matched += 1
    assert matched > 1000
    assert heard[-1].last_sequence == EXPECTED["two_mass"]["impacts"]
