# SPDX-License-Identifier: Apache-2.0
"""The file of qualities of service for ``ros2 bag``."""

from pathlib import Path

from ruamel.yaml import YAML

from impact_observer.io import interfaces
from impact_observer.observer.laws import OWN_LAWS

FILE = Path(__file__).parents[2] / "config" / "rosbag2" / "qos_overrides.yaml"


def test_the_file_has_every_topic_with_its_quality() -> None:
    """The topics of every built-in law's observer and monitor too."""
    profiles = YAML(typ="safe").load(FILE)
    assert {each.topic for each in interfaces.INTERFACES} <= set(profiles)
    for law in OWN_LAWS:
        assert f"/observer_{law.replace('-', '_')}/state" in profiles
        assert f"/monitor_{law.replace('-', '_')}/error" in profiles
    for topic, profile in profiles.items():
        quality = interfaces.usual_quality(topic)
        assert profile == {
            "history": "keep_last",
            "depth": quality.depth,
            "reliability": "reliable" if quality.reliable else "best_effort",
            "durability": "transient_local" if quality.transient_local else "volatile",
        }
