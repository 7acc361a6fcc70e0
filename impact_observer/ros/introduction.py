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

"""The line with which each node starts its log."""

from collections.abc import Iterable

from rclpy.node import Node

from impact_observer.plain_text import printable

_OF_ROS = {"/rosout", "/parameter_events", "/clock"}
"""Topics that every node has."""


def introduce(node: Node, what: str, waits_for: str) -> None:
    """Log what a node runs, its topics, and what it waits for."""
    parts = [what]
    for verb, some in (("receives", node.subscriptions), ("publishes", node.publishers)):
        if topics := _names(each.topic_name for each in some):
            parts.append(f"{verb} {topics}")
    node.get_logger().info(printable("; ".join([*parts, f"waits for {waits_for}"])))


def _names(topics: Iterable[str]) -> str:
    return ", ".join(sorted({*topics} - _OF_ROS))
