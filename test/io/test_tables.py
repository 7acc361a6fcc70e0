# SPDX-License-Identifier: Apache-2.0
"""Tables as instruments, phones, trackers and loggers write them."""

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.errors import UsageError
from impact_observer.io.signals import Signal, read_signal
from impact_observer.io.tables import TableForm, read_table

SECOND = 1_000_000_000
RATE = 2000
STEP = 500_000  # ns
VALUES = np.round(np.random.default_rng(1).normal(scale=20.0, size=60), 4)
Row = Callable[[int, float, float], str]


def table(header: str, row: Row, end: str = "\n") -> str:
    """A table with a row for each sample: its number, its time in s and its value."""
    rows = (row(k, k / RATE, value) for k, value in enumerate(VALUES.tolist()))
    return header + "\n".join(rows) + end


def plain(k: int, t: float, a: float) -> str:
    """A row with time and value."""
    del k
    return f"{t:.6f},{a:.4f}"


def commas(k: int, t: float, a: float) -> str:
    """A row with decimal commas, and a second value."""
    return f"{plain(k, t, a)},0.5".replace(",", ";").replace(".", ",")


def millis(k: int, t: float, a: float) -> str:
    """A row with the time in ms."""
    return plain(k, 1000 * t, a)


def dated(separator: str) -> Row:
    """Rows with dates, whose fraction of a second is left out where it is zero."""
    zero = datetime(2016, 5, 23, 21, 46, 20)  # noqa: DTZ001 (without a zone)

    def row(k: int, t: float, a: float) -> str:
        del k
        return f"{(zero + timedelta(seconds=t)).isoformat(separator)},{a:.4f}"

    return row


def read(folder: Path, text: str | bytes, form: TableForm | None = None) -> Signal:
    """The signal in a table."""
    path = folder / "table.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_signal(path, form)


def times(folder: Path, text: str, form: TableForm | None = None) -> list[int]:
    """The times in a table, ns."""
    path = folder / "table.csv"
    path.write_text(text, encoding="utf-8")
    return [*map(int, read_table(path, form or TableForm(), "time, value").times)]


