# SPDX-License-Identifier: Apache-2.0
"""fit on times that were typed or printed, beside the speeds of the simulators that made them.

``ball`` falls through air, with a drag that is quadratic, onto a racket whose restitution falls
with the speed; its model has a damper instead, and does not fit. ``shaker`` is a mass on a spring
that is shaken against a stop, with times of five digits. ``tapper`` hits a stop once a period, and
each hit has a restitution of its own. All were integrated by DOP853.
"""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from impact_observer.cli.main import main
from impact_observer.io.reader import BagReader
from impact_observer.model import read_model

RIGS = Path(__file__).resolve().parent / "rigs"


def fitted(name: str, model: Path, times: "pd.Series[str]", folder: Path) -> tuple[int, float]:
    """Fit a rig; return the exit code, and which part of the speeds is right.

    Speeds are right within two per cent or two deviations. Deviations are below a fifth.
    """
    table, output = folder / "times.txt", folder / "out"
    table.write_text("\n".join([*times, ""]), "utf-8")
    code = main(["fit", str(table), str(model), "-o", str(output)])
    true = pd.read_csv(RIGS / f"{name}.csv", dtype={"time": str}).set_index("time").speed[times]
    found = pd.read_csv(output / "impacts.csv")
    assert len(found) == len(times)
    assert np.max(np.abs(found.time_s - times.astype(float).to_numpy())) < 0.01
    assert float(np.median(found.speed_before_deviation / found.speed_before)) < 0.2
    error = np.abs(found.speed_before - true.to_numpy())
    allowed = np.maximum(0.02 * true.to_numpy(), 2 * found.speed_before_deviation)
    return code, float(np.mean(error <= allowed))


def times_of(name: str) -> "pd.Series[str]":
    """The printed times of a rig."""
    return pd.read_csv(RIGS / f"{name}.csv", dtype=str).time


def test_a_ball_in_air_has_right_speeds_though_its_model_does_not_fit(tmp_path: Path) -> None:
    """The motion is that of the model as typed, not of one with another force."""
    assert fitted("ball", RIGS / "ball.yaml", times_of("ball"), tmp_path) == (1, 1.0)


@pytest.mark.long
def test_a_shaken_mass_with_printed_times_fits_at_an_unknown_phase(tmp_path: Path) -> None:
    """Rounding to five digits is no evidence against a right model."""
    assert fitted("shaker", RIGS / "shaker.yaml", times_of("shaker"), tmp_path) == (0, 1.0)


@pytest.mark.long
def test_rebounds_that_scatter_do_not_shrink_a_motion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The times tell the restitution, and not how large force, gap and speeds are."""
    assert fitted("tapper", RIGS / "tapper.yaml", times_of("tapper"), tmp_path) == (0, 1.0)
    told = capsys.readouterr().out
    (amplitude,) = re.findall(r"amplitude\S* \S+ \+- (\S+)", told)
    (restitution,) = re.findall(r"restitution\S* (\S+) \+-", told)
    assert float(amplitude) > 0.9 * 0.15
    assert abs(float(restitution) - 0.72) < 0.15


def test_a_fitted_model_is_fitted_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """To its own recording, which is said, and to another one, whose phase is another one.

    Rounding to five digits is no evidence against a right model.
    """
    rig, times = tmp_path / "rig.yaml", times_of("shaker")
    known = (RIGS / "shaker.yaml").read_text("utf-8")
    rig.write_text(known.replace("0.55}", "{value: 0.6, deviation: 0.1}}"), "utf-8")
    first, same, other = (tmp_path / name for name in ("first", "same", "other"))
    for folder in (first, same, other):
        folder.mkdir()
    assert fitted("shaker", rig, times[:25], first) == (0, 1.0)
    for folder, later in ((same, times[:25]), (other, times[25:50])):
        capsys.readouterr()
        assert fitted("shaker", first / "out" / "fitted.yaml", later, folder) == (0, 1.0)
        told = capsys.readouterr().out
        assert ("count twice" in told) == (folder == same)
        assert re.search(r"phase.*\(given 0\)\n", told), "the deviation is of another epoch"


TWO_MASSES = """name: rig
bodies: [{name: frame, mass: {value: 1, deviation: 0.05}}, {name: tool, mass: 1}]
springs:
  - between: [ground, frame]
    stiffness: {value: 10.2, deviation: 0.5}
    damping: {value: 0.12, deviation: 0.03}
  - between: [frame, tool]
    stiffness: {value: 10.3, deviation: 0.5}
    damping: {value: 0.12, deviation: 0.03}
forces: [{body: tool, amplitude: {value: 4.1, deviation: 0.2}, frequency: 2.5}]
stops:
  - name: stop
    body: tool
    limit: {value: 0.52, deviation: 0.03}
    side: above
    restitution: {value: 0.65, deviation: 0.1}
"""


KNOWN = {
    "mass: {value: 1, deviation: 0.05}": "mass: 1",
    "stiffness: {value: 10.2, deviation: 0.5}": "stiffness: 10",
    "damping: {value: 0.12, deviation: 0.03}": "damping: 0.1",
    "amplitude: {value: 4.1, deviation: 0.2}": "amplitude: 4",
}
"""Numbers of ``TWO_MASSES`` with their deviations, and as they are known."""


@pytest.mark.long
@pytest.mark.parametrize(("known", "missing", "seconds"), [({}, (), 180), (KNOWN, (49,), 90)])
def test_a_chaotic_motion_is_found(
    known: dict[str, str], missing: tuple[int, ...], seconds: int, tmp_path: Path
) -> None:
    """From printed times alone: with nine unknown numbers, or with a time that is missing."""
    bag, table, output = tmp_path / "bag", tmp_path / "times.txt", tmp_path / "out"
    assert main(["simulate", "two_mass", "--duration", str(seconds), "-o", str(bag)]) == 0
    with BagReader(bag) as reader:
        times = [(each.stamp - each.epoch) * 1e-9 for each in reader.events()]
    kept = [f"{time:.6f}" for k, time in enumerate(times) if k not in missing]
    table.write_text("\n".join(kept), "utf-8")
    text = TWO_MASSES
    for uncertain, exact in known.items():
        text = text.replace(uncertain, exact)
    (tmp_path / "rig.yaml").write_text(text, "utf-8")
    assert main(["fit", str(table), str(tmp_path / "rig.yaml"), "-o", str(output)]) == 0
    found = read_model(output / "fitted.yaml")
    assert found.system.eps[0] == pytest.approx(0.7, abs=1e-3)
