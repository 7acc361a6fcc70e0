# SPDX-License-Identifier: Apache-2.0
"""The rows of ``./dev bench``."""

from pathlib import Path

import pytest

from benchmarks.__main__ import GROUPS, chosen, main, measured
from benchmarks.checkout import HERE, Checkout, FailedError, Figure, Figures, Row


def test_there_is_a_row_for_each_of_56_wrong_plants() -> None:
    """And for six exact ones; every name occurs once."""
    names = [row.name for row in GROUPS["honesty"]]
    assert len([name for name in names if "exact" not in name]) == 56
    assert len(names) == 62
    every = [row.name for rows in GROUPS.values() for row in rows]
    assert len(set(every)) == len(every)


def test_rows_are_chosen_by_group_name_and_pattern() -> None:
    """An unknown name is wrong use."""
    assert chosen(["accuracy"]) == [*GROUPS["accuracy"]]
    assert [row.name for row in chosen(["plant", "laws*"])] == [
        "plant",
        "laws, two_mass",
        "laws, three_mass",
    ]
    with pytest.raises(SystemExit) as end:
        main(["nothing"])
    assert end.value.code == 2


def test_two_checkouts_are_measured_by_their_own_commands(tmp_path: Path) -> None:
    """Each by the command in its ``.venv``; a figure of both is compared."""
    made = []
    for name in ("before", "after"):
        script = tmp_path / name / ".venv" / "bin" / "impact-observer"
        script.parent.mkdir(parents=True)
        script.write_text(f"#!/bin/sh\necho {name} $1\n", "utf-8")
        script.chmod(0o755)
        made.append(Checkout(tmp_path / name))

    def length(checkout: Checkout, folder: Path, _: int) -> Figures:
        return {"letters": Figure(len(checkout.run(folder, "word").output))}

    rounds = measured(Row("own", "", length), made, 2)
    assert [[each.value for each in pair] for pair in rounds["letters"]] == [[12, 11], [12, 11]]


@pytest.mark.skipif(not (HERE / ".venv").exists(), reason="no .venv: ./dev setup makes it")
def test_a_command_that_fails_is_named(tmp_path: Path) -> None:
    """With the last line of its errors."""
    with pytest.raises(FailedError, match=r"^check nothing: impact-observer: nothing"):
        Checkout(HERE).run(tmp_path, "check", "nothing")
    with pytest.raises(FailedError, match=r"no \.venv found; run \./dev setup there"):
        Checkout(tmp_path)