PREAMBLE = (
    "Report;\nDate;01.02.2024\nTime;10:11:12\nRate;2000 Hz\nChannels;2\nPre-trigger;0,1 s\n\n"
)
LVM = (
    "LabVIEW Measurement\t\nDate\t2024/05/01\nTime\t14:37:48.2\n***End_of_Header***\t\n\t\n"
    "Channels\t2\t\nDate\t2024/05/01\t2024/05/01\t\nX0\t0.0E+0\t0.0E+0\t\nDelta_X\t0.5\t0.5\t\n"
    "***End_of_Header***\t\t\t\nX_Value\tDev0/Ai0\tSlow\tComment\n"
)
BESIDE = {0: "Record Length,60", 1: "Sample Interval,0.0005", 6: "Source,CH1"}
BY_RATE = TableForm(frame_rate=Fraction(4000, 2))
LAYOUTS: dict[str, tuple[str, str, TableForm]] = {
    "preamble": (table(PREAMBLE + "Time;Hammer;ACC\n", commas), "Hammer", TableForm()),
    "skipped": (table("1,2\n3,4\n", plain), "value", TableForm(skip_rows=2)),
    "units": (table("Time,Hammer\n[ms],[N]\n\n", millis), "Hammer [N]", TableForm()),
    "keysight": (
        table("x-axis,1\nsecond,Volt\n", lambda _, t, a: f"{t:+.8E},{a:+.8E}"),
        "1 (Volt)",
        TableForm(),
    ),
    "rigol_times": (
        table("X,CH1,CH2,\nSecond,Volt,Volt,\n", lambda _, t, a: f"{t:.5e},{a:.8e},4.88e+00,"),
        "CH1 (Volt)",
        TableForm(),
    ),
    "rigol": (
        table(
            "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,0.0e+00,5.000000e-04\n",
            lambda k, _, a: f"{k},{a:.4f},1.0,",
        ),
        "CH1",
        TableForm(),
    ),
    "tektronix_beside": (
        table("", lambda k, t, a: f"{BESIDE.get(k, ',')},,{t:.6f},{a:.4f},"),
        "value",
        TableForm(),
    ),
    "tektronix_above": (
        table(
            "Model,MSO54\nHorizontal Units,s,,Horizontal Units,s\n,,,,\nLabel,hammer,,Label,D0\n"
            "TIME,CH1,,TIME,D0\n",
            lambda _, t, a: f"{t:.6e},{a:.4f},,{t:.6e},0",
        ),
        "CH1",
        TableForm(),
    ),
    "picoscope": (
        table("Time;Kanal A;Kanal B\n(ms);(V);(mV)\n\n", lambda k, t, a: commas(k, 1000 * t, a)),
        "Kanal A (V)",
        TableForm(),
    ),
    "siglent": (
        table(
            "Record Length,Analog:1000\nModel Number,SDS1104X-E\nSource,CH1\nSecond,Value\n",
            lambda _, t, a: f"{t:+.6E},{a:+.8E}",
        ),
        "CH1 (Value)",
        TableForm(),
    ),
    "lecroy": (
        table(
            "LECROYWR104Xi,58940,Waveform\nSegment,TrigTime,TimeSinceSegment1\n"
            "#1,17-Dec-2018 10:52:33,0\nTime,Ampl\n",
            plain,
        ),
        "Ampl",
        TableForm(),
    ),
    "labview": (
        table(LVM, lambda k, t, a: f"{t:.6f}\t{a:.4f}\t{'' if k % 10 else '7.25'}"),
        "Dev0/Ai0",
        TableForm(),
    ),
    "commented": (table("# by a logger\n#time [ms],az\n", millis), "az", TableForm()),
    "comments": (table("# by a logger\n", plain), "value", TableForm()),
    "savetxt": (table("", lambda _, t, a: f"{t:.18e} {a:.18e}"), "value", TableForm()),
    "aligned": (
        table("   time (s)      az\n", lambda _, t, a: f"{t:10.4f}{a:12.4f}"),
        "az",
        TableForm(),
    ),
    "blanks_and_commas": (
        table("time az\n", lambda _, t, a: f"{t:.4f} {a:.4f}".replace(".", ",")),
        "az",
        TableForm(),
    ),
    "quoted_commas": (
        table("time,az\n", lambda _, t, a: f'"{t:.4f}","{a:.4f}"'.replace(".", ",")),
        "az",
        TableForm(separator="comma", decimal="comma"),
    ),
    "hundreds": (
        table("t [100ms], |a| [m/s^2], az\n", lambda _, t, a: f"{10 * t:.4f}, 9, {a:.4f}"),
        "az",
        TableForm(),
    ),
    "named": (
        table("a,when\n", lambda _, t, a: f"{a},{t:.4f}"),
        "a",
        TableForm(time_column="when"),
    ),
    "rows": (table("az\n", lambda *sample: f"{sample[2]:.4f}"), "az", BY_RATE),
    "frames": (
        table("Frame\tX1\tFlag1\nTracks 1 to 1\n", lambda k, _, a: f"{k}\t{a:.4f}\t ")
        + "\nTrack\tLength\tNr\n1\t219.7\t191\n",
        "X1",
        BY_RATE,
    ),
    "first_cells_missing": (table("time,az\n-0.0005,\n", plain), "az", TableForm()),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_tables_of_instruments_are_read(tmp_path: Path, name: str) -> None:
    """Times and values are those written, whatever stands around the rows."""
    text, column, form = LAYOUTS[name]
    signal = read(tmp_path, text, form)
    there = ~np.isnan(signal.columns[column])
    np.testing.assert_array_equal(signal.columns[column][there], VALUES)
    np.testing.assert_array_equal(
        signal.stamps[there], SECOND + STEP * np.arange(VALUES.size, dtype=np.int64)
    )


@pytest.mark.parametrize("text", ["0.1 0.25 0.61 0.99\n", "0.1, 0.25, 0.61, 0.99, 1.3\n"])
def test_times_on_one_line_are_refused(tmp_path: Path, text: str) -> None:
    """All but the first would be columns of a single row."""
    (tmp_path / "a.txt").write_text(text, "utf-8")
    with pytest.raises(UsageError, match="line 1"):
        read_table(tmp_path / "a.txt", TableForm(), "times")


def test_the_line_of_the_header_is_said_where_others_are_above(tmp_path: Path) -> None:
    """What stands above is not read."""
    assert read(tmp_path, table("time,az\n", plain)).times == "times in s"
    assert read(tmp_path, LAYOUTS["preamble"][0]).times == "times in s, header in line 8"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_old_encodings_are_read(tmp_path: Path, encoding: str) -> None:
    """A table that is no UTF-8 is read with a remark."""
    text = table("Time (\xb5s),a (m/s\xb2)\r\n", lambda k, t, a: plain(k, 1e6 * t, a)).encode(
        encoding
    )
    signal = read(tmp_path, text)
    assert [*signal.columns] == ["a (m/s\xb2)"]
    assert signal.stamps[1] == SECOND + STEP
    assert bool(signal.remarks) == (encoding == "cp1252")


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("time,az\n", dated(" ")),
        ("Timestamp,az\n", dated("T")),
        ("Date,Time,az\n", dated(",")),
        ("Datum,Uhrzeit,az\n,,[g]\n", dated(",")),
        ("time;az\n", lambda *s: dated(" ")(*s).replace(",", ";").replace(".", ",")),
        (
            "time;az\n",
            lambda *s: dated(" ")(*s).replace("2016-05-23", "23.5.2016").replace(",", ";"),
        ),
    ],
    ids=["blank", "iso", "two_columns", "units", "comma", "german"],
)
def test_dates_are_stamps(tmp_path: Path, header: str, row: Row) -> None:
    """Dates without a zone are in UTC, and stamps count from 1970."""
    signal = read(tmp_path, table(header, row))
    zero = 1_464_039_980 * SECOND  # date -u -d '2016-05-23 21:46:20' +%s
    assert signal.zero == 0
    np.testing.assert_array_equal(signal.stamps, zero + STEP * np.arange(VALUES.size))


