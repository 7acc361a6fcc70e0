# SPDX-License-Identifier: Apache-2.0
"""Time zero of a bag, and parts of it."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from impact_observer.errors import UnfitBagError, UsageError
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import BagReader, BagWriter, JointState
from impact_observer.io.bag_part import TimeZero, read_part, time_zero
from impact_observer.io.messages import bag_messages
from impact_observer.io.typestores import typestore
from impact_observer.stamps import NS_PER_S

MAKE = bag_messages()
EPOCH = 5 * NS_PER_S


def bag(
    path: Path, *, epoch: int = EPOCH, impacts: Sequence[float] = (1.0, 2.0, 3.0), delay: int = 0
) -> Path:
    """A bag of impacts and ten states a second from 5 to 9 s, logged ``delay`` ns too late."""
    with BagWriter(path) as writer:
        writer.write("/plant/model", 1, MAKE.model("name: rig"))
        for k, t in enumerate(impacts, start=1):
            stamp = EPOCH + round(t * NS_PER_S)
            event = ImpactEvent(stamp, (Switch("stop"),), k, 0, epoch)
            writer.write("/impacts", stamp + delay, MAKE.event(event))
        for k in range(41):
            stamp = EPOCH + k * NS_PER_S // 10
            state = JointState(stamp, ("x",), np.array([float(k)]), np.zeros(1))
            writer.write("/plant/joint_states", stamp + delay, MAKE.joint_state(state))
    return path


def test_time_zero_is_the_epoch_else_the_first_impact_else_the_first_state(tmp_path: Path) -> None:
    """An epoch that is given comes before that of the events; a bag without any has no zero."""
    with BagReader(bag(tmp_path / "epoch")) as reader:
        assert time_zero(reader) == TimeZero(EPOCH, "the epoch")
        assert time_zero(reader, 7) == TimeZero(7, "the epoch")
    with BagReader(bag(tmp_path / "impacts", epoch=0)) as reader:
        assert time_zero(reader) == TimeZero(EPOCH + NS_PER_S, "the first impact")
    with BagReader(bag(tmp_path / "states", impacts=())) as reader:
        assert time_zero(reader) == TimeZero(EPOCH, "the first state")
    with BagWriter(tmp_path / "empty") as writer:
        writer.write("/plant/model", 1, MAKE.model("name: rig"))
    with BagReader(tmp_path / "empty") as reader, pytest.raises(UnfitBagError, match="time zero"):
        time_zero(reader)


def test_a_part_has_what_is_stamped_from_its_start_to_its_end(tmp_path: Path) -> None:
    """Both ends belong to it; the stamps of headers count, and not when they were recorded."""
    lines: list[str] = []
    with BagReader(bag(tmp_path / "bag", delay=10 * NS_PER_S)) as reader:
        part = read_part(reader, 0.5, 1.5, ["/impacts"], tell=lines.append)
        assert part is not None
        assert (part.low, part.high) == (EPOCH + NS_PER_S // 2, EPOCH + 2 * NS_PER_S)
        assert not part.is_late
        assert [each.sequence for each in reader.events()] == [1, 2]
        states = reader.joint_states("/plant/joint_states")
        assert states.q[:, 0].tolist() == [*range(5, 21)]
        assert reader.model_text() == "name: rig"
        assert time_zero(reader) == TimeZero(EPOCH)
        with reader.whole_bag():
            assert len([*reader.events()]) == 3
    assert lines == ["part: 0.5 s to 2 s after the epoch, 5.000000000 s"]


@pytest.mark.parametrize(
    ("start", "duration", "sequences", "is_late"),
    [
        (None, None, [1, 2, 3], None),
        (None, 1.5, [1], False),
        (1.5, None, [2, 3], True),
        (1.5, 0.7, [2], True),
        (1.0, 1e9, [1, 2, 3], False),
    ],
)
def test_start_and_duration_may_be_left_out(
    tmp_path: Path,
    start: float | None,
    duration: float | None,
    sequences: list[int],
    is_late: bool | None,
) -> None:
    """A part without a start begins with the bag, and one without a duration ends with it."""
    with BagReader(bag(tmp_path / "bag")) as reader:
        part = read_part(reader, start, duration, ["/impacts"])
        assert (None if part is None else part.is_late) == is_late
        assert [each.sequence for each in reader.events()] == sequences


@pytest.mark.parametrize(("start", "duration"), [(3.5, None), (1.1, 0.2), (1e9, 1e9)])
def test_a_part_without_a_message_names_the_stamps_that_there_are(
    tmp_path: Path, start: float, duration: float | None
) -> None:
    """States in the part do not help where impacts are needed."""
    expected = r"nothing on /impacts .* its stamps are 6\.000000000 to 8\.000000000 s; choose"
    with BagReader(bag(tmp_path / "bag")) as reader, pytest.raises(UsageError, match=expected):
        read_part(reader, start, duration, ["/impacts"])


def test_without_a_header_the_time_of_recording_counts(tmp_path: Path) -> None:
    """So for topics whose headers are of another clock, which the caller names."""
    closed = cast("Callable[..., object]", typestore().types["std_msgs/msg/Bool"])
    with BagWriter(tmp_path / "bag") as writer:
        writer.declare("/switch", type_name="std_msgs/msg/Bool")
        writer.declare("/imu/state", type_name="sensor_msgs/msg/JointState")
        for k in range(5):
            stamp = (k + 1) * NS_PER_S
            writer.write("/switch", stamp, closed(data=True))
            state = JointState(stamp + 10**15, ("x",), np.array([float(k)]), np.zeros(1))
            writer.write("/imu/state", stamp, MAKE.joint_state(state))
    zero = TimeZero(NS_PER_S, "the first message")
    with BagReader(tmp_path / "bag") as reader:
        read_part(reader, 1, 2, ["/switch"], zero=lambda _: zero, received=["/imu/state"])
        stamps = [log_time // NS_PER_S for log_time, _ in reader.messages("/switch")]
        assert stamps == [2, 3, 4]
        assert len([*reader.messages("/imu/state")]) == 3
    with BagReader(tmp_path / "bag") as reader:
        read_part(reader, 1, 2, ["/switch"], zero=lambda _: zero)
        assert not [*reader.messages("/imu/state")]
