# SPDX-License-Identifier: Apache-2.0
"""The list of curves: of a model, and of a bag."""

from dataclasses import replace
from pathlib import Path

import pytest
from arms import joint, link, model_of, urdf
from plotting_tools import everything

from impact_observer.draw.curves import curves
from impact_observer.draw.observer_topics import ObserverTopics, observers_in
from impact_observer.errors import UsageError
from impact_observer.io import BagReader
from impact_observer.model import read_model
from impact_observer.robots import Robot

MOTION = {"positions", "velocities", "errors", "standard deviations"}
LAWS = {
    "observer_geometric": "geometric",
    "observer_kinematic": "kinematic",
    "observer_minimum_variance": "minimum-variance",
    "observer_open_loop": "open-loop",
    "observer_unilateral": "unilateral",
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with an observer of every law, named after the law."""
    return everything(tmp_path_factory.mktemp("curves") / "bag", LAWS, duration=1.0)


@pytest.mark.slow
def test_topics_by_name_are_those_that_the_law_publishes(bag: Path) -> None:
    """The name of a node says which bound, covariance and parameters the bag has."""
    with BagReader(bag) as reader:
        found = {each.prefix: each for each in observers_in(reader)}
    assert found == {f"/{name}": ObserverTopics.of_node(name) for name in LAWS}
    assert found["/observer_minimum_variance"].learned[0] == "clock_error"


def test_an_observer_without_a_law_in_its_name_has_the_default_one() -> None:
    """The node called observer runs geometric by default."""
    assert ObserverTopics.of_node("observer") == ObserverTopics("/observer", bounded=True)


@pytest.mark.parametrize(
    ("name", "error", "truth"),
    [
        ("observer", "/monitor/error", "/plant/joint_states"),
        ("observer_kinematic", "/monitor_kinematic/error", "/plant/joint_states"),
        ("/rig/observer", "/rig/monitor/error", "/rig/plant/joint_states"),
        ("rig/observer_2", "/rig/monitor_2/error", "/rig/plant/joint_states"),
        ("watcher", "/monitor_watcher/error", "/plant/joint_states"),
    ],
)
def test_plant_and_monitor_are_those_beside_the_observer(
    name: str, error: str, truth: str
) -> None:
    """Plant and monitor are in the namespace of the observer; the monitor is named alike."""
    found = {
        each.topic
        for each in curves(read_model("two_mass").system, [ObserverTopics.of_node(name)])
    }
    assert {error, truth} <= found


def test_every_coordinate_is_drawn_for_plant_and_observer() -> None:
    """Truth and estimate share the axes of a coordinate; errors have their own."""
    system = read_model("three_mass").system
    drawn = curves(system, [ObserverTopics.of_node("observer")])
    for tab, unit in (("positions", "position [m]"), ("velocities", "velocity [m/s]")):
        for source in ("plant", "observer"):
            own = [each.plot for each in drawn if (each.tab, each.source) == (tab, source)]
            assert own == [f"{q} {unit}" for q in system.coordinates]
    assert sum(each.tab == "errors" for each in drawn) == 6
    contacts = [each.name for each in drawn if each.topic == "/impacts"]
    assert contacts == ["right", "left"]


def test_a_model_of_angles_has_its_curves_in_rad() -> None:
    """Positions, velocities, errors and deviations alike; of matrices the titles say m."""
    matrices = read_model("two_mass").system
    for system, unit in ((replace(matrices, unit="rad"), "rad"), (matrices, "m")):
        found = curves(system, [ObserverTopics.of_node("observer_minimum_variance")])
        units = {each.plot.partition("[")[2] for each in found if each.tab in MOTION}
        assert units == {f"{unit}]", f"{unit}/s]"}


def test_joints_of_a_robot_have_their_own_units() -> None:
    """A cart on a rail in m, with a pendulum in rad."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    text = urdf(
        link("cart", 1.0, "0 0 0") + link("rod", 1.0, "0 0 -1"),
        joint("rail", "base", "cart", kind="prismatic") + joint("hinge", "cart", "rod"),
    )
    robot = Robot(model_of(text, "rail, hinge"))
    found = curves(robot, [ObserverTopics.of_node("observer_minimum_variance")])
    plots = {each.name: each.plot for each in found if each.tab == "velocities"}
    assert plots["rail plant"] == "rail velocity [m/s]"
    assert plots["hinge plant"] == "hinge velocity [rad/s]"
    deviations = [each.plot for each in found if each.tab == "standard deviations"]
    words = [f"standard deviations of positions [{unit}]" for unit in ("m", "rad")]
    assert {*words} < {*deviations}


def test_observers_of_two_rigs_are_distinguished() -> None:
    """Names and colours differ; each observer is drawn with the plant of its rig."""
    rigs = [ObserverTopics.of_node(name) for name in ("/a/observer", "/b/observer")]
    found = curves(read_model("two_mass").system, rigs)
    assert len({(each.tab, each.plot, each.name) for each in found}) == len(found)
    assert {each.source for each in found} == {"plant", "a/observer", "b/observer"}
    of_plants = [(each.name, each.topic) for each in found if each.source == "plant"]
    assert ("x1 a/plant", "/a/plant/joint_states") in of_plants
    assert ("x1 b/plant", "/b/plant/joint_states") in of_plants
    assert of_plants[-2:] == [("a/stop", "/a/impacts"), ("b/stop", "/b/impacts")]


def test_v_and_its_bound_are_drawn_as_logarithms() -> None:
    """V and bound share axes; deviations are roots of the covariance's diagonal."""
    system = read_model("two_mass").system
    drawn = curves(system, [ObserverTopics("/observer", bounded=True, filters=True)])
    logarithms = [each for each in drawn if each.transform == "log10"]
    assert [each.name for each in logarithms] == [
        "V observer",
        "bound of V observer",
        "convergence observer",
    ]
    assert logarithms[0].plot == logarithms[1].plot
    roots = [each.series for each in drawn if each.transform == "sqrt"]
    assert roots == [f"/observer/state/covariance[{k}]" for k in (0, 5, 10, 15)]


def test_only_topics_that_are_there_are_drawn() -> None:
    """A bag without a monitor has no curves of errors."""
    topics = ["/plant/joint_states", "/observer/joint_states", "/elsewhere"]
    found = curves(read_model("two_mass").system, [ObserverTopics.of_node("observer")], topics)
    assert {each.topic for each in found} == set(topics[:2])


def test_a_name_that_no_node_can_have_is_refused() -> None:
    """The error is one line; a list without observers is refused too."""
    with pytest.raises(UsageError, match="'my observer': no name of a node"):
        ObserverTopics.of_node("my observer")
    with pytest.raises(UsageError, match="no observer"):
        curves(read_model("two_mass").system, [])


def test_an_observer_without_messages_is_found(tmp_path: Path) -> None:
    """An observer may have topics without messages, or joint states only."""
    from impact_observer.io import BagWriter

    with BagWriter(tmp_path / "bag") as writer:
        writer.declare("/observer/state")
        writer.declare("/observer_other/joint_states")
    with BagReader(tmp_path / "bag") as reader:
        silent = observers_in(reader)
    assert silent == (
        ObserverTopics("/observer", bounded=False),
        ObserverTopics("/observer_other", bounded=False),
    )