@examples(100)
@given(
    moment=st.datetimes(datetime(1971, 1, 1), datetime(2037, 1, 1)),  # noqa: DTZ001
    part=st.integers(0, 999),
    minutes=st.integers(-14 * 60, 14 * 60),
)
def test_dates_are_exact_to_the_nanosecond(
    tmp_path_factory: pytest.TempPathFactory, moment: datetime, part: int, minutes: int
) -> None:
    """Dates with nine decimals and a zone are those of numpy, minus the zone."""
    text = f"{moment.isoformat(timespec='microseconds')}{part:03d}"
    sign, (hours, rest) = "-" if minutes < 0 else "+", divmod(abs(minutes), 60)
    written = f"timestamp,a\n{text}{sign}{hours:02d}:{rest:02d},1\n"
    expected = np.datetime64(text, "ns").astype(np.int64) - minutes * 60 * SECOND
    assert times(tmp_path_factory.mktemp("dates"), written) == [int(expected)]


UNITS = {
    "time": 1,
    "Time (sec)": 1,
    "Second": 1,
    "elapsed_s": 1,
    "Time (msec)": 1e-3,
    "Millis": 1e-3,
    "time_msec": 1e-3,
    "Timestamp (ms)": 1e-3,
    "timestampMs": 1e-3,
    "Time (µs)": 1e-6,
    "timestamp_us": 1e-6,
    "TimeUS": 1e-6,
    "stamp_ns": 1e-9,
    "Time (min)": 60,
    "Time [h]": 3600,
    "t [100ms]": 0.1,
    "Elapsed (100 ms)": 0.1,
    "time/ms": 1e-3,
    "Czas [s]": 1,
}


@pytest.mark.parametrize("name", UNITS)
def test_a_unit_in_the_name_of_the_time_counts(tmp_path: Path, name: str) -> None:
    """Units stand in brackets, behind a line, in words, or with a number; an option overrides."""
    for form in (TableForm(), TableForm(time_column=name)):
        assert times(tmp_path, f"a,{name}\n1,7\n", form) == [round(7e9 * UNITS[name])]
        given = replace(form, time_unit="us")
        assert times(tmp_path, f"a,{name}\n1,7\n", given) == [7000]


@examples(100)
@given(
    whole=st.integers(0, 2_000_000_000),
    part=st.integers(0, 999_999_999),
    unit=st.sampled_from(["s", "ms", "us", "ns"]),
)
def test_times_are_exact_to_the_nanosecond(
    tmp_path_factory: pytest.TempPathFactory, whole: int, part: int, unit: str
) -> None:
    """Large times have more digits than a float."""
    stamp = whole * 10**9 + part
    decimals = {"s": 9, "ms": 6, "us": 3, "ns": 0}[unit]
    text = format(Decimal(stamp).scaleb(-decimals), "f")
    folder = tmp_path_factory.mktemp("times")
    assert times(folder, f"time,a\n{text},1\n", TableForm(unit)) == [stamp]


@examples(100)
@given(frame=st.integers(0, 10**9), rate=st.fractions(1, 10**6, max_denominator=1001))
def test_frames_over_their_rate_are_exact(
    tmp_path_factory: pytest.TempPathFactory, frame: int, rate: Fraction
) -> None:
    """Times of frames have no error of a float."""
    folder = tmp_path_factory.mktemp("frames")
    (time,) = times(folder, f"frame,x\n{frame},1\n", TableForm(frame_rate=rate))
    assert abs(Fraction(time) - frame * SECOND / rate) <= Fraction(1, 2)


