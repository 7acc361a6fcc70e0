# SPDX-License-Identifier: Apache-2.0
"""The examples run, and what they say is so."""

import re
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from impact_observer.cli.main import main

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
PICTURES = ("basins", "beam", "drill", "drop_height", "encoder", "gears", "hammer_arm", "shaker")
"""Those that draw one."""


def example(name: str) -> dict[str, Any]:
    """What an example defines."""
    return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name=name)


@pytest.fixture
def drawn(
    in_tmp_path: None,  # noqa: ARG001
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Callable[..., Any]:
    """Of an example, started as a user does with arguments: what its picture is made of.

    Some of its numbers may be other ones.
    """

    def start(name: str, *arguments: str, **numbers: float) -> Any:  # noqa: ANN401
        monkeypatch.setattr("sys.argv", [f"{name}.py", *arguments])
        code, given = example(name)["main"].__globals__, list[Any]()
        picture = code["picture"]

        def draw(*found: Any) -> None:  # noqa: ANN401
            given.extend(found)
            picture(*found)

        code |= numbers | {"picture": draw}
        code["main"]()
        assert capsys.readouterr().out.splitlines()[-1] == f"picture: {name}.png"
        assert Path(f"{name}.png").stat().st_size > 5000
        return given[-2]

    return start


def test_every_example_is_on_the_page_and_has_its_picture() -> None:
    """A file, a picture, a paragraph."""
    page = (EXAMPLES / "README.md").read_text()
    names = {path.stem for path in EXAMPLES.glob("*.py")}
    assert names == {*PICTURES, "serial_switch"}
    for name in names:
        assert f"({name}.py)" in page
    for name in PICTURES:
        assert f"(images/{name}.png)" in page


@pytest.mark.slow
def test_a_drill_has_blows_of_two_kinds_and_both_are_estimated(
    drawn: Callable[..., Any],
) -> None:
    """From a sensor that misses some and reports false ones."""
    found = drawn("drill", "--seconds", "1", RATE=1000.0)
    late = found.blow_times > 0.5
    true, estimated = found.blows[late].T
    assert true.max() > 4 * true.min()
    np.testing.assert_allclose(estimated, true, rtol=0.05)


@pytest.mark.slow
def test_clicks_of_gears_are_of_the_right_flank(drawn: Callable[..., Any]) -> None:
    """Of clicks that all name the same one."""
    found = drawn("gears", "--seconds", "1", RATE=400.0)
    true, estimated = found.back[3:].T
    np.testing.assert_array_equal(estimated, true)
    assert 0 < true.sum() < true.size
    assert np.abs(found.estimates - found.truth)[found.times > 0.5].max() < 1e-4


@pytest.mark.slow
def test_a_drop_height_is_that_of_the_closed_form(drawn: Callable[..., Any]) -> None:
    """Of clicks at 2 v eps^k / g after each other, read to 0.1 ms."""
    code = example("drop_height")
    height, restitution, gravity = 1.234, 0.82, code["GRAVITY"]
    flights = 2 * np.sqrt(2 * height / gravity) * restitution ** np.arange(1, 8)
    clicks = 1.201 + np.concatenate([[0.0], np.cumsum(flights)])
    assert tuple(clicks.round(4)) == code["CLICKS"]
    found = drawn("drop_height")
    assert found.height == pytest.approx(height, abs=3 * found.height_error)
    assert found.restitution == pytest.approx(restitution, abs=3 * found.restitution_error)
    assert found.height_error < 1e-3


@pytest.mark.slow
def test_the_page_has_the_commands_that_print_a_drop_height(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As they stand there, of the clicks and the model of the example."""
    code, page = example("drop_height"), (EXAMPLES / "README.md").read_text()
    monkeypatch.chdir(tmp_path)
    Path("ball.yaml").write_text(code["MODEL"])
    Path("clicks.csv").write_text("\n".join(["time", *map(str, code["CLICKS"])]))
    commands = re.findall(r"^    impact-observer ((?:import|identify) .*)$", page, re.MULTILINE)
    assert len(commands) == 2
    assert [main(command.split()) for command in commands] == [0, 0]
    printed = capsys.readouterr().out
    q, u = (
        float(re.findall(rf"{name} at the start +(\S+)", printed)[0])
        for name in ("height", "dheight/dt")
    )
    assert q + u**2 / (2 * code["GRAVITY"]) == pytest.approx(1.234, abs=1e-3)


@pytest.mark.long
def test_the_shape_of_a_beam_follows_from_its_tip(drawn: Callable[..., Any]) -> None:
    """V never rises, and falls by four orders in half a second."""
    found = drawn("beam", "--seconds", "0.5")
    assert np.all(np.diff(found.distances) < 1e-9 * found.distances[0])
    assert found.distances[-1] < 1e-4 * found.distances[0]
    assert found.events > 100


@pytest.mark.long
def test_a_shaker_shows_how_its_clocks_differ(drawn: Callable[..., Any]) -> None:
    """A third of a percent of the offset, and 30 um of the part."""
    found = drawn("shaker", "--seconds", "1.5", RATE=400.0)
    assert found.offsets[-1] == pytest.approx(example("shaker")["OFFSET"], abs=3e-5)
    assert found.error() < 5e-5


@pytest.mark.slow
def test_encoder_and_impacts_know_more_together(drawn: Callable[..., Any]) -> None:
    """Before the impacts alone determine the state."""
    errors = drawn("encoder", "--seconds", "6.1").typical(2.0, 5.0)
    assert errors["both"] < 0.3 * min(errors["impacts"], errors["encoder"])


@pytest.mark.slow
def test_velocity_of_an_arm_is_known_through_a_hit(drawn: Callable[..., Any]) -> None:
    """Ten times better than by differences of its encoders, and within its own deviations."""
    pytest.importorskip("pinocchio", reason="not installed: extra robots")
    found = drawn("hammer_arm", "--seconds", "1.25")
    assert found.hits.size == 1
    assert found.error(found.observed) < found.error(found.differences) / 10
    z = (found.observed - found.truth) / found.deviations
    assert np.percentile(np.abs(z), 95) < 2.5


@pytest.mark.long
def test_basins_hold_two_motions(drawn: Callable[..., Any]) -> None:
    """Both motions are there, and a start has the same one whatever the grid."""
    code = example("basins")
    found = drawn("basins", "--starts", "7", "--jobs", "1")
    assert {1.0, 3.0} <= set(np.unique(found))
    assert np.mean((found == 1) | (found == 3)) > 0.9
    assert code["period"]((code["POSITIONS"][0], code["VELOCITIES"][1])) == found[-1, 0]
