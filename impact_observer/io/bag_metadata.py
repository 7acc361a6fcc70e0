# SPDX-License-Identifier: Apache-2.0
"""The ``metadata.yaml`` of a bag, version 9, as ``ros2 bag`` of Jazzy reads it."""

from collections import Counter
from collections.abc import Iterable
from enum import Enum
from io import StringIO
from typing import NamedTuple

from rosbags.interfaces import QosTime
from ruamel.yaml import YAML

from impact_observer.io.interfaces import Quality

_NO_MESSAGE = 2**63 - 1
"""Starting time that rosbag2 writes for a bag without messages, ns."""


class Topic(NamedTuple):
    """A topic of a bag that is written.

    Attributes:
        channel: its number in the file.
        name: the absolute name.
        type: the message type.
        type_hash: the hash of its definition, ``RIHS01_...``.
        quality: the quality of service that was offered.
    """

    channel: int
    name: str
    type: str
    type_hash: str
    quality: Quality


class BagExtent(NamedTuple):
    """What a bag that is written has.

    Attributes:
        counts: messages of each channel.
        start: log time of the earliest message, ns; 0 without any.
        end: log time of the latest message, ns; 0 without any.
    """

    counts: Counter[int]
    start: int
    end: int


def metadata(file_name: str, extent: BagExtent, topics: Iterable[Topic]) -> tuple[str, str]:
    """The text of ``metadata.yaml``, and what of it the MCAP file holds too.

    Args:
        file_name: of the MCAP file.
        extent: of the messages.
        topics: of the bag, in the order of their declaration.
    """
    information = {
        "version": 9,
        "storage_identifier": "mcap",
        "relative_file_paths": [file_name],
        **_extent(extent),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.name,
                    "type": topic.type,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": [_policies(topic.quality)],
                    "type_description_hash": topic.type_hash,
                },
                "message_count": extent.counts[topic.channel],
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": file_name, **_extent(extent)}],
        "custom_data": None,
        "ros_distro": "rosbags",
    }
    return _yaml({"rosbag2_bagfile_information": information}), _yaml(information).strip()


def _extent(extent: BagExtent) -> dict[str, object]:
    """Number of messages, duration and start of a file, as in ``metadata.yaml``."""
    count = extent.counts.total()
    return {
        "message_count": count,
        "duration": {"nanoseconds": extent.end - extent.start},
        "starting_time": {"nanoseconds_since_epoch": extent.start if count else _NO_MESSAGE},
    }


def quality_text(quality: Quality) -> str:
    """An offered quality of service as the channel of a topic has it."""
    return _yaml([_policies(quality)]).strip()


def _policies(quality: Quality) -> dict[str, object]:
    """All policies by their short names."""
    return {
        name: (
            {"sec": value.sec, "nsec": value.nsec}
            if isinstance(value, QosTime)
            else value.name.lower()
            if isinstance(value, Enum)
            else value
        )
        for name, value in zip(quality.offered()._fields, quality.offered(), strict=True)
    }


def _yaml(value: object) -> str:
    """A value as YAML in block style."""
    stream, yaml = StringIO(), YAML(typ="safe")
    yaml.default_flow_style = False
    yaml.dump(value, stream)
    return stream.getvalue()