@pytest.mark.parametrize(
    ("text", "found", "option", "form"),
    [
        ("0,3537\n0,8241\n", "'0,3537'", "`decimal`", TableForm(decimal="comma")),
        ("0,3537\n0,8241\n", "'0,3537'", "`separator`", TableForm(separator="comma")),
        (
            "time,time_ms,a\n1,2,3\n",
            "time, time_ms",
            "--time-column",
            TableForm(time_column="time"),
        ),
        ("T,CH1,T\n1,2,3\n", "T.1, CH1, T.2", "--time-column", TableForm(time_column="T.2")),
        (
            "TIME,CH1,TIME\n1,2,3\n",
            "TIME.1, TIME.2",
            "--time-column",
            TableForm(time_column="TIME.2"),
        ),
        ("when,a\n1,2\n", "when, a", "--time-column", TableForm(time_column="when")),
        ("Frame,X1\n1,2\n2,3\n", "Frame, X1", "--frame-rate", BY_RATE),
        ("Ball,3 cm\n1,2.5\n2,3.5\n", "Ball, 3 cm", "--skip-rows", TableForm(skip_rows=1)),
        ("Time (jiffies),a\n7,1\n", "'jiffies'", "--time-unit", TableForm(time_unit="ms")),
        ("time_ticks,a\n7,1\n", "'ticks'", "--time-unit", TableForm(time_unit="ms")),
        ("time_min,a\n7,1\n", "'min'", "--time-unit", TableForm(time_unit="min")),
        ("Time [UTC],a\n7,1\n", "'UTC'", "--time-unit", TableForm(time_unit="s")),
        ("time,a\n1700000000000,1\n", "1700000000000", "--time-unit", TableForm(time_unit="ms")),
        ("time,a\n2.5,1\n0.5,2\n2.6,1\n", "2 s", "`sort`", TableForm(sort=True)),
    ],
)
def test_where_two_readings_are_possible_the_option_is_named(
    tmp_path: Path, text: str, found: str, option: str, form: TableForm
) -> None:
    """The error names what was found and the option, with which the table is read."""
    with pytest.raises(UsageError) as caught:
        times(tmp_path, text)
    assert found in str(caught.value)
    assert option in str(caught.value)
    assert times(tmp_path, text, form)


def test_columns_of_one_name_are_told_apart_by_a_number(tmp_path: Path) -> None:
    """Two channels called Volt, of which neither is called so any more."""
    signal = read(tmp_path, "time,Volt,Volt\n0,1,2\n1,3,4\n")
    assert {name: x.tolist() for name, x in signal.columns.items()} == {
        "Volt.1": [1, 3],
        "Volt.2": [2, 4],
    }


def at(k: int) -> int:
    """The stamp of a row."""
    return SECOND + k * STEP


@pytest.mark.parametrize(
    ("text", "lost", "said"),
    [
        (table("time,az\n", plain, "\n0.030000,0.1e"), set(), "1 of 61 rows"),
        (table("time,az\n", plain, "\n0.029"), set(), "1 of 61 rows"),
        (table("time,az\n", plain, "\n0.030000,0.0"), set(), "1 of 61 rows"),
        (table("time,az\n", plain, "\n" + 300 * "\0"), set(), "NUL bytes"),
        (
            table("time,az\n", lambda k, t, a: plain(k, t, a) if k % 20 else f"{t},nan"),
            {0, 20, 40},
            "3 of 60 values of az",
        ),
        (
            table("time,az\n", lambda k, t, a: plain(k, t, a) if k % 20 - 1 else "reset"),
            {1, 21, 41},
            "3 of 60 rows left out (5 %): in line 3, 'reset'",
        ),
        (table("time,az\n", plain) + "\nTrack,Length\n1,219\n2,220\n", set(), "3 of 63 rows"),
        (table("time,az\n", plain, "\n0.03,1,2\n"), set(), "1 of 61 rows"),
    ],
    ids=["cut", "cut_row", "cut_number", "nul", "nan", "words", "second_table", "third_cell"],
)
def test_what_is_left_out_is_said_with_its_part(
    tmp_path: Path, text: str, lost: set[int], said: str
) -> None:
    """The other rows are read."""
    signal = read(tmp_path, text)
    there = np.flatnonzero(~np.isnan(signal.columns["az"]))
    kept = [k for k in range(VALUES.size) if k not in lost]
    assert signal.stamps[there].tolist() == [at(k) for k in kept]
    assert signal.columns["az"][there].tolist() == VALUES[kept].tolist()
    (remark,) = (*signal.remarks, *signal.omissions.values())
    assert said in remark


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "no row of numbers"),
        ("time,a\n", "line 1 is 'time,a'"),
        ("time,a\n5/6/2024 10:00,1\n", "line 2 is '5/6/2024 10:00,1'"),
        ("time,a\n0,1\nx,2\n2,3\ny,4\nz,5\n", "line 3: 'x'"),
        ('time,a\n0,1\n"1,2\n2,3\n', "line 3: a quotation mark"),
        ("time,x\n0,on\n", "x beside the time"),
        ("time\n0\n", "no column beside the time"),
        ("time,x\n-2,1\n", "--time-zero 3"),
        ("time,a(1),a[1]\n0,1,2\n", "a(1), a[1]"),
        ("Date,Time,az\n5/6/2024,10:00:00.5,1\n", "'5/6/2024 10:00:00.5' found"),
        ("X,CH1,Start,Increment,\nSequence,Volt,0,x\n0,1,\n1,2,\n", "start and increment"),
        (b"RIFF\x01\x00\x00\x00WAVEfmt ", "is no text"),
        (b"\0time,a\n0,1\n", "is no text"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, text: str | bytes, found: str) -> None:
    """The error names the file and what was found."""
    with pytest.raises(UsageError) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(str(tmp_path / "table.csv"))
    assert found in str(caught.value)


