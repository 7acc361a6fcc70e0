# SPDX-License-Identifier: Apache-2.0
"""Qualities of service by topic, as ``ros2 bag`` takes them."""

from pathlib import Path

import pytest
from ruamel.yaml import YAML

from impact_observer.errors import UsageError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import EVENTS, LATCHED, Quality
from impact_observer.io.qos_overrides import SHIPPED, Profile, read_overrides, shipped_text
from impact_observer.observer.laws import BUILT_IN

ROOT = Path(__file__).parents[2]
ALL = """
/test_topic:
  history: keep_all
  depth: 0
  reliability: best_effort
  durability: transient_local
  deadline: {sec: 1, nsec: 5}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: manual_by_topic
  liveliness_lease_duration: {sec: 0, nsec: 0}
  avoid_ros_namespace_conventions: true
/other: {depth: 3}
"""


def written(folder: Path, text: str) -> Path:
    """A file with a text."""
    path = folder / "qos.yaml"
    path.write_text(text)
    return path


def test_shipped_file_is_made_from_the_table() -> None:
    """If they differ, the file is out of date."""
    path = ROOT / SHIPPED
    assert path.read_text() == shipped_text(), "run ./dev docs"


def test_shipped_file_has_every_topic_with_its_quality() -> None:
    """As another YAML library reads it; also those of every built-in law's observer."""
    profiles_in_file = YAML(typ="safe").load(ROOT / SHIPPED)
    assert {each.topic for each in interfaces.INTERFACES} <= set(profiles_in_file)
    for law in BUILT_IN:
        assert f"/observer_{law.replace('-', '_')}/state" in profiles_in_file
        assert f"/monitor_{law.replace('-', '_')}/error" in profiles_in_file
    profiles = read_overrides(ROOT / SHIPPED)
    assert profiles.keys() == profiles_in_file.keys()
    for topic, profile in profiles.items():
        assert profile.quality == interfaces.usual_quality(topic)
    assert profiles["/impacts"].quality == EVENTS
    assert profiles["/plant/model"].quality == LATCHED


def test_every_policy_is_read(tmp_path: Path) -> None:
    """Defaults are those of rclpy; an infinite duration is none."""
    profiles = read_overrides(written(tmp_path, ALL))
    assert profiles["/test_topic"] == Profile(
        "keep_all",
        0,
        "best_effort",
        "transient_local",
        "manual_by_topic",
        deadline=1_000_000_005,
        avoid_ros_namespace_conventions=True,
    )
    assert profiles["/test_topic"].quality == Quality(False, True, 0)
    assert profiles["/other"].quality == Quality(depth=3)


def test_profile_equals_that_of_rclpy_for_the_same_file(tmp_path: Path) -> None:
    """Policy by policy."""
    qos = pytest.importorskip("rclpy.qos")
    from rclpy.duration import Duration

    from impact_observer.ros.qos import overriding_profile

    profiles = read_overrides(written(tmp_path, ALL))
    assert overriding_profile(profiles["/other"]) == qos.QoSProfile(depth=3)
    assert overriding_profile(profiles["/test_topic"]) == qos.QoSProfile(
        history=qos.HistoryPolicy.KEEP_ALL,
        depth=0,
        reliability=qos.ReliabilityPolicy.BEST_EFFORT,
        durability=qos.DurabilityPolicy.TRANSIENT_LOCAL,
        liveliness=qos.LivelinessPolicy.MANUAL_BY_TOPIC,
        deadline=Duration(nanoseconds=1_000_000_005),
        avoid_ros_namespace_conventions=True,
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no topic found; expected topics with their policies"),
        ("[1]", "no topic found"),
        ("a: [", "is not YAML at line 1"),
        ("impacts: {depth: 1}", "'impacts' is no topic; expected an absolute name"),
        ("/a: 5", "/a: 5 found; expected policies: history, depth"),
        ("/a: {depht: 5}", "/a: depht is not known here; expected one of history, depth"),
        ("/a: {depth: -1}", "/a: depth is -1; expected a whole number"),
        ("/a: {depth: true}", "/a: depth is True; expected a whole number"),
        ("/a: {history: keep_last}", "/a: depth is missing; expected it with history keep_last"),
        ("/a: {reliability: reliable}", "/a: depth is missing"),
        ("/a: {history: keep}", "/a: history is 'keep'; expected one of keep_last, keep_all"),
        ("/a: {depth: 1, durability: 2}", "/a: durability is 2; expected one of volatile"),
        ("/a: {depth: 1, deadline: {sec: 1}}", "/a: deadline is {'sec': 1}; expected both sec"),
        ("/a: {depth: 1, deadline: {sec: -1, nsec: 0}}", "/a: deadline.sec is -1"),
        ("/a: {depth: 1, avoid_ros_namespace_conventions: 1}", "is 1; expected true or false"),
    ],
)
def test_a_mistake_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    """With file, topic, policy and what is expected."""
    path = written(tmp_path, text)
    with pytest.raises(UsageError) as wrong:
        read_overrides(path)
    line = str(wrong.value)
    assert line.startswith(f"{path}: ")
    assert said in line
    assert "\n" not in line


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    """Or is no text."""
    with pytest.raises(UsageError, match=r"absent\.yaml: cannot be read as text: No such file"):
        read_overrides(tmp_path / "absent.yaml")
