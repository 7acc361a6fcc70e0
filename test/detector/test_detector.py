# SPDX-License-Identifier: Apache-2.0
"""The detector of all sensors: numbering, stamps, latency, ignored messages, declarations."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from signals import (
    BOOL,
    FLOAT,
    MS,
    START,
    Scalar,
    Stamped,
    Vector3,
    detections,
    events,
    header,
    peak,
    switch,
)

from impact_observer.detector import Detector, Source, parse_sources, read_sources
from impact_observer.detector.source import IMU
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.message_fields import header_stamp, numbers_at, parse_path


def two_switches(epoch: int = 0) -> Detector:
    """A detector with one switch on the floor and one on the ceiling."""
    declared = (Source("floor", "/a"), Source("ceiling", "/b", min_contact_duration=0.03))
    return Detector([each.complete(BOOL) for each in declared], epoch=epoch)


def test_events_of_all_sensors_share_one_sequence() -> None:
    """Persistent contacts have sequence numbers in the order in which they were decided."""
    detector = two_switches(epoch=7)
    detected = detector.feed(0, Scalar(1.0), START)
    detected += detector.feed(1, Scalar(1.0), START + 10 * MS)
    detected += detector.advance(START + 500 * MS)
    assert [d.event for d in detected] == [
        ImpactEvent(START, (Switch("floor"),), 1, 0, 7),
        ImpactEvent(START + 10 * MS, (Switch("ceiling"),), 2, 0, 7),
        ImpactEvent(START + 10 * MS, (Switch("ceiling", Kind.CLOSE),), 3, 0, 7),
        ImpactEvent(START, (Switch("floor", Kind.CLOSE),), 4, 0, 7),
    ]
    assert [d.decided for d in detected] == sorted(d.decided for d in detected)


def test_a_restart_is_a_new_episode_without_state() -> None:
    """After a restart every contact is open, and sequence numbers begin at 1."""
    detector = two_switches()
    detector.feed(0, Scalar(1.0), START)
    detector.restart()
    assert detector.advance(START + 500 * MS) == []
    (detected,) = detector.feed(0, Scalar(1.0), 5)
    assert detected.event == ImpactEvent(5, (Switch("floor"),), 1, 1)


@pytest.mark.parametrize("latency", [0.0123, -0.0123])
def test_the_latency_is_subtracted_from_stamps_and_not_from_durations(latency: float) -> None:
    """All three events of a closure are stamped earlier by the latency; later if negative."""
    signal = [(START, 1.0), (START + 60 * MS, 1.0), (START + 70 * MS, 0.0)]
    plain = detections(switch(), signal)
    early = detections(switch(latency=latency), signal)
    assert [d.decided for d in early] == [d.decided for d in plain]
    moved = [(stamp - round(latency * 1e9), kind) for stamp, kind in events(plain)]
    assert events(early) == moved


def test_stamps_are_those_of_headers_by_default() -> None:
    """A header with stamp 0 is replaced by the time of reception."""
    for given, sent, wanted in (
        (None, START, START),
        (None, 0, START + 5 * MS),
        ("receive", START, START + 5 * MS),
    ):
        source = Source("stop", "/hit", kind="arrival", stamp=given).complete("x/msg/Y")
        (detected,) = Detector([source]).feed(0, Stamped(header(sent)), START + 5 * MS)
        assert detected.event.stamp == wanted
    source = Source("stop", "/hit", kind="arrival", stamp="header").complete("x/msg/Y")
    with pytest.raises(UsageError, match="stamp"):
        Detector([source]).feed(0, Stamped(header(0)), START)


def test_late_messages_of_a_switch_count_by_their_own_stamps() -> None:
    """A closure of 10 ms whose end comes 55 ms late is short; one of 60 ms is long."""
    source = Source("stop", "/s", kind="switch", field="data[0]").complete("x/msg/Y")

    def kinds(length: int, delay: int) -> list[Kind]:
        detector = Detector([source])
        first = detector.feed(0, Stamped(header(START), data=[1]), START)
        end = START + length * MS
        last = detector.feed(0, Stamped(header(end), data=[0]), end + delay * MS)
        return [kind for _, kind in events(first + last)]

    assert kinds(10, 55) == [Kind.IMPACT]
    assert kinds(60, 1) == [Kind.IMPACT, Kind.CLOSE, Kind.OPEN]


def test_invalid_messages_are_counted_and_reported() -> None:
    """Non-finite numbers, stamps that go back and events stamped before 0 are counted."""
    detector = Detector([peak(10.0, latency=5.0)])
    values = [(2, 0.0), (3, float("nan")), (4, 50.0), (5, 0.0), (1, 0.0)]
    detected = [d for s, v in values for d in detector.feed(0, Scalar(v), s * 1_000_000_000)]
    assert detected == []
    count = detector.counts[0]
    assert (count.messages, count.invalid, count.out_of_order, count.impacts) == (5, 2, 1, 0)
    stamped = Detector([Source("stop", "/hit", kind="arrival").complete("x/msg/Y")])
    for stamp in (START, START - 1, START):
        stamped.feed(0, Stamped(header(stamp)), START)
    assert stamped.counts[0].out_of_order == 1
    assert stamped.problem(0) == "stop: 1 stamps out of order"
    why = "stamped before an earlier one, as by a clock that steps back"
    assert stamped.left_out(0) == [f"stop: 1 of 3 messages on /hit left out (33 %): {why}"]


def test_an_array_that_is_sometimes_too_short_is_ignored() -> None:
    """A missing member is an error only if no message had the member."""
    source = Source("stop", "/t", field="data[1]", threshold=1.0).complete("x/msg/Y")
    detector = Detector([source])
    for k, data in enumerate(([0.0, 0.0], [0.0], [0.0, 0.0])):
        detector.feed(0, Stamped(header(START + k), data=data), START + k)
    assert (detector.counts[0].messages, detector.counts[0].invalid) == (3, 1)


def test_a_message_that_differs_from_those_before_is_invalid() -> None:
    """A stamp that is zero or negative, no stamp, a vector instead of a number, no number."""
    source = Source("stop", "/s", field="data", threshold=1.0, direction="up", stamp="header")
    detector = Detector([source.complete("x/msg/Y")])
    good = [Stamped(header(START + k), data=[5.0 * (k == 1)]) for k in range(3)]
    bad = [Stamped(header(0), data=[0.0]), Stamped(header(-START), data=[0.0]), Scalar(1.0)]
    bad += [Stamped(header(START + 9), data=data) for data in ([0.0, 0.0], [])]
    with pytest.raises(UsageError, match="stamp"):
        detector.feed(0, bad[0], START)
    for each in (*good, *bad):
        detector.feed(0, each, START + 9)
    assert (detector.counts[0].messages, detector.counts[0].invalid) == (9, 6)
    assert detector.counts[0].impacts == 1


def test_a_source_of_another_type_goes_on_with_the_counts_of_its_contact() -> None:
    """A switch becomes a sensor whose messages are impacts."""
    declared = Source("stop", "/s")
    detector = Detector([declared.complete("std_msgs/msg/Bool")])
    detector.feed(0, Scalar(1.0), START)
    detector.change_source(0, declared.complete("std_msgs/msg/Empty"))
    (detected,) = detector.feed(0, object(), START + 500 * MS)
    assert (detected.event.stamp, detected.event.sequence) == (START + 500 * MS, 2)
    assert detector.counts[0].impacts == 2


def test_the_same_source_again_changes_nothing() -> None:
    """A closure goes on: its end is no second impact."""
    detector = two_switches()
    detector.feed(0, Scalar(1.0), START)
    detector.change_source(0, detector.sources[0])
    (detected,) = detector.feed(0, Scalar(1.0), START + 500 * MS)
    assert detected.event.switches == (Switch("floor", Kind.CLOSE),)


def test_the_memory_of_a_detector_does_not_grow() -> None:
    """A pickled detector has the same size after a hundred impacts as after ten."""
    sizes = []
    detector = Detector([switch(), replace(peak(10.0, baseline=1.0), contact="wall")])
    for k in range(4000):
        stamp = START + k * 5 * MS
        for index in (0, 1):
            detector.feed(index, Scalar(20.0 * (k % 40 == 20)), stamp)
        if k in {400, 3999}:
            sizes.append(len(pickle.dumps(detector)))
    assert [count.impacts for count in detector.counts] == [100, 100]
    assert sizes[1] <= sizes[0] + 16


def test_a_sensor_without_impacts_reports_its_largest_signal() -> None:
    """The user can choose a threshold by the largest signal."""
    detector = Detector([peak(10.0)])
    assert detector.problem(0) == "stop: no message on /force"
    detector.feed(0, Scalar(-7.5), START)
    assert detector.problem(0) == (
        "stop: no impact in 1 messages on /force, at most 7.5 of the threshold 10"
    )


def test_a_signal_above_its_threshold_from_the_first_sample_on_asks_for_a_baseline() -> None:
    """Its largest value is named."""
    detector = Detector([peak(10.0)])
    detector.feed(0, Scalar(12.0), START)
    assert detector.no_impact(0).endswith(
        "at most 12 of the threshold 10; it stays above: declare a baseline, or a higher threshold"
    )


@pytest.mark.parametrize(
    ("key", "value"),
    [("contact", ""), ("topic", ""), ("threshold", np.inf), ("hysteresis", np.nan)],
)
def test_a_source_that_cannot_be_is_an_error_that_names_its_key(key: str, value: object) -> None:
    """An empty name, and numbers that no signal reaches."""
    given: dict[str, Any] = {"contact": "stop", "topic": "/s", key: value}
    with pytest.raises(UsageError, match=f"^{key}: .*expected"):
        Source(**given)


def test_fields_are_named_by_paths() -> None:
    """Paths lead to numbers, vectors and members of lists and NumPy arrays."""
    message = Stamped(header(START), Vector3(1.0, 2.0, 3.0), np.array([4.0, 5.0]))
    for text, wanted in (
        ("force.z", (3.0,)),
        ("force", (1.0, 2.0, 3.0)),
        ("data[1]", (5.0,)),
        ("data", (4.0, 5.0)),
        ("header.stamp.sec", (1.0,)),
    ):
        assert numbers_at(message, parse_path(text)) == wanted
    assert numbers_at(Scalar(True), parse_path("data")) == (1.0,)
    assert header_stamp(message) == header_stamp(message.header) == START
    assert header_stamp(Scalar(1.0)) is None


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("torque", "the message has no torque; its fields: header, force, data, label"),
        ("force.w", "force has no w; its fields: x, y, z"),
        ("data[2]", r"data has 2 members, so it has no \[2\]"),
        ("force[0]", r"force has no members, so it has no \[0\]"),
        ("label", "label holds no number"),
        ("header", "header holds no number; its fields: stamp, frame_id"),
    ],
)
def test_a_field_that_is_not_there_is_named_with_those_that_are(path: str, expected: str) -> None:
    """The error is one line with the topic."""
    source = Source("stop", "/w", field=path, threshold=1.0, origin="rig.yaml: sources[0].")
    detector = Detector([source.complete("x/msg/Y")])
    message = Stamped(header(START), data=[1.0, 2.0])
    with pytest.raises(UsageError, match=rf"rig\.yaml: sources\[0\]\.field: /w: {expected}"):
        detector.feed(0, message, START)


@pytest.mark.parametrize(
    ("declared", "type_name", "kind"),
    [
        ({}, BOOL, "switch"),
        ({"threshold": 5.0}, IMU, "peak"),
        ({"threshold": 5.0}, FLOAT, "peak"),
        ({}, "std_msgs/msg/Empty", "arrival"),
        ({}, "std_msgs/msg/Header", "arrival"),
        ({"kind": "arrival"}, IMU, "arrival"),
    ],
)
def test_the_kind_is_guessed_from_the_type(
    declared: dict[str, object], type_name: str, kind: str
) -> None:
    """A source without a kind gets the kind that fits the message type and the threshold."""
    source = Source("stop", "/t", **declared).complete(type_name)  # type: ignore[arg-type]
    assert source.kind == kind


MISTAKES: list[tuple[str, str, str]] = [
    ("sources: []", FLOAT, "sources"),
    ("[1, 2]", FLOAT, "[1, 2] found"),
    ("sources: {", FLOAT, "is not YAML at line"),
    ("sources: [{topic: t}]", FLOAT, "sources[0].contact: is missing"),
    ("sources: [{contact: c}]", FLOAT, "sources[0].topic: is missing"),
    ("sources: [{contact: c, topic: 3}]", FLOAT, "sources[0].topic"),
    ("sources: [{contact: c, topic: a b}]", BOOL, "sources[0].topic"),
    ("sources: [{contact: c, topic: t, x: 1}]", FLOAT, "sources[0].x: is not known here"),
    ("sources: [{contact: c, topic: t}]", FLOAT, "sources[0].kind: is missing, as t is std_msgs"),
    ("sources: [{contact: c, topic: t}]", IMU, "sources[0].threshold"),
    *(
        (f"sources: [{{contact: c, topic: t, {given}}}]", BOOL, f"sources[0].{expected}")
        for given, expected in (
            ("kind: magic", "kind"),
            ("stamp: now", "stamp"),
            ("inverted: 1", "inverted"),
            ("latency: -11", "latency"),
            ("dead_time: 11", "dead_time"),
            ("latency: .nan", "latency"),
            ("dead_time: soon", "dead_time"),
            ("hysteresis: -1", "hysteresis"),
            ("field: a..b", "field"),
            ("direction: up", "direction"),
            ("kind: arrival, field: x", "field: does not go with kind arrival"),
            ("kind: peak, threshold: 0", "threshold"),
            ("kind: peak, threshold: 1, hysteresis: 1", "hysteresis"),
            ("min_contact_duration: 0.001", "min_contact_duration"),
        )
    ),
    ("sources: [{contact: c, topic: t}, {contact: c, topic: s}]", BOOL, "sources[1].contact"),
]


@pytest.mark.parametrize(("text", "type_name", "expected"), MISTAKES)
def test_a_mistake_in_a_file_is_one_line_that_names_it(
    text: str, type_name: str, expected: str
) -> None:
    """The error names the file, the key, the value and the expectation."""
    with pytest.raises(UsageError) as caught:
        [source.complete(type_name) for source in parse_sources(text, "rig.yaml")]
    assert str(caught.value).startswith(f"rig.yaml: {expected}")
    assert len(str(caught.value).splitlines()) == 1


def test_the_sample_file_is_a_switch_at_its_defaults(tmp_path: Path) -> None:
    """The sample file has the default values; ``table``, of ``detect``, changes nothing."""
    (source,) = read_sources("switch")
    plain = Source("stop", "switch").complete(BOOL)
    assert source.complete(BOOL) == plain
    copied = tmp_path / "mine.yaml"
    text = "sources: [{contact: stop, topic: switch}]\ntable: {time_unit: ms}\n"
    copied.write_text(text, encoding="utf-8")
    assert read_sources(copied)[0].complete(BOOL) == plain


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        (
            lambda folder: folder / "no.yaml",
            "no such file; expected a file of sensors, or a sample",
        ),
        (lambda folder: folder, "a folder; expected"),
    ],
    ids=["missing", "folder"],
)
def test_a_file_that_is_not_there_is_one_line(
    tmp_path: Path, name: Callable[[Path], Path], expected: str
) -> None:
    """The error names the samples."""
    with pytest.raises(
        UsageError, match=f"{expected}.*switch$" if "sample" in expected else expected
    ):
        read_sources(name(tmp_path))