def test_a_unit_of_dates_is_an_option_without_a_use(tmp_path: Path) -> None:
    """A date has no unit."""
    with pytest.raises(UsageError, match="--time-unit ms"):
        read(tmp_path, table("time,az\n", dated(" ")), TableForm(time_unit="ms"))


@pytest.mark.parametrize(
    ("before", "after", "step", "remedy"),
    [
        ("2024-10-27 02:59:59.{}", "2024-10-27 02:00:00.{}", "3599.1 s", "zone"),
        ("23:59:59.{}", "00:00:00.{}", "86399.1 s", "date"),
        ("7205.{}", "3600.{}", "3605.1 s", "mend the times"),
    ],
    ids=["summer_time", "midnight", "numbers"],
)
def test_a_step_of_the_clock_is_named_with_its_size(
    tmp_path: Path, before: str, after: str, step: str, remedy: str
) -> None:
    """Sorting would swap the rows before and after the step."""
    rows = [each.format(k) for each in (before, after) for k in (7, 8, 9)]
    rows[3] = rows[3].replace(".7", ".8")
    text = "time,a\n" + "".join(f"{row},1\n" for row in rows)
    for sort in (False, True):
        with pytest.raises(UsageError) as caught:
            times(tmp_path, text, TableForm(sort=sort))
        assert "line 5" in str(caught.value)
        assert step in str(caught.value)
        assert remedy in str(caught.value)


def test_rows_out_of_order_by_less_than_they_last_are_sorted(tmp_path: Path) -> None:
    """Two sensors of one clock, written one after the other; equal times stay as they stand."""
    text = "time,a\n0.5,1\n1.5,2\n2.5,3\n0.6,4\n1.5,5\n2.4,6\n"
    signal = read(tmp_path, text, TableForm(sort=True))
    assert signal.columns["a"].tolist() == [1, 4, 2, 5, 6, 3]
    assert (signal.stamps - SECOND).tolist() == [
        round(t * SECOND) for t in (0.5, 0.6, 1.5, 1.5, 2.4, 2.5)
    ]


def test_times_that_lost_all_digits_are_refused(tmp_path: Path) -> None:
    """Times since 1970 with six digits are all equal."""
    text = table("time,az\n", lambda _, t, a: f"{1732340000 + t:g},{a:.5f}")
    with pytest.raises(UsageError, match=r"59 of 60 rows .* --frame-rate"):
        read(tmp_path, text)


def test_times_that_lost_some_digits_are_a_warning(tmp_path: Path) -> None:
    """The warning says by how much the stamps are off at most, and they are off by less."""
    text = table("time,az\n", lambda _, t, a: f"{1732340000 + t:.2f},{a:.5f}")
    signal = read(tmp_path, text)
    (remark,) = signal.remarks
    assert "56 of 60 rows" in remark
    assert "up to 0.01 s off" in remark
    true = 1732340000 * SECOND + STEP * np.arange(VALUES.size)
    assert np.abs(signal.stamps - true).max() < 0.01 * SECOND
