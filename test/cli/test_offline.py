# SPDX-License-Identifier: Apache-2.0
"""simulate, observe, compare: from a model to a comparison, without ROS."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from systems import jammed

from impact_observer.cli.main import main
from impact_observer.events import ImpactEvent, Switch
from impact_observer.io.messages import bag_messages
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, model_of
from impact_observer.io.writer import BagWriter
from impact_observer.model import read_model
from impact_observer.observer import Observer, initial_state, law_named
from impact_observer.observer.laws import BUILT_IN
from impact_observer.observer.misfit import MISFIT
from impact_observer.plant import Plant, simulate
from impact_observer.resources import shared
from impact_observer.stamps import NS_PER_S, grid

EPOCH = 1_000_000_000
CERTIFIED = ("geometric", "unilateral")


@pytest.fixture(scope="module")
def run_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with fifteen seconds of two_mass."""
    bag = tmp_path_factory.mktemp("offline") / "plant"
    assert main(["simulate", "two_mass", "--duration", "15", "--seed", "7", "-o", str(bag)]) == 0
    return bag


def observed(bag: Path, name: str, *arguments: str) -> Path:
    """Observe ``bag`` into a bag beside it."""
    output = bag.parent / name
    assert main(["observe", str(bag), *arguments, "-o", str(output)]) == 0
    return output


