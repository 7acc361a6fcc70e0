# SPDX-License-Identifier: Apache-2.0
"""Commands give the numbers in ``golden.npz``.

``.venv/bin/python test/golden/test_golden.py`` writes them anew; the commit then says why.
"""

import io
import json
import os
from contextlib import redirect_stdout
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader  # not the package's own reader

from impact_observer.cli.main import main

HERE = Path(__file__).resolve().parent
BAGS = HERE.parents[1] / "bags"
STORED = HERE / "golden.npz"
FAULTS = "--jitter 0.0005 --missed 0.15 --spurious 0.2 --mislabelled 0.1 --transport 0.1"
MIN = "--law minimum-variance --initial random:1 --rate 2"
COMMANDS = f"""
simulate two_mass --duration 8 --rate 4 -o two_mass
simulate three_mass --duration 20 --rate 4 --seed 3 {FAULTS} -o three_mass
simulate bouncing_ball --duration 3 --rate 10 --quantisation 0.001 -o ball
simulate ball_on_table --duration 1 --rate 25 -o table
simulate GOLDEN/row.yaml --duration 10 --rate 4 -o row
simulate GOLDEN/driven.yaml --duration 10 --rate 4 -o driven
simulate GOLDEN/arm.yaml --duration 4 --rate 4 --measurements hammer_arm --seed 1 -o arm
observe BAGS/two_mass --law geometric --initial random:1 --rate 2 -o geometric
observe row --law unilateral --initial random:1 -o unilateral
observe driven --law kinematic --initial random:1 -o kinematic
observe BAGS/missed_and_spurious {MIN} --clock-error 0 -o troubled
observe BAGS/ball_on_table {MIN}5 --clock-error 0 -o touching
observe three_mass {MIN} -o relabelled
observe driven {MIN} --estimate-parameters restitution.wall=0.05 -o estimated
observe arm --law minimum-variance --measurements hammer_arm -o joints
smooth BAGS/missed_and_spurious --clock-error 0 --rate 1 -o smoothed
export smoothed --impacts -o impacts.csv
identify BAGS/jitter --free restitution,gap,stiffness-scale --json
detect BAGS/accelerometer --contact stop --topic /imu --threshold 100 -o detected
fit BAGS/missed GOLDEN/rig.yaml --epoch 1 -o fitted
"""
TOPICS = {
    "simulate": ("/impacts", "/plant/joint_states"),
    "observe": ("/observer/state", "/observer/verdicts"),
    "smooth": ("/smoother/state", "/smoother/impacts"),
    "detect": ("/impacts",),
}
EXACT = 1e-9  # of a column's largest value, without covariance: processors round apart
OF_DEVIATION = 1e-3  # of estimates, in their deviation: rounding decides where iterations end
FLOOR = 1e-8  # the same over the largest value, where a deviation is all but zero
INNOVATION = 1e-2  # in deviations: it is a small difference of large numbers
NANOSECONDS = 2.5  # an instant between two nanoseconds is rounded to either

Arrays = dict[str, NDArray[np.float64]]


def of_bag(folder: Path, topics: tuple[str, ...]) -> Arrays:
    """Arrays of what the messages of some topics hold, a row for each message."""
    made: dict[str, list[list[float]]] = {}
    with AnyReader([folder]) as reader:
        for connection, _, data in reader.messages():
            if connection.topic in topics:
                message = reader.deserialize(data, connection.msgtype)
                for kind, row in numbers(message).items():
                    made.setdefault(f"{connection.topic} {kind}", []).append(row)
    return {name: np.array(rows, float) for name, rows in made.items()}


def numbers(message: Any) -> dict[str, list[float]]:  # noqa: ANN401 - any of the messages
    """The numbers of one message by their kind, for which there is a tolerance."""
    made = {"stamp": [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec]}
    if hasattr(message, "switches"):
        made["code"] = [message.sequence, len(message.switches), message.switches[0].kind]
    elif hasattr(message, "verdict"):
        made["code"] = [message.verdict, message.sequence, *message.contact.encode()[:1]]
        made["innovation"] = [getattr(message, "innovation", 0)]
    else:
        made["x"] = [*message.position, *message.velocity, *getattr(message, "parameter", ())]
    if hasattr(message, "covariance"):
        made["code"] = [message.last_sequence, len(message.closed)]
        if message.covariance.size:
            variances = message.covariance.reshape([2 * len(message.name)] * 2).diagonal()
            made["deviation"] = [*np.sqrt(variances), *message.parameter_deviation]
    return made


def of_table(path: Path) -> Arrays:
    """Values and deviations in a table of impacts."""
    table = pd.read_csv(path).fillna(-1)
    names = [name for name in table if f"{name}_deviation" in table]
    deviations = table[[f"{name}_deviation" for name in names]]
    return {"x": table[names].to_numpy(), "deviation": deviations.to_numpy()}


def results() -> Arrays:
    """What all commands give, which write into the working folder."""
    made: Arrays = {}
    for command in COMMANDS.strip().splitlines():
        words = command.replace("BAGS", str(BAGS)).replace("GOLDEN", str(HERE)).split()
        with redirect_stdout(io.StringIO()) as printed:
            assert main(words) in {0, 1}, command  # 1: identify says that a model does not fit
        output = Path(dict(pairwise(words)).get("-o", ""))
        if words[0] in TOPICS:
            given = of_bag(output, TOPICS[words[0]])
        elif words[0] == "identify":
            found = pd.DataFrame(json.loads(printed.getvalue())["parameters"]).T
            given = {"x": found[["value"]], "deviation": found[["standard_error"]]}
        else:
            given = of_table(output / "impacts.csv" if words[0] == "fit" else output)
        made |= {f"{command} | {name}": np.array(a, float) for name, a in given.items()}
    return made


def allowed(name: str, stored: Arrays) -> NDArray[np.float64]:
    """The tolerance of each value of an array."""
    size, kind = np.abs(stored[name]), name.rsplit(maxsplit=1)[-1]
    deviation = stored.get(f"{name.removesuffix(kind)}deviation")
    if kind in {"stamp", "code"}:
        return np.full(size.shape, {"stamp": NANOSECONDS, "code": 0.5}[kind])
    if kind == "innovation":
        return INNOVATION * (1 + size)
    largest = size.max(axis=0) + np.finfo(float).tiny / EXACT
    if deviation is None:
        return np.broadcast_to(EXACT * largest, size.shape)
    return np.asarray(np.maximum(OF_DEVIATION * deviation, FLOOR * largest))


@pytest.mark.slow
@pytest.mark.usefixtures("in_tmp_path")
def test_commands_give_the_stored_numbers() -> None:
    """Simulated motions, estimates, verdicts and identified numbers, within their tolerances."""
    given, stored = results(), dict(np.load(STORED))
    assert {n: a.shape for n, a in given.items()} == {n: a.shape for n, a in stored.items()}
    for name, array in given.items():
        np.testing.assert_array_less(np.abs(array - stored[name]), allowed(name, stored), name)


if __name__ == "__main__":
    with TemporaryDirectory() as working_folder:
        os.chdir(working_folder)
        np.savez_compressed(STORED, **results())  # type: ignore[arg-type]
