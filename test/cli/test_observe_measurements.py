# SPDX-License-Identifier: Apache-2.0
"""simulate and observe with sensors beside the impacts, through bags."""

import io
import json
import re
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pytest

from impact_observer.cli.main import main
from impact_observer.io import BagReader, BagWriter
from impact_observer.io.measured_samples import samples_in
from impact_observer.io.messages import read_estimate
from impact_observer.model import read_model
from impact_observer.model.measurement import read_measurements
from impact_observer.resources import shared
from impact_observer.stamps import NS_PER_S

RIG = """\
measurements:
  - {name: encoder, topic: /encoder, joint: x1, quantity: position, deviation: 0.001}
  - {name: laser, topic: /laser, field: range, position: {x2: -1}, offset: 0.5, deviation: 0.002,
     delay: 0.01}
  - {name: imu, topic: /imu, field: linear_acceleration.x, acceleration: {x2: 1}, deviation: 0.3}
  - {name: probe, topic: /probe, field: data, gap: stop, deviation: 0.001}
"""
ENCODER = "\n".join(RIG.splitlines()[:2])
MINIMUM = ("--law", "minimum-variance", "--clock-error", "0.001")


def simulated(folder: Path, name: str, *arguments: str, sensors: str = RIG) -> Path:
    """A bag with three seconds of two_mass and the sensors of ``rig.yaml``."""
    (folder / "rig.yaml").write_text(sensors)
    bag = folder / name
    given = ["--measurements", str(folder / "rig.yaml"), "--duration", "3", "--seed", "3"]
    assert main(["simulate", "two_mass", *given, *arguments, "-o", str(bag)]) == 0
    return bag


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with three seconds at 50 Hz."""
    return simulated(tmp_path_factory.mktemp("measured"), "plant", "--measurement-rate", "50")


@pytest.fixture(scope="module")
def observed(bag: Path) -> tuple[Path, str]:
    """What observe makes of this bag with its sensors, and what is printed."""
    output = bag.parent / "observed"
    given = [*MINIMUM, "--measurements", str(bag.parent / "rig.yaml"), "-o", str(output)]
    with redirect_stdout(io.StringIO()) as printed:
        assert main(["observe", str(bag), *given]) == 0
    return output, printed.getvalue()


def test_simulated_sensors_measure_what_their_file_says(bag: Path) -> None:
    """Sums of coefficients of the true states, noise as declared, stamps late by the delay."""
    sensors = read_measurements(bag.parent / "rig.yaml")
    with BagReader(bag) as reader:
        samples, problems, *_ = samples_in(reader, sensors)
        arrivals = [log_time for log_time, _ in reader.messages("/laser")]
        truth = reader.joint_states(reader.truth_topic() or "")
        types = {topic: info.type for topic, info in reader.topics.items()}
    assert not problems
    assert types["/laser"] == "sensor_msgs/msg/Range"
    assert types["/imu"] == "sensor_msgs/msg/Imu"
    assert types["/probe"] == "std_msgs/msg/Float64"
    system = read_model("two_mass").system
    at = {stamp: i for i, stamp in enumerate(truth.stamps.tolist())}
    expected = np.array(
        [truth.q[:, 0], 0.5 - truth.q[:, 1], 0 * truth.q[:, 0], 0.5 - truth.q[:, 1]]
    )
    for k, deviation in ((0, 1e-3), (1, 2e-3), (3, 1e-3)):
        own = [each for each in samples if each.sensor == k]
        errors = [each.value - expected[k, at[each.stamp]] for each in own]
        assert len(own) == 151
        assert np.std(errors) == pytest.approx(deviation, rel=0.25)
    of_laser = [each.stamp for each in samples if each.sensor == 1]
    late = {a - stamp for stamp, a in zip(of_laser, arrivals, strict=True)}
    assert late == {NS_PER_S // 100}
    forces = system.forcing.derivatives(np.array([0.02]), 0)[0][0]
    i = at[NS_PER_S + NS_PER_S // 50]
    q, u = truth.q[i], truth.u[i]
    acceleration = np.linalg.solve(system.M, forces - system.K @ q - system.C @ u)[1]
    (imu,) = (s for s in samples if s.sensor == 2 and s.stamp == NS_PER_S + NS_PER_S // 50)
    assert imu.value == pytest.approx(acceleration, abs=1.5)


@pytest.mark.slow
def test_observe_uses_them_copies_them_and_says_what_became_of_them(
    observed: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The result has verdicts up to 50 Hz, and can be observed again, with equal bits."""
    (once, said), twice = observed, tmp_path / "twice"
    given = [*MINIMUM, "--measurements", str(once.parent / "rig.yaml"), "-o", str(twice)]
    assert main(["observe", str(once), *given]) == 0
    for text in (said, capsys.readouterr().out):
        assert re.search(r"encoder +151 +\d+ ", text)
        assert "warning" not in text
    with BagReader(once) as one, BagReader(twice) as two:
        found, again = (each.observer_states("/observer/state") for each in (one, two))
        verdicts = [message for _, message in one.messages("/observer/measurements")]
        truth = one.joint_states(one.truth_topic() or "")
    np.testing.assert_array_equal(found.q, again.q)
    np.testing.assert_array_equal(found.u, again.u)
    assert len(verdicts) == 4 * 151
    assert {each.name for each in verdicts} == {"encoder", "laser", "imu", "probe"}
    assert np.std([each.normalized for each in verdicts if each.accepted]) < 1.0
    assert np.max(np.abs(found.q[-50:] - truth.q[-50:])) < 2e-3


