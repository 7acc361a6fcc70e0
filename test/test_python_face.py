# SPDX-License-Identifier: Apache-2.0
"""What Python users import from the package itself."""

import json
import os
import pydoc
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from impact_observer import (
    Estimate,
    Observer,
    Options,
    Plant,
    grid,
    law_named,
    make_observer,
    parse_model,
    read_model,
    replay,
    simulate,
)
from impact_observer.errors import ModelError, UsageError
from impact_observer.options import OBSERVER_OPTIONS
from impact_observer.resources import shared

ROOT = Path(__file__).resolve().parents[1]
EPOCH = 1_000_000_000
STAMPS = grid(EPOCH, EPOCH + 3_000_000_000, 20.0)
PATH = shared("config/two_mass.yaml")
MODEL = read_model(PATH)
WANTED = "expected a Model, a System, or the path of a model file"


@pytest.mark.parametrize(
    "source", [MODEL, PATH, str(PATH), "two_mass"], ids=["Model", "Path", "text", "sample"]
)
def test_plants_and_observers_take_a_model_or_its_path(source: Any) -> None:  # noqa: ANN401
    """Each gives what it gives of the system and its initial state."""
    q, u = MODEL.initial_state()
    expected = simulate(Plant(MODEL.system, q, u, epoch=EPOCH), STAMPS)
    for run in (simulate(source, STAMPS), simulate(Plant(source, epoch=EPOCH), STAMPS)):
        np.testing.assert_array_equal(run.states, expected.states)
        assert run.events == expected.events
    law = law_named("geometric")(MODEL.system)
    for observer in (
        Observer(MODEL.system, law, q, u, epoch=EPOCH),
        Observer(source, law, q, u, epoch=EPOCH),
        make_observer(source, Options(law="geometric", initial_state="0.1,-0.2,0.5,0")),
    ):
        *_, last = replay(observer, expected.events, STAMPS)
        assert isinstance(last, Estimate)
        np.testing.assert_allclose([*last.q, *last.u], expected.states[-1], rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (lambda: make_observer(3), f"make_observer: int found; {WANTED}"),  # type: ignore[arg-type]
        (lambda: Plant(None, epoch=1), f"Plant: NoneType found; {WANTED}"),  # type: ignore[arg-type]
        (lambda: simulate({}, STAMPS), f"simulate: dict found; {WANTED}"),  # type: ignore[arg-type]
        (
            lambda: Observer([], law_named("geometric"), [0], [0]),  # type: ignore[arg-type]
            f"Observer: list found; {WANTED}",
        ),
        (
            lambda: Observer("two_mass", "geometric", [0], [0]),  # type: ignore[arg-type]
            "Observer: 'geometric' found; expected law_named(NAME)(system)",
        ),
        (
            lambda: make_observer("two_mass", "geometric"),  # type: ignore[arg-type]
            "make_observer: 'geometric' found; expected Options(), by default None",
        ),
        (
            lambda: make_observer(PATH.read_text("utf-8")),
            "make_observer: a text of several lines found",
        ),
        (
            lambda: Plant("two_mass", np.zeros(2), epoch=1),
            "Plant: position or velocity is missing; expected both, or none",
        ),
    ],
)
def test_what_is_no_model_is_one_line_that_says_what_was_wanted(
    call: Callable[[], object], line: str
) -> None:
    """With the name of the function, and what was found."""
    with pytest.raises(UsageError) as caught:
        call()
    assert str(caught.value).startswith(line)


@pytest.mark.slow
def test_mypy_finds_the_installed_package_with_its_types_and_nothing_else(tmp_path: Path) -> None:
    """From another folder: a wrong argument is one, and the folders beside the package are not."""
    installed = json.loads(distribution("impact_observer").read_text("direct_url.json") or "{}")
    if installed.get("url") != ROOT.as_uri():
        pytest.skip("another checkout is installed here: ./dev setup")
    script = tmp_path / "mine.py"
    script.write_text(
        "from impact_observer import Plant, make_observer\n"
        "Plant(3, epoch=1)\n"
        "reveal_type(make_observer('two_mass'))\n"
        "import launch.demo, benchmarks, docs.tables\n"
    )
    cache = ["--cache-dir", str(ROOT / ".mypy_cache")]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--no-color-output", *cache, script.name],
        cwd=tmp_path,
        env={name: each for name, each in os.environ.items() if name != "PYTHONPATH"},
        capture_output=True,
        text=True,
        check=False,
    )
    found = [line.partition("mine.py:")[2] for line in done.stdout.splitlines()]
    assert found[0].startswith('2: error: Argument 1 to "Plant" has incompatible type "int"')
    assert found[1].endswith('Revealed type is "impact_observer.observer.observer.Observer"')
    missing = [f'module named "{name}"' for name in ("launch", "benchmarks", "docs")]
    assert all(any(name in line for line in found[2:]) for name in missing), done.stdout


def test_a_plant_of_a_model_without_initial_state_names_the_key() -> None:
    """A system has none either."""
    text = PATH.read_text("utf-8").partition("initial_state")[0]
    for source in (parse_model(text, "rig"), MODEL.system):
        with pytest.raises(ModelError, match="initial_state: is missing; a plant needs one"):
            Plant(source, epoch=1)


def test_models_runs_and_observers_are_shown_in_one_line() -> None:
    """With what tells one from another, and without their arrays."""
    plant = Plant(MODEL.system, *MODEL.initial_state(), epoch=EPOCH)
    run, observer = simulate(plant, STAMPS), make_observer(MODEL.system, Options())
    assert repr(MODEL) == "<Model two_mass: contacts stop>"
    assert repr(run).startswith(f"<Run: epoch {EPOCH} ns, {len(STAMPS)} states, ")
    assert repr(observer).startswith("<Observer of two_mass: law geometric, 10 replicas, ")
    assert "hammer" in repr(read_model("hammer"))
    for each in (run, observer, read_model("hammer")):
        assert len(repr(each).splitlines()) == 1


def test_help_has_the_meaning_of_each_option() -> None:
    """As the table has it, once."""
    shown = " ".join(pydoc.plain(pydoc.render_doc(Options)).split())
    for row in OBSERVER_OPTIONS:
        assert shown.count(f"{row.name}: {row.summary}") == 1
