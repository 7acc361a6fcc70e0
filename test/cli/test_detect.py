# SPDX-License-Identifier: Apache-2.0
"""detect: from a bag of sensors to one with impacts, and on to an estimate."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from impact_observer.cli.main import main
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io import BagReader, BagWriter, JointState, Quality
from impact_observer.io.messages import bag_messages, read_pulse
from impact_observer.io.recordings import events_in, model_of
from impact_observer.io.typestores import typestore
from impact_observer.model import read_model
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import grid

MS = 1_000_000
EPOCH = 1_000_000_000
TYPES = cast("dict[str, Callable[..., object]]", typestore().types)
BOOL, FLOAT, IMU = "std_msgs/msg/Bool", "std_msgs/msg/Float64", "sensor_msgs/msg/Imu"
HEADER = "std_msgs/msg/Header"


def scalar(type_name: str, value: float) -> object:
    """A Bool or a Float64."""
    return TYPES[type_name](data=bool(value) if type_name == BOOL else value)


def imu(stamp: int, acceleration: tuple[float, float, float]) -> object:
    """An Imu with an acceleration only."""
    zero = np.zeros(9)
    vector = TYPES["geometry_msgs/msg/Vector3"]
    return TYPES[IMU](
        header=TYPES[HEADER](stamp=bag_messages().time(stamp), frame_id=""),
        orientation=TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=zero,
        angular_velocity=vector(x=0.0, y=0.0, z=0.0),
        angular_velocity_covariance=zero,
        linear_acceleration=vector(*acceleration),
        linear_acceleration_covariance=zero,
    )


@dataclass
class Recording:
    """Messages to be recorded, by topic."""

    types: dict[str, str] = field(default_factory=dict)
    messages: list[tuple[int, str, object]] = field(default_factory=list)

    def add(self, topic: str, type_name: str, log_time: int, message: object) -> None:
        """Add a message; messages may come in any order of time."""
        self.types[topic] = type_name
        self.messages.append((log_time, topic, message))

    def write(self, path: Path) -> Path:
        """Write the bag, in order of time."""
        with BagWriter(path) as writer:
            for topic, type_name in self.types.items():
                writer.declare(topic, type_name=type_name, quality=Quality(reliable=False))
            for log_time, topic, message in sorted(self.messages, key=lambda item: item[:2]):
                writer.write(topic, log_time, message)
        return path


@pytest.fixture(scope="module")
def run() -> Run:
    """A run of two_mass over six seconds."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    return simulate(plant, grid(EPOCH, EPOCH + 6_000 * MS, 100.0))


