# SPDX-License-Identifier: Apache-2.0
"""The example of a control loop: a ball is juggled from impact times alone."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "blind_juggler.py"


@pytest.fixture(scope="module")
def juggler() -> dict[str, Any]:
    """What the example defines."""
    return runpy.run_path(str(EXAMPLE))


@pytest.mark.slow
@pytest.mark.parametrize(
    "law", ["geometric", pytest.param("minimum-variance", marks=pytest.mark.long)]
)
def test_height_is_kept_and_the_observer_can_be_run_again(
    juggler: dict[str, Any], law: str
) -> None:
    """From another height and a wrong guess; open loop on the samples gives equal bits."""
    found = juggler["juggle"](6.0 if law == "geometric" else 3.0, law=law)
    stamps, truth = np.array(found.stamps), np.array(found.truth)
    estimates = np.array(found.estimates)
    assert truth[0, 0] == 0.4
    settled = stamps > stamps[0] + 1_500_000_000
    assert np.max(truth[settled, 0]) == pytest.approx(juggler["HEIGHT"], rel=3e-3)
    assert np.max(np.abs(estimates[settled] - truth[settled])) < 1e-5
    again = juggler["new_observer"](found.stamps[0], law)
    for sample in found.samples:
        assert again.live.add_motion("table", *sample) == ""
    for event in found.events:
        again.receive(event)
    final = stamps[stamps <= found.samples[-1].stamp]
    for stamp in final[::7].tolist():
        one, two = found.observer.estimate(stamp), again.estimate(stamp)
        assert one.q.tobytes() == two.q.tobytes()
        assert one.u.tobytes() == two.u.tobytes()


@pytest.mark.slow
def test_example_prints_heights(
    juggler: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A line for every two seconds."""
    monkeypatch.setattr("sys.argv", ["blind_juggler.py", "--seconds", "4"])
    juggler["main"]()
    assert len(capsys.readouterr().out.splitlines()) == 2


@pytest.mark.ros
def test_nodes_juggle_and_observe_agrees_with_their_recording(
    juggler: dict[str, Any], ros_environment: dict[str, str], tmp_path: Path
) -> None:
    """Estimates in the bag are those that ``observe`` makes.

    How high the ball flies in real time, and how many estimates are published, depends on the
    machine's other work: where there are few to compare, the nodes run again.
    """
    pytest.importorskip("impact_observer_msgs")
    same: list[bool] = []
    for k in range(3):
        if len(same) <= 100:
            same = as_observed(juggler, ros_environment, tmp_path / str(k))
    assert len(same) > 100
    assert np.mean(same) > 0.9  # an estimate that was published before a sample is no final one


def as_observed(juggler: dict[str, Any], environment: dict[str, str], folder: Path) -> list[bool]:
    """Whether estimates of nodes have the bits of those offline from as many events."""
    import subprocess
    import sys

    from impact_observer.cli.main import main
    from impact_observer.io.reader import BagReader

    folder.mkdir()
    bag, output = folder / "juggled", folder / "again"
    words = ["--ros", "--seconds", "6", "-o", str(bag)]
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), *words],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (folder / "juggler.yaml").write_text(juggler["MODEL"])
    with BagReader(bag) as reader:
        live = reader.observer_states("/observer/state")
        samples = reader.topics["/ground_motion"].count
    assert samples > 500
    arguments = ["observe", str(bag), "--initial-state", juggler["GUESS"], "--rate", "200"]
    assert main([*arguments, "-o", str(output)]) == 0
    with BagReader(output) as reader:
        again = reader.observer_states("/observer/state")
    where = {stamp: k for k, stamp in enumerate(again.stamps.tolist())}
    last = {stamp: i for i, stamp in enumerate(live.stamps.tolist())}
    return [
        live.q[i].tobytes() == again.q[where[stamp]].tobytes()
        for stamp, i in last.items()
        if stamp in where and live.last_sequence[i] == again.last_sequence[where[stamp]]
    ]