@pytest.mark.parametrize(
    ("model", "seconds", "gap"),
    [
        ("bouncing_ball", 0.3, 1 - 9.81 * 0.3**2 / 2),
        ("ball_on_table", 0.05, 0.02 - 9.81 * 0.05**2 / 2 - 0.003 * np.cos(20 * np.pi * 0.05)),
    ],
)
def test_a_plant_that_hits_nothing_says_how_near_it_came(
    model: str, seconds: float, gap: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line names the nearest stop, which may move; a ball falls in closed form."""
    words = ["simulate", model, "--duration", str(seconds), "--rate", "20"]
    assert main([*words, "-o", str(tmp_path / "bag")]) == 0
    assert f"no contact closed: smallest gap {gap:.3g} m, at " in capsys.readouterr().out


def test_a_bag_without_impacts_gives_no_estimate_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a given epoch, at which the initial state holds, there are estimates."""
    bag, out = tmp_path / "bag", tmp_path / "out"
    assert main(["simulate", "bouncing_ball", "--duration", "0.3", "-o", str(bag)]) == 0
    assert main(["observe", str(bag), "-o", str(out)]) == 2
    assert "no impact in it, so that nothing is estimated" in capsys.readouterr().err
    assert not out.exists()
    assert main(["compare", str(bag), "--laws", "geometric"]) == 1
    assert "expected impacts, or a bag of observe with the --epoch" in capsys.readouterr().err
    falling = tmp_path / "falling"
    assert main(["observe", str(bag), "--epoch", "1", "-o", str(falling)]) == 0
    assert main(["compare", str(falling)]) == 0


def test_a_simulated_bag_carries_its_model_and_seed(run_bag: Path) -> None:
    """The model in the bag is the simulated one; provenance has version and seed."""
    with BagReader(run_bag) as reader:
        model = model_of(reader)
        events = events_in(reader)
    sample = read_model("two_mass")
    np.testing.assert_array_equal(model.system.K, sample.system.K)
    np.testing.assert_array_equal(model.system.forcing.cosine, sample.system.forcing.cosine)
    assert model.provenance["seed"] == 7
    assert model.provenance["package"] == "impact_observer"
    assert [e.sequence for e in events] == list(range(1, len(events) + 1))
    assert {e.epoch for e in events} == {EPOCH}


@pytest.mark.slow
def test_end_of_a_recorded_force_is_one_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last force is held; simulate and observe say from when on, once."""
    (tmp_path / "force.csv").write_text("time,x1\n0,0\n2,5\n")
    model, bag = tmp_path / "pushed.yaml", tmp_path / "plant"
    text = read_model("two_mass").text()
    sampled = f"forcing:\n  sampled: {tmp_path / 'force.csv'}\n  hold: linear\n"
    model.write_text(text.replace("forcing:\n", sampled, 1))
    warning = "forcing.sampled"
    for duration, count in (("2", 0), ("8", 1)):
        out = f"{bag}{duration}"
        given = ["--duration", duration, "--rate", "5", "-o", out]
        assert main(["simulate", str(model), *given]) == 0
        assert capsys.readouterr().out.count(warning) == count
    law = ("--law", "minimum-variance", "--clock-error", "0")
    observed(Path(f"{bag}8"), "estimate", *law)
    assert capsys.readouterr().out.count(warning) == 1


def test_truth_in_a_bag_starts_at_the_epoch_and_follows_the_events(run_bag: Path) -> None:
    """Every sample is the plant's state; at an impact's stamp it is the state after the impact."""
    model = read_model("two_mass")
    plant = Plant(model.system, *model.initial_state(), epoch=EPOCH)
    wanted = simulate(plant, grid(EPOCH, 16 * 1_000_000_000, 100.0))
    with BagReader(run_bag) as reader:
        truth = reader.joint_states("/plant/joint_states")
    np.testing.assert_array_equal(truth.stamps, wanted.stamps)
    np.testing.assert_array_equal(np.hstack([truth.q, truth.u]), wanted.states)


@pytest.mark.slow
@pytest.mark.parametrize("law", BUILT_IN)
def test_observe_writes_the_estimates_of_the_observer(run_bag: Path, law: str) -> None:
    """Offline estimates are those of the same object fed by hand, bit for bit."""
    output = observed(
        run_bag, f"out_{law}", "--law", law, "--initial-state", "random:3", "--rate", "10"
    )
    system = read_model("two_mass").system
    observer = Observer(
        system, law_named(law)(system), *initial_state("random:3", system), history=1e6
    )
    with BagReader(output) as reader:
        for event in events_in(reader):
            observer.receive(event)
        states = reader.observer_states("/observer/state")
        joints = reader.joint_states("/observer/joint_states")
        assert set(reader.topics) == {
            "/impacts",
            "/plant/joint_states",
            "/plant/model",
            "/observer/impacts",
            "/observer/joint_states",
            "/observer/state",
            "/observer/verdicts",
            *(["/observer/bound"] if law in CERTIFIED else []),
        }
    assert states.law == law
    assert states.stamps[0] == EPOCH
    for stamp, q, u, sequence in zip(
        states.stamps.tolist(), states.q, states.u, states.last_sequence, strict=True
    ):
        estimate = observer.estimate(stamp)
        assert estimate.q.tobytes() == q.tobytes()
        assert estimate.u.tobytes() == u.tobytes()
        assert estimate.last_sequence == sequence
    np.testing.assert_array_equal(joints.q, states.q)


def test_certified_bound_is_written_when_it_changes(run_bag: Path) -> None:
    """The bound is an error without coordinates, at the start and after each impact."""
    output = observed(
        run_bag, "bounded", "--initial-state", "random:3", "--initial-deviation", "2"
    )
    with BagReader(output) as reader:
        impacts = len(events_in(reader))
        bounds = [each for _, each in reader.messages("/observer/bound")]
    values = [message.v for message in bounds]
    assert len(values) == impacts + 1
    assert np.all(np.diff(values) < 0)
    assert values[-1] > 0
    assert all(len(message.position_error) == 0 for message in bounds)


@pytest.mark.slow
def test_compare_orders_the_laws_and_draws_them(
    run_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Open loop is worst; V never rises at an impact with the other laws; the picture is a PNG."""
    bags = {
        law: observed(
            run_bag, f"cmp_{law}", "--law", law, "--initial-state", "random:1", "--rate", "20"
        )
        for law in ("open-loop", "kinematic", "geometric")
    }
    picture = run_bag.parent / "v.png"
    capsys.readouterr()
    assert main(["compare", *map(str, bags.values()), "--json", "--plot", str(picture)]) == 0
    metrics = json.loads(capsys.readouterr().out)
    assert list(metrics) == list(bags)
    assert metrics["geometric"]["V_ratio"] < metrics["kinematic"]["V_ratio"] < 0.1
    assert metrics["open-loop"]["V_ratio"] > 0.1
    for law in ("kinematic", "geometric"):
        assert metrics[law]["V_largest_rise"] <= 1e-9
        assert metrics[law]["late_samples"] == 0
    assert metrics["geometric"]["events_used"] == 10
    assert metrics["geometric"]["settling_time"] == pytest.approx(10.5, abs=0.1)
    assert picture.read_bytes().startswith(b"\x89PNG")

    assert main(["compare", *map(str, bags.values())]) == 0
    table = capsys.readouterr().out
    assert "geometric" in table
    assert "dx2/dt" in table


@pytest.mark.slow
def test_equal_initial_states_leave_ratios_undefined(
    run_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ratios to V0 = 0 are undefined."""
    bag = observed(run_bag, "exact", "--initial-state", "0.1,-0.2,0.5,0")
    capsys.readouterr()
    assert main(["compare", str(bag), "--json"]) == 0
    metrics = json.loads(capsys.readouterr().out)["geometric"]
    assert metrics["V_start"] == 0.0
    assert metrics["V_ratio"] is None
    assert metrics["V_end"] < 1e-12
    assert main(["compare", str(bag)]) == 0
    assert "undefined" in capsys.readouterr().out


@pytest.mark.slow
def test_observe_takes_another_rate_and_model(
    run_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--rate samples from the epoch on; --model replaces the one in the bag."""
    bag = observed(run_bag, "slow", "--rate", "10", "--model", "two_mass")
    with BagReader(bag) as reader:
        stamps = reader.observer_states("/observer/state").stamps
    np.testing.assert_array_equal(stamps, grid(EPOCH, 16 * 1_000_000_000, 10.0))
    capsys.readouterr()
    wrong = run_bag.parent / "wrong"
    for command in ("observe", "smooth"):
        assert main([command, str(run_bag), "--model", "three_mass", "-o", str(wrong)]) == 2
        assert "model three_mass: right, left" in capsys.readouterr().err
    assert not wrong.exists()


def test_a_bag_of_which_no_impact_is_applied_leaves_no_estimates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The epoch is after the events; the error names the verdict on the first event."""
    bag, output = tmp_path / "bag", tmp_path / "out"
    with BagWriter(bag) as writer:
        for k in range(3):
            event = ImpactEvent((k + 2) * NS_PER_S, (Switch("stop"),), k + 1, 0, 9 * NS_PER_S)
            writer.write("/impacts", event.stamp, bag_messages().event(event))
    words = ["observe", str(bag), "--model", "two_mass", "--rate", "10", "-o", str(output)]
    assert main(words) == 1
    said = capsys.readouterr().err
    assert "none of its 3 impacts and releases was applied; the first: rejected, stamped" in said
    assert not output.exists()


def test_an_epoch_that_contradicts_the_events_is_refused(
    run_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The events have 1 s; it is not replaced, and no bag is left."""
    output = run_bag.parent / "contradiction"
    assert main(["observe", str(run_bag), "--epoch", "5", "-o", str(output)]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert "its events say 1.000000000 s" in errors[0]
    assert not output.exists()


def test_compare_without_estimates_names_the_remedy(
    run_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A recording without estimates: exit code 2, one line."""
    assert main(["compare", str(run_bag)]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert "no estimates" in errors[0]


def test_observation_that_fails_leaves_no_bag(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A replica on the other side of stops without play is an error of one line."""
    model = tmp_path / "jammed.yaml"
    model.write_text(jammed(0, 1, velocity=0), encoding="utf-8")
    plant, output = tmp_path / "plant", tmp_path / "out"
    assert main(["simulate", str(model), "--duration", "1", "-o", str(plant)]) == 0
    assert main(["observe", str(plant), "--initial-state", "0,1", "-o", str(output)]) == 1
    assert "has no solution" in capsys.readouterr().err
    assert not output.exists()


@pytest.mark.usefixtures("in_tmp_path")
@pytest.mark.parametrize("command", ["observe", "smooth"])
def test_events_after_the_true_states_are_warned_of(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a rate the estimates go on up to the last event."""
    flights = 2 * np.sqrt(2 / 9.81) * 0.9 ** np.arange(1, 5)
    bounces = 0.45152 + np.append(0.0, np.cumsum(flights))
    Path("bounces.csv").write_text("\n".join(f"{each:.9f},floor" for each in bounces.tolist()))
    Path("true.csv").write_text("time,q_height,u_height\n0,1,0\n0.4,0.21520,-3.924\n")
    imported = ["import", "bounces.csv", "--model", "bouncing_ball", "--truth", "true.csv"]
    assert main([*imported, "-o", "bag"]) == 0
    capsys.readouterr()
    assert main([command, "bag", "-o", "short"]) == 0
    line = "5 of 5 events are stamped after the last estimate, 1.400000000 s"
    assert line in capsys.readouterr().out
    assert main([command, "bag", "--rate", "10", "-o", "whole"]) == 0
    assert "warning" not in capsys.readouterr().out
    topic = "/observer/state" if command == "observe" else "/smoother/state"
    with BagReader(Path("whole")) as reader:
        stamps = reader.observer_states(topic).stamps
    assert stamps[-1] == EPOCH + int(bounces[-1] * 10) * NS_PER_S // 10


@pytest.mark.usefixtures("in_tmp_path")
@pytest.mark.parametrize("reported", [8, 20])
def test_a_sensor_that_died_before_the_end_is_one_warning(
    reported: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """A ball bounces 20 times; of a sensor that reported all hits nothing is said."""
    flights = 2 * np.sqrt(2 / 9.81) * 0.9 ** np.arange(1, 20)
    bounces = 0.451523641 + np.append(0.0, np.cumsum(flights))
    hits = [f"{each:.9f},floor" for each in bounces[:reported].tolist()]
    Path("bounces.csv").write_text("\n".join(hits))
    end = bounces[-1] + 0.01
    Path("true.csv").write_text(f"time,q_height,u_height\n0,1,0\n{end:.9f},0,0\n")
    imported = ["import", "bounces.csv", "--model", "bouncing_ball", "--truth", "true.csv"]
    assert main([*imported, "-o", "bag"]) == 0
    capsys.readouterr()
    assert main(["observe", "bag", "--law", "minimum-variance", "-o", "seen"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    line = "predicted impacts in a row were not reported: the sensor or its line may be dead"
    assert (line in printed) is (reported == 8)


def test_observe_says_how_many_impacts_were_reported_and_what_deviations_are_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a sensor that misses some."""
    bag, out = shared("bags") / "missed", tmp_path / "out"
    assert main(["observe", str(bag), "--law", "minimum-variance", "-o", str(out)]) == 0
    output = capsys.readouterr().out
    assert "19 applied, 2 inserted" in output
    (row,) = [line for line in output.splitlines() if line.startswith("dx2/dt ")]
    assert "m/s" in row


@pytest.mark.slow
def test_a_misfit_stands_in_the_bag_as_in_the_diagnostics_of_a_node(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """When the warning changes, on the topic and under the name that a node has; else nothing."""
    text = shared("config/two_mass.yaml").read_text(encoding="utf-8")
    (tmp_path / "wrong.yaml").write_text(text.replace("[0, 4]", "[0, 5]"))
    bag, out, exact = (str(tmp_path / name) for name in ("bag", "out", "exact"))
    assert main(["simulate", "two_mass", "--duration", "35", "--rate", "2", "-o", bag]) == 0
    law = ("--law", "minimum-variance", "--ensemble", "1")
    assert main(["observe", bag, *law, "-o", exact]) == 0
    capsys.readouterr()
    arguments = ["--model", str(tmp_path / "wrong.yaml"), *law, "-o", out]
    assert main(["observe", bag, *arguments]) == 0
    assert MISFIT in capsys.readouterr().out
    with BagReader(Path(exact)) as reader:
        assert "/diagnostics" not in reader.topics
    with BagReader(Path(out)) as reader:
        arrays = [message for _, message in reader.messages("/diagnostics")]
    statuses = [status for array in arrays for status in array.status]
    assert {status.name for status in statuses} == {"/observer: impacts"}
    assert statuses[0].message.startswith(MISFIT)
    assert all((status.level == 1) is (MISFIT in status.message) for status in statuses)
    texts = [status.message for status in statuses]
    assert all(one != next_ for one, next_ in pairwise(texts))


@pytest.mark.slow
def test_a_model_by_which_many_impacts_are_rejected_is_doubted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The frequency of the forcing is in Hz instead of rad/s."""
    bag, model = str(tmp_path / "bag"), tmp_path / "hz.yaml"
    assert main(["simulate", "two_mass", "--duration", "30", "--rate", "1", "-o", bag]) == 0
    text = shared("config/two_mass.yaml").read_text()
    model.write_text(text.replace("frequency: 2.5", "frequency: 0.398"))
    said = dict[str, str]()
    for name in ("two_mass", str(model)):
        output = str(tmp_path / f"observed_{len(said)}")
        options = ("--law", "minimum-variance", "-o", output)
        assert main(["observe", bag, "--model", name, *options]) == 0
        said[name] = capsys.readouterr().out
    assert "impacts rejected" in said[str(model)]
    assert "impacts rejected" not in said["two_mass"]
