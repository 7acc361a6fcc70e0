# SPDX-License-Identifier: Apache-2.0
"""How good the estimates are: laws, troubles of the sensor, and robots.

V is the energy of the error; runs are those of ``sweep``, whose starts are standard normal.
"""

import json
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks.checkout import Checkout, Figure, Figures, Row

LAWS = "open-loop,kinematic,geometric,unilateral,minimum-variance"
TROUBLES: dict[str, tuple[str, ...]] = {
    "ideal": (),
    "jitter of 1 ms, declared": ("--jitter", "0.001", "--clock-error", "0.001"),
    "jitter of 1 ms": ("--jitter", "0.001"),
    "20 % spurious": ("--spurious", "0.15"),
    "20 % missed": ("--missed", "0.2"),
    "20 % missed, 20 % spurious": ("--missed", "0.2", "--spurious", "0.15"),
    "10 ms late": ("--delay", "0.01", "--clock-offset-error", "0.02"),
}
"""Faults of the sensor, and those that the observer declares; 0.15 false positives a second."""


def swept(checkout: Checkout, folder: Path, model: str, *words: str) -> pd.DataFrame:
    """The rows of a sweep."""
    checkout.run(folder, "sweep", model, *words, "--jobs", "2", "-o", "rows.parquet")
    return pd.read_parquet(folder / "rows.parquet")


def laws(checkout: Checkout, folder: Path, seed: int, *, model: str) -> Figures:
    """Median V/V0 of 20 starts after 30 s, ideal events, exact model."""
    rows = swept(checkout, folder, model, "--laws", LAWS, "--runs", "20", "--seed", str(20 * seed))
    ratios = rows.groupby("law", sort=False).V_ratio.median()
    return {f"V/V0, {law}": Figure(float(ratio)) for law, ratio in ratios.items()}


def troubles(
    checkout: Checkout, folder: Path, seed: int, *, model: str, words: tuple[str, ...]
) -> Figures:
    """Median and worst V/V0 of 40 starts after 60 s."""
    runs = ("--duration", "60", "--runs", "40", "--seed", str(40 * seed))
    chosen = ("--laws", "minimum-variance,geometric")
    rows = swept(checkout, folder, model, *chosen, *runs, *words)
    found = {}
    for law, own in rows.groupby("law", sort=False):
        found[f"V/V0, {law}, median"] = Figure(float(own.V_ratio.median()))
        found[f"V/V0, {law}, worst"] = Figure(float(own.V_ratio.max()))
    return found


def compared(checkout: Checkout, folder: Path, bag: str) -> dict[str, Any]:
    """The metrics of ``compare --json``, by observer."""
    text = checkout.run(folder, "compare", bag, "--json").output
    found: dict[str, Any] = json.loads(text[text.index("{") :])
    return found


def robot(checkout: Checkout, folder: Path, seed: int, *, law: str) -> Figures:
    """hammer_arm by encoders of 1 mrad at 200 Hz and hits whose stamps jitter by 0.2 ms."""
    given = ("--measurements", "hammer_arm")
    how = ("--duration", "20", "--rate", "200", "--seed", seed, "--jitter", "0.0002")
    checkout.run(
        folder, "simulate", "hammer_arm", *how, *given, "--measurement-rate", "200", "-o", "bag"
    )
    declared = ("--clock-error", "0.0002") if law == "minimum-variance" else ()
    checkout.run(folder, "observe", "bag", "--law", law, *declared, *given, "-o", "observed")
    metrics = compared(checkout, folder, "observed")[law]
    found = {"velocities after hits, rms": Figure(metrics["velocity_after_hits"], "rad/s")}
    if metrics["coverage"]:
        found["within three deviations, worst"] = Figure(min(metrics["coverage"]))
    return found


def smoothed(checkout: Checkout, folder: Path, seed: int, *, model: str) -> Figures:
    """V at the start of 30 s whose stamps jitter by 1 ms, of the smoother and of the filter."""
    how = ("--duration", "30", "--seed", seed, "--jitter", "0.001", "-o", "bag")
    checkout.run(folder, "simulate", model, *how)
    declared = ("--clock-error", "0.001", "-o")
    checkout.run(folder, "observe", "bag", "--law", "minimum-variance", *declared, "observed")
    checkout.run(folder, "smooth", "bag", *declared, "smoothed")
    filtered = compared(checkout, folder, "observed")["minimum-variance"]
    found = compared(checkout, folder, "smoothed")["smoother"]
    return {
        "V at the start, smooth": Figure(found["V_start"], "J"),
        "V at the end, observe": Figure(filtered["V_end"], "J"),
    }


_SAMPLES = ("two_mass", "three_mass")
ROWS = (
    *(
        Row(f"laws, {model}", "how good are the laws?", partial(laws, model=model))
        for model in _SAMPLES
    ),
    *(
        Row(
            f"troubles, {model}, {name}",
            "what do faults of the sensor cost?",
            partial(troubles, model=model, words=words),
        )
        for model in _SAMPLES
        for name, words in TROUBLES.items()
    ),
    *(
        Row(f"robots, {law}", "how well are velocities known?", partial(robot, law=law))
        for law in ("minimum-variance", "measured-position")
    ),
    *(
        Row(f"smooth, {model}", "how good is the start?", partial(smoothed, model=model))
        for model in _SAMPLES
    ),
)
"""Rows of ``./dev bench accuracy``."""