@pytest.mark.slow
def test_verdicts_of_fast_sensors_are_not_written(tmp_path: Path) -> None:
    """At 60 Hz there are none; the file of 50 Hz has one for each sample."""
    bag = simulated(tmp_path, "plant", "--measurement-rate", "60", sensors=ENCODER)
    given = ["--measurements", str(tmp_path / "rig.yaml"), "-o", str(tmp_path / "out")]
    assert main(["observe", str(bag), *given]) == 0
    with BagReader(tmp_path / "out") as reader:
        assert "/observer/measurements" not in reader.topics


@pytest.mark.parametrize(
    "wrong",
    [
        ("{name: a, topic: /none, joint: x1, quantity: position, deviation: 1}", 2, "no /none in"),
        ("{name: a, topic: /laser, joint: x1, quantity: position, deviation: 1}", 2, "no joints"),
        (("{name: a, topic: /encoder, joint: x7, quantity: position, position: {x1: 1},"
         " deviation: 1}"), 2, "no position of 'x7' on /encoder; joints in its first message: x1"),
        ("{name: a, topic: /laser, field: ranges, gap: stop, deviation: 1}", 2, "has no ranges"),
        ("{name: a, topic: /imu, field: linear_acceleration, gap: stop, deviation: 1}", 2,
         "3 numbers; name one"),
        ("{name: a, topic: /probe, field: data, gap: wall, deviation: 1}", 2, "no contact of two"),
        ("{name: a, topic: /probe, field: data, gap: stop, deviation: 1, stamp: header}", 2,
         "has no stamp in one; expected receive"),
    ],
)  # fmt: skip
def test_what_a_bag_does_not_have_is_one_line(
    bag: Path, tmp_path: Path, wrong: tuple[str, int, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Topic, type, joint, field, contact or stamp are wrong; no bag is written."""
    line, code, error = wrong
    (tmp_path / "wrong.yaml").write_text(f"measurements: [{line}]\n")
    given = ["--measurements", str(tmp_path / "wrong.yaml"), "-o", str(tmp_path / "out")]
    assert main(["observe", str(bag), *given]) == code
    (text,) = capsys.readouterr().err.splitlines()
    assert error in text
    assert not (tmp_path / "out").exists()


@pytest.fixture
def encoder(tmp_path: Path) -> str:
    """A file of the encoder alone."""
    (tmp_path / "encoder.yaml").write_text(ENCODER)
    return str(tmp_path / "encoder.yaml")


def with_nan(source: Path, output: Path) -> Path:
    """A copy of a bag whose encoder has no number in one message."""
    is_due = True
    with BagReader(source) as reader, BagWriter(output) as writer:
        for topic, info in reader.topics.items():
            writer.declare(topic, type_name=info.type, quality=info.quality)
        decode = reader.decoder("/encoder")
        for raw in reader.raw():
            if raw.topic != "/encoder":
                writer.write_raw(*raw)
                continue
            message = decode(raw.data)
            if is_due and raw.log_time > 2 * NS_PER_S:
                message.position, is_due = np.array([np.nan]), False
            writer.write(raw.topic, raw.log_time, message)
    return output


@pytest.mark.slow
def test_one_stamp_that_is_far_off_is_left_out(
    bag: Path, encoder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sample with such a stamp would make the observer forget all earlier history."""
    source = tmp_path / "odd"
    with BagReader(bag) as reader, BagWriter(source) as writer:
        for topic, info in reader.topics.items():
            writer.declare(topic, type_name=info.type, quality=info.quality)
        decode, odd = reader.decoder("/encoder"), False
        for raw in reader.raw():
            message = decode(raw.data) if raw.topic == "/encoder" else None
            if message is None or odd or raw.log_time < 2 * NS_PER_S:
                writer.write_raw(*raw)
                continue
            message.header.stamp.sec, odd = 2_000_000_000, True
            writer.write(raw.topic, raw.log_time, message)
    output = str(tmp_path / "out")
    given = [*MINIMUM, "--measurements", encoder, "-o", output]
    assert main(["observe", str(source), *given]) == 0
    text = capsys.readouterr().out
    part = "1 of 151 messages on /encoder left out (0.66 %)"
    assert f"warning: encoder: {part}: stamped far from all others" in text
    assert re.search(r"encoder +150 +150 ", text)


def test_a_number_that_is_none_is_left_out(
    bag: Path, encoder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One sample of the encoder is left out; all others are used."""
    source = with_nan(bag, tmp_path / "nan")
    output = str(tmp_path / "out")
    given = [*MINIMUM, "--measurements", encoder, "-o", output]
    assert main(["observe", str(source), *given]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"encoder +151 +150 +0 +0 +1 ", printed)
    part = "1 of 151 messages on /encoder left out (0.66 %)"
    assert f"warning: encoder: {part}: no finite number" in printed


@pytest.mark.slow
def test_a_law_without_covariance_says_that_it_uses_no_measurements(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command prints one warning."""
    given = ["--law", "geometric", "--measurements", str(bag.parent / "rig.yaml")]
    assert main(["observe", str(bag), *given, "-o", str(tmp_path / "out")]) == 0
    line = "warning: geometric uses no measurements: encoder, laser, imu, probe left out; --law"
    assert line in capsys.readouterr().out


def test_what_cannot_be_simulated_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A field of no known type, a deviation that is no number, faults of nothing."""
    for name, field, size in (("a", "odd.x", 1), ("b", "data", "learn"), ("c", "'data[0]'", 1)):
        each = f"name: {name}, topic: /{name}, field: {field}, gap: stop, deviation: {size}"
        (tmp_path / f"{name}.yaml").write_text(f"measurements: [{{{each}}}]")
    for given, error in (
        (["--measurements", str(tmp_path / "a.yaml")], "a.yaml: measurements[0].field: odd.x"),
        (["--measurements", str(tmp_path / "c.yaml")], "c.yaml: measurements[0].field: /c: data"),
        (["--measurements", str(tmp_path / "b.yaml")], "b.yaml: measurements[0].deviation: learn"),
        (["--measurement-rate", "0.1"], "measurement_rate: given without --measurements"),
    ):
        output = str(tmp_path / "out")
        assert main(["simulate", "two_mass", *given, "--duration", "1", "-o", output]) == 2
        (text,) = capsys.readouterr().err.splitlines()
        assert error in text


def test_compare_shows_how_many_samples_were_used(
    bag: Path, observed: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Counts are those of the observer; tables of bags without sensors have no such columns."""
    output, plain = str(observed[0]), str(tmp_path / "plain")
    lines = observed[1].splitlines()
    (head,) = [k for k, line in enumerate(lines) if line.startswith("sensor ")]
    rows = [line.split() for line in lines[head + 1 : head + 5] if len(line.split()) == 7]
    samples, used = [int(row[1]) for row in rows], [int(row[2]) for row in rows]
    assert main(["compare", output, "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out).values()
    assert found["measurements_used"] == sum(used) > 0
    assert found["measurements_used"] + found["measurements_not_used"] == sum(samples)
    assert main(["compare", output]) == 0
    assert "measured" in capsys.readouterr().out
    assert main(["observe", str(bag), "-o", plain]) == 0
    capsys.readouterr()
    assert main(["compare", plain]) == 0
    assert "measured" not in capsys.readouterr().out


@pytest.mark.slow
def test_a_sweep_measures_in_every_case(tmp_path: Path) -> None:
    """With an encoder the minimum-variance estimate is better; cases differ by their noise."""
    parquet = pytest.importorskip("pyarrow.parquet")
    ends = []
    for given in ([], ["--measurements", "encoder"]):
        output = str(tmp_path / f"{len(given)}.parquet")
        wanted = ["two_mass", "--laws", "minimum-variance", "--runs", "2", "--duration", "2"]
        assert main(["sweep", *wanted, *given, "--jobs", "1", "-o", output]) == 0
        ends.append(parquet.read_table(output)["V_ratio"].to_pylist())
    assert max(ends[1]) < 1e-3 * min(ends[0])
    assert ends[1][0] != ends[1][1]


@pytest.mark.slow
def test_smooth_takes_samples_beside_the_impacts(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The start is known to millimetres, which two impacts alone do not determine."""
    output = tmp_path / "out"
    given = ["--measurements", str(bag.parent / "rig.yaml"), "-o", str(output)]
    assert main(["smooth", str(bag), "--clock-error", "0.001", *given]) == 0
    assert main(["compare", str(output), "--json"]) == 0
    text = capsys.readouterr().out
    assert json.loads(text[text.index("{") :])["smoother"]["V_start"] < 1e-4
    with BagReader(output) as reader:
        assert {"/encoder", "/smoother/state"} <= reader.topics.keys()


@pytest.mark.slow
def test_parameters_are_learned_from_samples_too(tmp_path: Path) -> None:
    """A stiffness that is 3 % off, to a thousandth within three seconds of an encoder."""
    bag = simulated(tmp_path, "plant", "--jitter", "0.001", sensors=ENCODER)
    model = tmp_path / "off.yaml"
    text = Path(shared("config/two_mass.yaml")).read_text("utf-8")
    model.write_text(text.replace("[[20, -10], [-10, 10]]", "[[20.6, -10.3], [-10.3, 10.3]]"))
    given = ["--model", str(model), "--measurements", str(tmp_path / "rig.yaml"), *MINIMUM]
    free = ["--estimate-parameters", "stiffness-scale=0.05"]
    output = tmp_path / "out"
    assert main(["observe", str(bag), *given, *free, "-o", str(output)]) == 0
    with BagReader(output) as reader:
        *_, (_, last) = reader.messages("/observer/state")
    estimate = read_estimate(last)[1]
    found = {name: (value, deviation) for name, value, deviation in estimate.parameters}
    value, deviation = found["stiffness-scale"]
    assert value == pytest.approx(1 / 1.03, abs=1e-3)
    assert abs(value - 1 / 1.03) < 4 * deviation


def test_an_encoder_that_goes_on_after_the_last_impact_counts_to_its_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Samples push the last event out of the history; the command still says what was learned."""
    end, times = 30.0, np.arange(0.0, 30.0, 0.25)
    with BagReader(simulated(tmp_path, "plant", "--measurement-rate", "4")) as reader:
        events = [each.stamp for each in reader.events()]
    (tmp_path / "hits.csv").write_text(
        "time,contact\n" + "".join(f"{stamp / 1e9},stop\n" for stamp in events)
    )
    rows = "".join(f"{1 + t},0.0\n" for t in times)
    (tmp_path / "encoder.csv").write_text(f"time,x1\n{rows}")
    sensor = "measurements: [{name: e, topic: /encoder, joint: x1, quantity: position"
    (tmp_path / "rig.yaml").write_text(f"{sensor}, deviation: 1, gate: 1e6}}]\n")
    given = ["--model", "two_mass", "--epoch", "1", "--time-zero", "0"]
    samples = ["--samples", str(tmp_path / "encoder.csv")]
    table, bag = str(tmp_path / "hits.csv"), str(tmp_path / "rig")
    assert main(["import", table, *given, *samples, "-o", bag]) == 0
    sensors = ["--measurements", str(tmp_path / "rig.yaml"), "--rate", "1"]
    assert main(["observe", bag, *MINIMUM, *sensors, "-o", str(tmp_path / "observed")]) == 0
    accepted = re.search(r"^e +(\d+) +(\d+)", capsys.readouterr().out, re.MULTILINE)
    assert accepted is not None
    assert accepted.groups() == (f"{4 * end:.0f}",) * 2