@pytest.fixture(scope="module")
def rig_bag(run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, measured by a switch (5 ms late), a force (1 kHz) and an Imu (500 Hz)."""
    recording = Recording()
    impacts = np.array([event.stamp for event in run.events])
    for hit in impacts.tolist():
        for delay, value in ((5, 1.0), (10, 0.0)):
            recording.add("/switch", BOOL, hit + delay * MS, scalar(BOOL, value))
    for topic, rate in (("/force", 1000.0), ("/imu", 500.0)):
        stamps = grid(EPOCH, EPOCH + 6_100 * MS, rate)
        since = (stamps[:, None] - impacts) * 1e-9
        pulse = np.where(np.abs(since) < 0.005, np.cos(since * np.pi / 0.01), 0.0).sum(axis=1)
        for stamp, value in zip(stamps.tolist(), pulse.tolist(), strict=True):
            if topic == "/force":
                recording.add(topic, FLOAT, stamp, scalar(FLOAT, -80.0 * value))
            else:
                recording.add(topic, IMU, stamp + 2 * MS, imu(stamp, (50.0 * value, 0.0, -9.81)))
    make, names = bag_messages(), read_model("two_mass").system.coordinates
    for stamp, x in zip(run.stamps.tolist(), run.states, strict=True):
        state = make.joint_state(JointState(stamp, names, x[:2], x[2:]))
        recording.add("/plant/joint_states", "sensor_msgs/msg/JointState", stamp, state)
    return recording.write(tmp_path_factory.mktemp("rig") / "rig")


def detected(bag: Path, output: Path, *arguments: str) -> list[ImpactEvent]:
    """The events that the command finds."""
    assert main(["detect", str(bag), *arguments, "-o", str(output)]) == 0
    with BagReader(output) as reader:
        return events_in(reader)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--topic", "/switch", "--latency", "0.005"], 0),
        (["--topic", "/force", "--threshold", "20"], 0.01 * MS),
        pytest.param(["--topic", "imu", "--threshold", "20"], 0.02 * MS, marks=pytest.mark.slow),
        pytest.param(
            ["--topic", "/imu", "--field", "linear_acceleration.x", "--threshold", "20"],
            0.02 * MS,
            marks=pytest.mark.slow,
        ),
    ],
    ids=["switch", "force", "imu", "axis"],
)
def test_every_kind_of_sensor_gives_the_impacts_of_the_plant(
    rig_bag: Path, run: Run, tmp_path: Path, arguments: list[str], error: float
) -> None:
    """Switches are exact to the nanosecond, other sensors to a hundredth of a sample."""
    given = ["--contact", "stop", "--epoch", "1", *arguments]
    events = detected(rig_bag, tmp_path / "out", *given)
    assert [e.sequence for e in events] == list(range(1, len(run.events) + 1))
    assert {e.switches for e in events} == {(Switch("stop"),)}
    assert {e.epoch for e in events} == {EPOCH}
    late = [found.stamp - true.stamp for found, true in zip(events, run.events, strict=True)]
    assert np.abs(late).max() <= error


def test_how_late_peaks_are_is_printed(
    rig_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A half-wave of 10 ms is at a quarter of its top 4.2 ms before it, a sample more or less."""
    detected(
        rig_bag, tmp_path / "out", "--contact", "stop", "--topic", "/force", "--threshold", "20"
    )
    head, row, *_ = capsys.readouterr().out.splitlines()
    assert head.endswith("late [ms]")
    assert 4.19 - 1.0 < float(row.split()[-1]) <= 4.2


@pytest.mark.slow
def test_a_detected_bag_can_be_observed_without_naming_a_model(
    rig_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Truth and sensors are copied, the model is added; the estimate converges."""
    bag, output = tmp_path / "detected", tmp_path / "observed"
    given = ["--contact", "stop", "--topic", "/switch", "--latency", "0.005"]
    events = detected(rig_bag, bag, *given, "--model", "two_mass", "--epoch", "1")
    row = capsys.readouterr().out.splitlines()[1]
    assert row.split()[:5] == ["stop", "/switch,", "switch", "0.005", str(len(events))]
    with BagReader(bag) as reader, BagReader(rig_bag) as source:
        assert model_of(reader).system.name == "two_mass"
        assert set(reader.topics) == {*source.topics, "/impacts", "/plant/model"}
        assert list(reader.raw(source.topics)) == list(source.raw())
        assert reader.topics["/imu"].quality == Quality(reliable=False)
        assert [m.log_time for m in reader.raw(["/impacts"])] == [e.stamp + 5 * MS for e in events]
    assert main(["observe", str(bag), "--initial-state", "random:1", "-o", str(output)]) == 0
    with BagReader(output) as reader:
        states = reader.observer_states("/observer/state")
        truth = reader.joint_states("/plant/joint_states")
    differences = np.abs(states.q - truth.q).max(axis=1)
    assert differences[-1] < 0.2 * differences[0]


def test_a_file_declares_several_sensors_and_missing_ones_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A contact that is closed at the end, one without messages, one without a topic."""
    recording = Recording()
    for t, value in ((100, 1.0), (400, 0.0), (500, 1.0)):
        recording.add("/floor", BOOL, EPOCH + t * MS, scalar(BOOL, value))
    recording.add("/weak", FLOAT, EPOCH + 30 * MS, scalar(FLOAT, 0.25))
    recording.add("/weak", FLOAT, EPOCH + 900 * MS, scalar(FLOAT, -0.5))
    sources = tmp_path / "rig.yaml"
    sources.write_text(
        "sources:\n- {contact: floor, topic: floor}\n"
        "- {contact: wall, topic: /weak, threshold: 2}\n- {contact: roof, topic: /none}\n",
        encoding="utf-8",
    )
    bag = recording.write(tmp_path / "bag")
    events = detected(bag, tmp_path / "out", "--sources", str(sources))
    found = [(e.sequence, (e.stamp - EPOCH) // MS, e.switches[0].kind) for e in events]
    assert sorted(found) == [
        (1, 100, Kind.IMPACT),
        (2, 100, Kind.CLOSE),
        (3, 400, Kind.OPEN),
        (4, 500, Kind.IMPACT),
        (5, 500, Kind.CLOSE),
    ]
    lines = capsys.readouterr().out.splitlines()
    weak = "no impact in 2 messages on /weak, at most 0.5 of the threshold 2"
    assert [line.split() for line in lines[1:3]] == [
        ["floor", "/floor,", "switch", "0.005", "2", "2", "0", "0"],
        ["wall", "/weak,", "peak", "0.02", "0", "0", "0", "0"],
    ]
    assert lines[3:] == [
        f"{tmp_path / 'out'}: 5 events",
        "warning: roof: no topic /none",
        f"warning: wall: {weak}",
    ]


def test_messages_of_a_clock_that_steps_back_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An accelerometer whose clock is 3 s back for a third of the time loses a third of it."""
    recording = Recording()
    for k in range(1500):
        stamp = EPOCH + 4_000 * MS + k * MS - (3_000 * MS if 500 <= k < 1000 else 0)
        peak = 80.0 if k in (300, 700, 1200) else 0.0
        recording.add("/imu", IMU, EPOCH + 4_000 * MS + k * MS, imu(stamp, (0.0, 0.0, peak)))
    given = ["--contact", "stop", "--topic", "/imu", "--threshold", "30"]
    events = detected(recording.write(tmp_path / "bag"), tmp_path / "out", *given)
    assert len(events) == 2
    warning = "warning: stop: 500 of 1500 messages on /imu left out (33 %): stamped before"
    assert warning in capsys.readouterr().out


def test_impacts_of_the_bag_make_way_for_those_that_are_found(
    sample_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Any message may be an impact: here each true state outside the dead time is one."""
    sources = tmp_path / "sources.yaml"
    sensor = "{contact: stop, topic: /plant/joint_states, kind: arrival, dead_time: 0.1}"
    sources.write_text(f"sources: [{sensor}]", encoding="utf-8")
    events = detected(sample_bag, tmp_path / "out", "--sources", str(sources))
    assert [(e.stamp - EPOCH) // MS for e in events] == [0, 100, 200, 300, 400, 500]
    assert " messages on /impacts are left out for the impacts found" in capsys.readouterr().out
    with BagReader(tmp_path / "out") as reader:
        assert model_of(reader).provenance["seed"] == 7


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        ([], 2, "no sensor named; give --sources, or --contact and --topic"),
        (["--contact", "stop"], 2, "no sensor named"),
        (["--sources", "switch", "--field", "x"], 2, "--field"),
        (["--sources", "no.yaml"], 2, "no.yaml"),
        (["--contact", "stop", "--topic", "/none"], 2, "stop"),
        (["--contact", "stop", "--topic", "/force"], 2, "kind: is missing, as /force is std_msgs"),
        (["--contact", "stop", "--topic", "/imu"], 2, "threshold"),
        (["--contact", "roof", "--topic", "/switch", "--model", "two_mass"], 2, "contact"),
        (
            ["--contact", "stop", "--topic", "/force", "--threshold", "500"],
            1,
            "no impact found; stop: no impact in 6101 messages on /force, at most 80 of",
        ),
        (
            ["--contact", "stop", "--topic", "/imu", "--field", "force", "--threshold", "1"],
            2,
            "field",
        ),
    ],
)
def test_a_failed_detection_is_one_line_and_leaves_no_bag(
    rig_bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    *,
    arguments: list[str],
    code: int,
    expected: str,
) -> None:
    """The error says what was found and what is expected."""
    output = tmp_path / "out"
    assert main(["detect", str(rig_bag), *arguments, "-o", str(output)]) == code
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert expected in errors[0]
    assert not output.exists()


def test_a_missing_epoch_is_a_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The forcing of the model depends on time."""
    recording = Recording()
    for t, value in ((0, 0.0), (3100, 1.0), (3110, 0.0)):
        recording.add("/switch", BOOL, EPOCH + t * MS, scalar(BOOL, value))
    bag = recording.write(tmp_path / "bag")
    given = ["--contact", "stop", "--topic", "/switch", "--model", "two_mass"]
    for name, arguments, count in (("right", ["--epoch", "1"], 0), ("none", [], 1)):
        detected(bag, tmp_path / name, *given, *arguments)
        said = capsys.readouterr().out.splitlines()
        warnings = [each for each in said if each.startswith("warning: ")]
        assert len(warnings) == count
        assert all("epoch" in each for each in warnings)


def with_tacho(path: Path) -> Path:
    """A switch that closes at 3 s, and a tachometer with a pulse at 1.25 s and one at 2.5 s."""
    recording = Recording()
    for stamp, closed in ((2000, False), (3000, True), (3010, False), (4000, True)):
        recording.add("/switch", BOOL, stamp * MS, scalar(BOOL, closed))
    for stamp in (1250, 2500):
        recording.add("/tacho", HEADER, stamp * MS, bag_messages().pulse(stamp * MS))
    return recording.write(path)


def test_pulses_of_another_topic_say_the_epoch_and_drive_the_observer(tmp_path: Path) -> None:
    """The pulses are in the new bag under the name by which observers know pulses."""
    bag, made = with_tacho(tmp_path / "bag"), tmp_path / "made"
    given = ["--contact", "stop", "--topic", "/switch", "--model", "two_mass"]
    assert main(["detect", str(bag), *given, "--pulses", "tacho", "-o", str(made)]) == 0
    with BagReader(made) as reader:
        assert {each.epoch for each in events_in(reader)} == {1250 * MS}
        pulses = [read_pulse(message) for _, message in reader.messages("/phase_reference")]
    assert pulses == [1250 * MS, 2500 * MS]


@pytest.mark.parametrize(("topic", "said"), [("/index", "pulses"), ("/switch", "pulses")])
def test_pulses_that_are_none_are_refused(
    topic: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line says what was found, and no bag is made."""
    bag, made = with_tacho(tmp_path / "bag"), tmp_path / "made"
    given = ["--contact", "stop", "--topic", "/switch", "--pulses", topic, "-o", str(made)]
    assert main(["detect", str(bag), *given]) == 2
    assert said in capsys.readouterr().err
    assert not made.exists()
