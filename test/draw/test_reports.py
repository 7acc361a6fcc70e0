# SPDX-License-Identifier: Apache-2.0
"""Reports as text: words, figures, facts and tables, at a pipe and on terminals."""

import io
import re
import sys

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from systems import examples

from impact_observer.draw.reports import (
    TextTable,
    counted,
    figure,
    listed,
    print_facts,
    print_table,
)

TABLE = TextTable(
    ("contact", "gap [m]", "restitution", "used by"),
    [
        ("anvil", "0.25", "0.7", "the observer on the rig and the plant in the model"),
        ("wall[1]", "-1.5e-05", "0.8 to 0.9", "nobody"),
    ],
    title="Contacts of the rig",
    words=("used by",),
)


class Terminal(io.StringIO):
    """A text file that is taken for a terminal."""

    def isatty(self) -> bool:
        """Return True, as of a terminal."""
        return True


def test_at_a_pipe_each_row_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows of any length ignore COLUMNS; names are printed literally."""
    monkeypatch.setenv("COLUMNS", "20")
    print_table(TABLE)
    title, headings, *rows = capsys.readouterr().out.splitlines()
    assert title == TABLE.title
    assert re.split("  +", headings) == list(TABLE.headings)
    assert [re.split("  +", row) for row in rows] == [list(row) for row in TABLE.rows]


@pytest.mark.parametrize("columns", [160, 40])
def test_on_a_terminal_tables_are_whole_and_facts_are_folded(
    columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A row is a line, which the terminal may wrap; no word of a fact is lost."""
    terminal, fact = Terminal(), "word " * 30
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", str(columns))
    print_table(TABLE)
    print_facts([("note", fact)])
    lines = re.sub(r"\x1b\[[0-9;]*m", "", terminal.getvalue()).splitlines()
    assert [re.split("  +", row) for row in lines[2:4]] == [list(row) for row in TABLE.rows]
    assert max(map(len, lines[4:])) <= columns
    assert " ".join(lines[4:]).split() == ["note", *fact.split()]


def test_a_table_without_rows_has_its_headings(capsys: pytest.CaptureFixture[str]) -> None:
    """A table without rows has headings and nothing else."""
    print_table(TextTable(("contact", "gap [m]"), []))
    assert capsys.readouterr().out.split() == ["contact", "gap", "[m]"]


def test_rows_of_another_length_are_refused() -> None:
    """The error names the row."""
    with pytest.raises(ValueError, match=r"row \('a',\)"):
        TextTable(("contact", "gap [m]"), [("a",)])


def test_facts_cannot_control_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """Control characters of names are escaped; no fact prints nothing."""
    print_facts([("warning", "a\x1b[31mb"), ("ok", "fine")])
    assert capsys.readouterr().out == "warning  a\\x1b[31mb\nok       fine\n"
    print_facts([])
    assert capsys.readouterr().out == ""


def test_words_are_counted_and_listed() -> None:
    """Counts have singular and plural; a long list says how many words are left out."""
    assert [counted(n, "event") for n in (0, 1, 2)] == ["0 events", "1 event", "2 events"]
    assert counted(2, "mass", "es") == "2 masses"
    assert [listed(words) for words in ("", "a", "ab", "abc")] == [
        "none",
        "a",
        "a and b",
        "a, b and c",
    ]
    assert listed("abc", joint=" or ") == "a, b or c"
    assert listed("abcdef", most=3) == "a, b and 4 more"


@given(value=st.floats(-1e9, 1e9), deviation=st.floats(1e-12, 1e9))
@examples(200)
def test_values_are_shown_to_the_second_digit_of_their_deviation(
    value: float, deviation: float
) -> None:
    """Neither a significant digit is cut off nor another digit shown."""
    assume(deviation > 1e-12 * abs(value))
    shown, sign, spread, unit = figure(value, "m", deviation).split()
    assert (sign, unit) == ("+-", "m")
    assert float(spread) == pytest.approx(deviation, rel=0.06)
    assert (
        abs(float(shown) - value) <= 0.06 * deviation + 1e-14 * abs(value)
        or abs(value) < 0.6 * deviation
    )
    digits = len(shown.partition("e")[0].replace("-", "").replace(".", "").lstrip("0"))
    assert digits <= max(np.log10((abs(value) or deviation) / deviation) + 3, 1)


def test_values_without_a_deviation_are_shown_alone() -> None:
    """Parameters at their bounds have no deviation."""
    assert figure(0.0) == "0"
    assert figure(2.88675135e-10, "s") == "2.89e-10 s"
    assert figure(0.70061256, deviation=0.0039) == "0.7006 +- 0.0039"


def test_rounding_is_no_deviation_and_zero_has_the_digits_of_its_deviation() -> None:
    """A learned 0.1 ms +- 1e-19 has three digits; a phase of 0 is known to two of its own."""
    assert figure(1e-4, "s", 1e-19) == "0.0001 s"
    assert figure(0.0, "rad", 0.16) == "0.00 +- 0.16 rad"
    assert figure(0.0, "N", 12.0) == "0 +- 12 N"
