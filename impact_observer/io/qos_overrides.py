# SPDX-License-Identifier: Apache-2.0
"""Quality of service by topic, in the YAML file of ``ros2 bag play --qos-profile-overrides-path``.

The file has topics, and below each its policies by their short names. The file that comes with the
package is made from the table of topics.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from impact_observer.errors import ModelError, UsageError
from impact_observer.io.interfaces import INTERFACES, Interface, Quality
from impact_observer.model.model_file import load_yaml
from impact_observer.observer.laws import BUILT_IN
from impact_observer.stamps import NS_PER_S

SHIPPED = "config/rosbag2/qos_overrides.yaml"
_DEFAULT = "system_default"
_BEST = "best_available"
_CHOICES = {
    "history": ("keep_last", "keep_all", _DEFAULT),
    "reliability": ("reliable", "best_effort", _DEFAULT, _BEST),
    "durability": ("volatile", "transient_local", _DEFAULT, _BEST),
    "liveliness": ("automatic", "manual_by_topic", _DEFAULT, _BEST),
}
_DURATIONS = ("deadline", "lifespan", "liveliness_lease_duration")
_DEPTH, _CONVENTIONS = "depth", "avoid_ros_namespace_conventions"
_KEYS = ("history", _DEPTH, "reliability", "durability", *_DURATIONS, "liveliness", _CONVENTIONS)
_MOST = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Profile:
    """All policies of a topic by the names of ``rclpy.qos.QoSProfile``, with its defaults.

    The texts are short names, such as ``keep_last``; durations are in ns, 0 for none.
    """

    history: str = "keep_last"
    depth: int = 0
    reliability: str = "reliable"
    durability: str = "volatile"
    liveliness: str = _DEFAULT
    deadline: int = 0
    lifespan: int = 0
    liveliness_lease_duration: int = 0
    avoid_ros_namespace_conventions: bool = False

    @property
    def quality(self) -> Quality:
        """The policies that differ among our topics."""
        return Quality(
            reliable=self.reliability != "best_effort",
            transient_local=self.durability == "transient_local",
            depth=0 if self.history == "keep_all" else max(self.depth, 1),
        )


def read_overrides(path: Path) -> dict[str, Profile]:
    """The profiles in a file, by topic.

    Raises:
        UsageError: names the file, the topic, the policy and what is expected.
    """
    try:
        document = load_yaml(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: cannot be read as text: {reason}") from None
    except ModelError as error:
        raise UsageError(f"{path}: {error}") from None
    if not isinstance(document, Mapping) or not document:
        raise UsageError(f"{path}: no topic found; expected topics with their policies")
    for name in document:  # ros2 bag compares these with the absolute names in the bag
        if not (isinstance(name, str) and name.startswith("/")):
            raise UsageError(f"{path}: {name!r} is no topic; expected an absolute name: /impacts")
    return {topic: _profile(f"{path}: {topic}", document[topic]) for topic in document}


def _profile(where: str, policies: object) -> Profile:
    if not isinstance(policies, Mapping):
        raise UsageError(f"{where}: {policies!r} found; expected policies: {', '.join(_KEYS)}")
    values = {key: _policy(f"{where}: {key}", key, value) for key, value in policies.items()}
    profile = Profile(**values)  # type: ignore[arg-type]
    if profile.history == "keep_last" and _DEPTH not in values:
        raise UsageError(f"{where}: depth is missing; expected it with history keep_last")
    return profile


def _policy(where: str, key: object, value: object) -> object:
    """The value of the policy ``key``, checked."""
    if key not in _KEYS:
        raise UsageError(f"{where} is not known here; expected one of {', '.join(_KEYS)}")
    if key in _DURATIONS:
        return _duration(where, value)
    if key == _DEPTH:
        return _whole(where, value)
    if key == _CONVENTIONS:
        if not isinstance(value, bool):
            raise UsageError(f"{where} is {value!r}; expected true or false")
        return value
    choices = _CHOICES[str(key)]
    if value not in choices:
        raise UsageError(f"{where} is {value!r}; expected one of {', '.join(choices)}")
    return value


def _whole(where: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _MOST:
        raise UsageError(f"{where} is {value!r}; expected a whole number, 0 or more")
    return value


def _duration(where: str, value: object) -> int:
    """``{sec: , nsec: }`` as ns; 0 for what ROS writes for an infinite duration."""
    if not isinstance(value, Mapping) or set(value) != {"sec", "nsec"}:
        raise UsageError(f"{where} is {value!r}; expected both sec and nsec, and nothing else")
    seconds, nanoseconds = value["sec"], value["nsec"]
    if (seconds, nanoseconds) == (9_223_372_036, 854_775_807):
        return 0
    return _whole(f"{where}.sec", seconds) * NS_PER_S + _whole(f"{where}.nsec", nanoseconds)


def shipped_text() -> str:
    """The text of the file that comes with the package.

    ``ros2 bag`` compares exact names. So observers and monitors are listed without a law and with
    each built-in law.
    """
    parts = [
        "# Qualities of service of our topics, made from impact_observer/io/interfaces.py, for",
        "#   ros2 bag play BAG --qos-profile-overrides-path FILE",
        "#   ros2 bag record ... --qos-profile-overrides-path FILE",
    ]
    for each in INTERFACES:
        for topic in _topics(each):
            quality = each.quality
            durability = "transient_local" if quality.transient_local else "volatile"
            parts += [
                f"{topic}:",
                f"  history: {'keep_last' if quality.depth else 'keep_all'}",
                f"  depth: {quality.depth}",
                f"  reliability: {'reliable' if quality.reliable else 'best_effort'}",
                f"  durability: {durability}",
            ]
    return "\n".join(parts) + "\n"


def _topics(each: Interface) -> list[str]:
    """The absolute names of an interface, also those with the name of a built-in law."""
    owner, _, _ = each.name.partition("/")
    if owner not in {"observer", "monitor"}:
        return [each.topic]
    laws = [f"{owner}_{law.replace('-', '_')}" for law in BUILT_IN]
    return [each.topic, *(f"/{each.of(law)}" for law in laws)]
