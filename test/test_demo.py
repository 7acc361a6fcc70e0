# SPDX-License-Identifier: Apache-2.0
"""The demonstration as a user runs it: real processes, a bag, a verdict."""

import re
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from systems import jammed

pytest.importorskip("rclpy")
pytest.importorskip("impact_observer_msgs")

from impact_observer.cli.demo import check_result
from impact_observer.cli.main import main
from impact_observer.compare.bag_comparison import compare_bag
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in, model_of
from impact_observer.plant import Plant, simulate
from impact_observer.ros.demonstration import DemonstrationError, run
from impact_observer.ros.wiring import DemoSetup
from impact_observer.stamps import grid

pytestmark = pytest.mark.ros

PROGRAM = [sys.executable, "-m", "impact_observer"]


@dataclass(frozen=True)
class Run:
    """What a demonstration left."""

    folder: Path
    code: int
    out: str
    err: str


def run_demo(folder: Path, environment: dict[str, str], *arguments: str) -> Run:
    """Run the command; it ends by itself."""
    done = subprocess.run(
        [*PROGRAM, "demo", "-o", str(folder), *arguments],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return Run(folder, done.returncode, done.stdout, done.stderr)


@pytest.fixture
def demo(tmp_path: Path, ros_environment: dict[str, str]) -> Run:
    """Twelve simulated seconds, three times as fast as real."""
    arguments = ("--duration", "12", "--realtime-factor", "3")
    return run_demo(tmp_path / "demo", ros_environment, *arguments)


def test_a_demonstration_shows_records_and_judges(demo: Run) -> None:
    """Table, picture and bag are there; live and offline estimates agree bit for bit."""
    assert demo.code == 0, demo.out + demo.err
    assert re.search(r"geometric +4\.\d+ .* \d\.\d+e-0\d", demo.out)
    assert re.search(r"kinematic +4\.\d+ ", demo.out)
    assert (demo.folder / "lyapunov.png").read_bytes().startswith(b"\x89PNG")
    bag = demo.folder / "bag"
    with BagReader(bag) as reader:
        model = model_of(reader)
        result = compare_bag(reader, model.system)
        events = events_in(reader)
        errors = [message for _, message in reader.messages("/monitor_geometric/error")]
    assert errors[-1].v < 1e-2 * errors[0].v
    assert errors[-1].name == ["x1", "x2"]
    assert np.abs(errors[-1].position_error).max() < 0.1
    count = len(events)
    plant = Plant(model.system, *model.initial_state(), epoch=1_000_000_000)
    offline = simulate(plant, grid(1_000_000_000, 13_000_000_000, 100.0)).events
    moved = np.array([event.stamp - event.epoch for event in events])
    np.testing.assert_allclose(moved, [e.stamp - e.epoch for e in offline], rtol=0, atol=1)
    for comparison in result.comparisons.values():
        assert comparison.events == count
        assert comparison.stamps.size > 600, "of 1201 samples, few are skipped"
        assert comparison.largest_rise <= 1e-9
    laws = {each.law: each for each in result.comparisons.values()}
    assert laws["geometric"].V[-1] < laws["kinematic"].V[-1]
    for law in laws:
        assert_live_is_offline(bag, law)


def assert_live_is_offline(bag: Path, law: str) -> None:
    """The node's estimates equal those of ``observe`` wherever it had the same events."""
    output = bag.parent / f"offline_{law}"
    arguments = [
        "observe",
        str(bag),
        "--law",
        law,
        "--initial-state",
        "random:1",
        "-o",
        str(output),
    ]
    assert main(arguments) == 0
    with BagReader(bag) as reader:
        live = reader.observer_states(f"/observer_{law}/state")
    with BagReader(output) as reader:
        offline = reader.observer_states("/observer/state")
    where = {int(stamp): i for i, stamp in enumerate(offline.stamps)}
    compared = 0
    for k, stamp in enumerate(live.stamps.tolist()):
        i = where.get(stamp)
        if i is None or live.last_sequence[k] != offline.last_sequence[i]:
            continue
        assert live.q[k].tobytes() == offline.q[i].tobytes()
        assert live.u[k].tobytes() == offline.u[i].tobytes()
        assert live.last_event[k] == offline.last_event[i]
        compared += 1
    assert compared > 500
    early = np.count_nonzero(np.isin(live.stamps, offline.stamps)) - compared
    assert early < 200, "few estimates are published before their event arrives"


def test_a_demonstration_that_falls_short_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """After two seconds the goal is not reached: exit code 1, and the ratio is named.

    The picture has truth and estimate of each coordinate, and V below.
    """
    drawn = list[Figure]()
    monkeypatch.setattr("impact_observer.draw.pictures.save", lambda each, _: drawn.append(each))
    run, bag = str(tmp_path / "run"), tmp_path / "bag"
    assert main(["simulate", "two_mass", "--duration", "2", "-o", run]) == 0
    law = ["--law", "geometric", "--initial-state", "random:1"]
    assert main(["observe", run, *law, "-o", str(bag)]) == 0
    assert check_result(bag, tmp_path / "lyapunov.png") == 1
    assert "too much: the goal is 0.01" in capsys.readouterr().out
    (picture,) = drawn
    picture.draw_without_rendering()
    below = [axes for axes in picture.axes if axes.get_ylabel() == "Lyapunov distance V [J]"]
    above = [axes for axes in picture.axes if axes.get_ylabel().startswith(("x1", "dx2"))]
    assert [len(axes.lines) for axes in above] == [2, 2]
    assert len(below) == 1
    assert all(axes.bbox.ymin > below[0].bbox.ymax for axes in above)


def test_a_model_that_the_plant_cannot_follow_ends_the_demonstration(
    tmp_path: Path, ros_environment: dict[str, str]
) -> None:
    """Two stops without play, hit together: one line with the plant's own reason."""
    assert ros_environment
    model = tmp_path / "jammed.yaml"
    model.write_text(jammed(0.8, 0.5, velocity=1), encoding="utf-8")
    setup = DemoSetup(str(model), ("geometric",), "zero", 30.0, 2.0, 100.0, time.time_ns())
    with pytest.raises(DemonstrationError, match=r"'floor', 'ceiling'.* has no solution"):
        run(setup, tmp_path / "jammed", lambda _: None)
