# SPDX-License-Identifier: Apache-2.0
"""The command ``identify``: parameters of a model from the impacts in a bag."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_observer.cli.main import main
from impact_observer.io.reader import BagReader
from impact_observer.io.recordings import events_in
from impact_observer.model import read_model
from impact_observer.model.free_parameters import parameters_beside, parametric_family
from impact_observer.resources import shared
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
BAG, ROUGH = "two_mass", "jitter"


def bag(name: str) -> str:
    """A recorded sample bag."""
    return str(shared("bags") / name)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """The sample model with a wrong restitution and stiffness, and its comments."""
    text = (shared("config") / "two_mass.yaml").read_text()
    assert "restitution: 0.7" in text
    path = tmp_path / "guess.yaml"
    path.write_text(text.replace("restitution: 0.7", "restitution: 0.8"))
    return path


@pytest.mark.slow
def test_identified_parameters_are_printed_and_written(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file reads as a model again, says where it is from, and keeps its comments."""
    output, plot = tmp_path / "identified.yaml", tmp_path / "identified.svg"
    words = ["identify", bag(BAG), "--model", str(model), "--free", "restitution,gap"]
    written = ["-o", str(output), "--write-start"]
    assert main([*words, *written, "--plot", str(plot)]) == 0
    said = capsys.readouterr().out
    assert "restitution.stop" in said
    assert "standard error" in said
    identified = read_model(output)
    np.testing.assert_allclose(identified.system.eps, [0.7], rtol=1e-6)
    assert "dx2/dt at the start" in said
    start = np.concatenate(identified.initial_state())
    np.testing.assert_allclose(start, [0.1, -0.2, 0.5, 0.0], atol=1e-5)
    assert set(identified.provenance["parameters"]) == {"restitution.stop", "gap.stop"}  # type: ignore[call-overload]
    assert output.read_text().count("#") == model.read_text().count("#")
    assert plot.stat().st_size > 0
    assert main([*words, "-o", str(output)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_json_has_every_result(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Standard output has nothing but the JSON."""
    words = ["identify", bag(BAG), "--model", str(model), "--free", "restitution", "--json"]
    assert main(words) == 0
    results = json.loads(capsys.readouterr().out)
    found = results["parameters"]["restitution.stop"]
    assert found["given"] == 0.8
    assert found["value"] == pytest.approx(0.7, rel=1e-6)
    assert results["converged"]
    assert len(results["shifts"]["shift"]) == results["impacts"]
    assert results["fits"]


@pytest.mark.usefixtures("in_tmp_path")
def test_too_few_impacts_are_named_and_say_nothing_of_the_clock(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Eight impacts do not suffice for a start of four numbers and three parameters."""
    jitter, free = ["--jitter", "0.0005"], "restitution,stiffness-scale,damping-scale"
    assert main(["simulate", "two_mass", "--duration", "12", *jitter, "-o", "rig"]) == 0
    for clock, code in (("0.0005", 0), ("1e-5", None)):
        capsys.readouterr()
        found = main(["identify", "rig", "--free", free, "--clock-error", clock])
        assert code in {None, found}
        said = " ".join(capsys.readouterr().out.split())
        assert "8 stamps are few for 7 unknowns" in said


@pytest.mark.slow
@pytest.mark.usefixtures("in_tmp_path")
def test_a_fit_has_three_remarks_at_most(capsys: pytest.CaptureFixture[str]) -> None:
    """Impacts are missing and false ones among them."""
    faults = ["--missed", "0.2", "--spurious", "0.2"]
    assert main(["simulate", "two_mass", "--duration", "30", *faults, "-o", "rig"]) == 0
    capsys.readouterr()
    main(["identify", "rig", "--free", "restitution"])
    remarks = re.findall(r"(?m)^(?:warning|note) .*", capsys.readouterr().out)
    assert len(remarks) <= 3
    assert re.search(r"rejected .* inserted", " ".join(remarks))


@pytest.mark.usefixtures("in_tmp_path")
def test_an_epoch_that_the_bag_does_not_say_is_given(capsys: pytest.CaptureFixture[str]) -> None:
    """A missing epoch is wrong use, in the words of observe."""
    with BagReader(Path(bag(BAG))) as reader:
        events = events_in(reader)
    rows = [f"{each.stamp / NS_PER_S:.9f},stop" for each in events]
    Path("times.csv").write_text("\n".join(rows), encoding="utf-8")
    assert main(["import", "times.csv", "--time-zero", "0", "-o", "times"]) == 0
    words = ["times", "--model", "two_mass"]
    said = set[str]()
    ask = ["observe", "--rate", "10", "-o", "out"]
    for command in (["identify", "--free", "restitution"], ask):
        capsys.readouterr()
        assert main([*command, *words]) == 2
        said.add(capsys.readouterr().err)
    assert len(said) == 1
    epoch = f"{events[0].epoch / NS_PER_S:g}"
    assert main(["identify", *words, "--free", "restitution", "--epoch", epoch]) == 0
    assert "0.7" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.usefixtures("in_tmp_path")
def test_the_drop_height_has_the_error_of_least_squares_on_bounce_times(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Bounce k of a ball from height h is at tau + s (1 + 2 e + .. + 2 e^k), s = sqrt(2 h / g).

    With a known restitution e the instant is linear in tau and s: the error of h is a closed form.
    """
    e, h, g, clock = 0.9, 1.2, 9.81, 1e-3
    powers = e ** np.arange(1, 12)
    A = np.column_stack([np.ones(12), 1 + 2 * np.append(0.0, np.cumsum(powers))])
    times = A @ [0.3, np.sqrt(2 * h / g)] + clock * np.random.default_rng(5).normal(size=12)
    Path("bounces.csv").write_text("\n".join(f"{each:.9f},floor" for each in times.tolist()))
    imported = ["import", "bounces.csv", "--model", "bouncing_ball", "--epoch", "0.4"]
    assert main([*imported, "-o", "bag"]) == 0
    capsys.readouterr()
    words = ["identify", "bag", "--check", "--clock-error", f"{clock}"]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    q, u = found["initial_state"]
    height, slope = q + u**2 / (2 * g), np.array([1.0, u / g])
    error = np.sqrt(slope @ np.array(found["covariance"]) @ slope)
    s = np.linalg.lstsq(A, times)[0][1]
    of_s = clock * np.sqrt(np.linalg.inv(A.T @ A)[1, 1])
    assert height == pytest.approx(g * s**2 / 2, rel=1e-4)
    assert error == pytest.approx(g * s * of_s, rel=1e-2)


@pytest.mark.long
@pytest.mark.usefixtures("in_tmp_path")
def test_a_model_that_does_not_fit_is_said_first_and_written(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The stamps are 4 ms late. With the offset of the clock free the same command ends with 0."""
    assert main(["simulate", "two_mass", "--duration", "30", "--delay", "0.004", "-o", "bag"]) == 0
    capsys.readouterr()
    words = ["identify", "bag", "--clock-error", "0.001"]
    assert main([*words, "--free", "restitution", "-o", "late.yaml"]) == 1
    said = capsys.readouterr()
    first = said.out.splitlines()[0]
    assert first.startswith("error  The model does not fit: ")
    assert "clock-offset 0.00" in said.out
    assert "model: late.yaml, though it does not fit" in said.out
    assert said.err == ""
    assert read_model("late.yaml").provenance is not None
    assert main([*words, "--free", "restitution,clock-offset"]) == 0
    assert "does not fit" not in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.usefixtures("in_tmp_path")
def test_the_verdict_on_a_model_stays_with_it(capsys: pytest.CaptureFixture[str]) -> None:
    """A ball on a floor of two stones: every other bounce loses more than the model has.

    The file says so, and so does whoever reads the file, or a bag that has the model.
    """
    flights = 0.8 * np.cumprod(np.tile([0.9, 0.87], 8))
    times = 1 + np.append(0.0, np.cumsum(flights))
    Path("bounces.csv").write_text("\n".join(f"{each:.9f},floor" for each in times.tolist()))
    imported = ["import", "bounces.csv", "--epoch", "1.9", "--model"]
    words = ["--free", "restitution", "--clock-error", "1e-4", "-o"]
    assert main([*imported, "bouncing_ball", "-o", "bag"]) == 0
    assert main(["identify", "bag", *words, "stones.yaml"]) == 1
    written = read_model("stones.yaml")
    assert written.provenance["fits"] is False
    assert 1e-4 < written.provenance["residual"] < written.shift.largest < 0.02  # type: ignore[operator]
    assert written.shift.interval == pytest.approx(np.mean(flights))
    said, warning = capsys.readouterr().out, "does not fit the impacts"
    assert "model: stones.yaml, though it does not fit" in said
    assert main([*imported, "stones.yaml", "-o", "rig"]) == 0
    states = ["--rate", "5", "-o"]
    for command in (
        ["observe", "rig", "--law", "minimum-variance", *states, "observed"],
        ["smooth", "rig", *states, "smoothed"],
        ["check-model", "stones.yaml", "rig"],
        ["check", "rig"],
        ["check", "bag", "--model", "stones.yaml"],
        ["plot", "observed", "-o", "observed.png"],
        ["identify", "rig", *words, "again.yaml"],
    ):
        capsys.readouterr()
        main(command)
        assert warning in " ".join(capsys.readouterr().out.split()), command[0]
    again = read_model("again.yaml").provenance
    assert again["fits"] is False
    assert again["before"]["fits"] is False  # type: ignore[index]
    assert main(["check-model", "again.yaml"]) == 0
    assert "warning: again.yaml does not fit" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.usefixtures("in_tmp_path")
def test_times_that_were_printed_with_few_digits_fit(capsys: pytest.CaptureFixture[str]) -> None:
    """A ball that bounces once a period; the phase of its table has a closed form.

    Rounding to 10 us repeats itself, which says nothing against the model.
    """
    A, e, rate, first = 0.003, 0.5, 61.7, 0.05
    times = first + 2 * np.pi / rate * np.arange(60)
    text = (shared("config") / "ball_on_table.yaml").read_text()
    Path("table.yaml").write_text(text.replace("62.83185307179586", f"{rate}"))
    Path("times.csv").write_text("\n".join(f"{each:.5f},plate" for each in times.tolist()))
    assert main(["import", "times.csv", "--model", "table.yaml", "-o", "bag"]) == 0
    capsys.readouterr()
    words = "identify bag --free ground-phase -o fit.yaml --json"
    assert main(words.split()) == 0
    assert read_model("fit.yaml").provenance["fits"] is True
    found = json.loads(capsys.readouterr().out)["parameters"]["ground-phase.table.1"]["value"]
    late = np.arccos(np.pi * 9.81 * (1 - e) / ((1 + e) * A * rate**2))
    phases = 1.5 * np.pi - rate * first + np.array([late, -late])  # the same instants of hits
    assert np.min(np.abs(np.remainder(phases - found + np.pi, 2 * np.pi) - np.pi)) < 1e-3


@pytest.mark.parametrize(
    "flights", [0.4 * 1.002 ** np.arange(12), np.random.default_rng(1).uniform(0.2, 1.5, 8)]
)
@pytest.mark.slow
@pytest.mark.usefixtures("in_tmp_path")
def test_useless_values_are_not_written_and_the_last_line_says_why(
    flights: Array, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a ball that rises higher with each bounce, and of random instants."""
    times = 1 + np.append(0.0, np.cumsum(flights))
    Path("bounces.csv").write_text("\n".join(f"{each:.9f},floor" for each in times.tolist()))
    assert main(["import", "bounces.csv", "--model", "bouncing_ball", "-o", "bag"]) == 0
    words = ["--free", "restitution", "--clock-error", "1e-3"]
    assert main(["identify", "bag", *words, "-o", "ball.yaml"]) == 1
    said = capsys.readouterr().out
    last = said.splitlines()[-1]
    assert last == "model: ball.yaml is not written: no motion explains these impacts"
    assert not Path("ball.yaml").exists()


@pytest.mark.parametrize("model", ["two_mass", "ball_on_table", "yielding_stop"])
def test_the_page_on_fitting_names_every_parameter_of_a_model(model: str) -> None:
    """By the kind of the parameter, with NAME and the like after the dot."""
    page = (Path(__file__).parents[2] / "docs" / "fitting.md").read_text(encoding="utf-8")
    read = read_model(model)
    for parameter in parameters_beside(parametric_family(read.system, (), read.elements)):
        kind, *owner = parameter.name.split(".")
        form = r"\.".join([kind, *("[A-Z]+" for _ in owner)])
        assert re.search(f"`{form}`", page), parameter.name


def test_a_prior_leaves_no_more_samples_out_near_impacts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The declared clock error decides which samples may lie before or after an impact."""
    bag, known = str(tmp_path / "bag"), tmp_path / "known.yaml"
    given = ("--measurements", "encoder", "--measurement-rate", "100", "-o", bag)
    assert main(["simulate", "two_mass", "--duration", "12", "--jitter", "1e-4", *given]) == 0
    text = shared("config/two_mass.yaml").read_text(encoding="utf-8")
    known.write_text(
        text.replace("restitution: 0.7", "restitution: {value: 0.7, deviation: 0.01}"), "utf-8"
    )
    left_out = []
    for model in ("two_mass", str(known)):
        options = ("--measurements", "encoder", "--clock-error", "1e-4", "--free", "restitution")
        capsys.readouterr()
        assert main(["identify", bag, "--model", model, *options, "--json"]) == 0
        (sensor,) = json.loads(capsys.readouterr().out)["sensors"]
        left_out.append(sensor["near"])
    assert left_out[0] == left_out[1]
