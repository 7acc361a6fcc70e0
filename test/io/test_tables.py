# SPDX-License-Identifier: Apache-2.0
"""Tables as instruments, phones, trackers and loggers write them."""

from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples

from impact_observer.cli.main import main
from impact_observer.errors import UsageError
from impact_observer.io import BagReader
from impact_observer.io.recordings import events_in
from impact_observer.io.table_file import TableFile
from impact_observer.io.table_layout import TableForm
from impact_observer.states import Vector

HITS = np.array([0.103, 0.2035, 0.3532, 0.4501])  # s
RATE = 2000
SECOND = 1_000_000_000
STEP = 0.5e-3  # s
Row = Callable[[int, float, float], str]


def samples() -> Iterator[tuple[int, float, float]]:
    """Number, time in s and value of the samples of four half-sines of 5 ms, 40 high."""
    for k in range(1000):
        since = k / RATE - HITS
        hits = np.where(np.abs(since) < 0.0025, 40 * np.cos(since * np.pi / 0.005), 0.0)
        yield k, k / RATE, float(hits.sum())


def table(header: str, row: Row, end: str = "\n") -> str:
    """A table with a row for each sample."""
    return header + "\n".join(row(*sample) for sample in samples()) + end


def plain(k: int, t: float, a: float) -> str:
    """A row with time and value."""
    del k
    return f"{t:.6f},{a:.5f}"


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
        return f"{(zero + timedelta(seconds=t)).isoformat(separator)},{a:.5f}"

    return row


ABOVE = (
    "".join(
        f"{name};{value}\n"
        for name, value in (
            ("Measurement report", ""),
            ("Operator", "n.n."),
            ("Date", "01.02.2024"),
            ("Time", "10:11:12"),
            ("Sample rate", "2000 Hz"),
            ("Channels", "2"),
            ("Pre-trigger", "0,1 s"),
        )
    )
    + "\n"
)
TEKTRONIX = {
    0: "Record Length,1000",
    1: "Sample Interval,0.0005",
    6: "Source,CH1",
    7: "Vertical Units,V",
}
LAYOUTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "lines_above.csv": (table(ABOVE + "Time;Hammer;ACC\n", commas), ("--topic", "Hammer")),
    "skipped.csv": (table("1,2\n3,4\n", plain), ("--skip-rows", "2")),
    "units_row.csv": (table("Time,Hammer\n[ms],[N]\n\n", millis), ()),
    "keysight.csv": (table("x-axis,1\nsecond,Volt\n", lambda _, t, a: f"{t:+.8E},{a:+.5E}"), ()),
    "rigol_time.csv": (
        table("X,CH1,CH2,\nSecond,Volt,Volt,\n", lambda _, t, a: f"{t:.5e},{a:.2e},4.88e+00,"),
        ("--topic", "CH1"),
    ),
    "rigol.csv": (
        table(
            "X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,0.000000e+00,5.000000e-04\n",
            lambda k, _, a: f"{k},{a:.5f},1.0,",
        ),
        ("--topic", "CH1"),
    ),
    "tektronix_beside.csv": (
        table("", lambda k, t, a: f"{TEKTRONIX.get(k, ',')},,{t:.6f},{a:.5f},"),
        (),
    ),
    "tektronix_above.csv": (
        table(
            "Model,MSO54\nHorizontal Units,s,,Horizontal Units,s\nRecord Length,1000\n,,,,\n"
            "Label,hammer,,Label,D0\nTIME,CH1,,TIME,D0\n",
            lambda _, t, a: f"{t:.6e},{a:.5f},,{t:.6e},0",
        ),
        ("--topic", "CH1"),
    ),
    "picoscope.csv": (
        table("Time;Kanal A;Kanal B\n(ms);(V);(mV)\n\n", lambda k, t, a: commas(k, 1000 * t, a)),
        ("--topic", "Kanal A"),
    ),
    "siglent.csv": (
        table(
            "Record Length,Analog:1000\nSample Interval,Analog:5.0E-04\nVertical Units,CH1:V\n"
            "Model Number,SDS1104X-E\nSource,CH1\nSecond,Value\n",
            lambda _, t, a: f"{t:+.6E},{a:+.6E}",
        ),
        ("--topic", "CH1"),
    ),
    "lecroy.csv": (
        table(
            "LECROYWR104Xi,58940,Waveform\nSegments,1,SegmentSize,1000\n"
            "Segment,TrigTime,TimeSinceSegment1\n#1,17-Dec-2018 10:52:33,0\nTime,Ampl\n",
            plain,
        ),
        (),
    ),
    "savetxt.dat": (table("", lambda _, t, a: f"{t:.18e} {a:.18e}"), ()),
    "aligned.txt": (table("   time (s)      az\n", lambda _, t, a: f"{t:10.4f}{a:12.4f}"), ()),
    "blanks_and_commas.txt": (
        table("time az\n", lambda _, t, a: f"{t:.4f} {a:.4f}".replace(".", ",")),
        (),
    ),
    "hundreds.csv": (
        table("t [100ms], |a| [m/s^2], az [m/s^2]\n", lambda _, t, a: f"{10 * t:.4f}, 9, {a:.2f}"),
        ("--topic", "az [m/s^2]"),
    ),
    "latin.csv": (table("Time (\xb5s),a (m/s\xb2)\n", lambda k, t, a: plain(k, 1e6 * t, a)), ()),
    "counted.csv": (table("az\n", lambda *sample: f"{sample[2]:.4f}"), ("--frame-rate", "2000")),
    "frames.txt": (
        table("Frame\tX1\tFlag1\nTracks 1 to 1\n", lambda k, _, a: f"{k}\t{a:.5f}\t ")
        + "\nTrack\tLength\tNr\n1\t219.7\t191\n",
        ("--frame-rate", "4000/2"),
    ),
}


def detected(folder: Path, name: str, text: str, *options: str) -> Vector:
    """Stamps of the impacts that ``detect`` finds in a table, ns."""
    path, bag = folder / name, folder / "bag"
    path.write_bytes(text.encode("latin-1" if "\xb5" in text else "utf-8"))
    given = ["--contact", "anvil", "--threshold", "20", "-o", str(bag), *options]
    assert main(["detect", str(path), *given]) == 0
    with BagReader(bag) as reader:
        return np.array([event.stamp for event in events_in(reader)])


@pytest.mark.parametrize("name", LAYOUTS)
def test_tables_of_instruments_give_their_hits(tmp_path: Path, name: str) -> None:
    """Stamps are exact to a twentieth of a sample, whatever stands around the rows."""
    text, options = LAYOUTS[name]
    stamps = detected(tmp_path, name, text, *options)
    np.testing.assert_allclose((stamps - SECOND) / SECOND, HITS, atol=0.05 * STEP)


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("time,az\n", dated(" ")),
        ("Timestamp,az\n", dated("T")),
        ("Date,Time,az\n", dated(",")),
        ("Datum,Uhrzeit,az\n,,[g]\n", dated(",")),
    ],
    ids=["blank", "iso", "two_columns", "german"],
)
def test_dates_are_stamps(tmp_path: Path, header: str, row: Row) -> None:
    """Dates without a zone are in UTC, stamps count from 1970, and a row of units is no row."""
    stamps = detected(tmp_path, "dates.csv", table(header, row))
    zero = 1_464_039_980 * SECOND  # date -u -d '2016-05-23 21:46:20' +%s
    np.testing.assert_allclose((stamps - zero) / SECOND, HITS, atol=0.05 * STEP)


def read_times(folder: Path, text: str, form: TableForm | None = None) -> list[int]:
    """The times in a table of one column of numbers, ns."""
    path = folder / "times.csv"
    path.write_text(text, encoding="utf-8")
    file = TableFile(
        path, form or TableForm(), ("value",), what="row", expected="time, value", strict=False
    )
    return [row.time for row in file.in_order()]


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
    (time,) = read_times(tmp_path_factory.mktemp("dates"), written)
    expected = np.datetime64(text, "ns").astype(np.int64) - minutes * 60 * SECOND
    assert time == int(expected)


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
}


@pytest.mark.parametrize("name", UNITS)
def test_a_unit_in_the_name_of_the_time_counts(tmp_path: Path, name: str) -> None:
    """Units stand in brackets, behind a line, in words, or with a number."""
    for options in (None, TableForm(time_column=name)):
        (time,) = read_times(tmp_path, f"a,{name}\n1,7\n", options)
        assert time == round(7e9 * UNITS[name])


@pytest.mark.parametrize("name", ["Time (jiffies)", "time_ticks", "time_min", "Time [UTC]"])
def test_a_unit_that_is_not_understood_is_an_error(tmp_path: Path, name: str) -> None:
    """The error lists what is understood; the option decides."""
    with pytest.raises(
        UsageError, match=r"is no unit of time .* expected s, ms, us, ns, min or h"
    ):
        read_times(tmp_path, f"{name},a\n7,1\n")
    assert read_times(tmp_path, f"{name},a\n7,1\n", TableForm(unit="ms")) == [7_000_000]


@examples(100)
@given(frame=st.integers(0, 10**9), rate=st.fractions(1, 10**6, max_denominator=1001))
def test_frames_over_their_rate_are_exact(
    tmp_path_factory: pytest.TempPathFactory, frame: int, rate: Fraction
) -> None:
    """Times of frames have no error of a float."""
    folder = tmp_path_factory.mktemp("frames")
    (time,) = read_times(folder, f"frame,x\n{frame},1\n", TableForm(frame_rate=rate))
    assert abs(Fraction(time) - frame * SECOND / rate) <= Fraction(1, 2)


def test_a_column_of_frames_asks_for_its_rate(tmp_path: Path) -> None:
    """The error names the option; a column of time leaves the option without a use."""
    with pytest.raises(UsageError, match=r"Frame counts frames. --frame-rate HZ"):
        read_times(tmp_path, "Frame,X1\n1,2\n2,3\n")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,timestamp_us,a\n1,2,3\n", ""),
        ("time,time_ms,a\n1,2,3\n", "two columns of time, time, time_ms; expected one"),
        ("stamp,elapsed,a\n1,2,3\n", "two columns of time, stamp, elapsed; expected one"),
        ("Czas [s],a\n1,2\n", "--time-column 'Czas \\[s\\]' names it, if that is the time"),
        ("Czas;a\n(ms);(V)\n1;2\n2;3\n", "--time-column 'Czas' names it, if that"),
        ("when,a\n1,2\n", "'when' found; expected a header with a column time"),
        ("Date,Time,a\n5/6/2024,10:00:00.5,1\n", "has '5/6/2024', in which day and month may"),
    ],
)
def test_nothing_is_guessed_where_two_readings_are_possible(
    tmp_path: Path, text: str, said: str
) -> None:
    """The error names the columns and the option; a column called time goes before others."""
    if not said:
        assert read_times(tmp_path, text) == [SECOND]
        return
    with pytest.raises(UsageError, match=said):
        read_times(tmp_path, text)


def test_columns_of_one_name_are_told_apart_by_a_number(tmp_path: Path) -> None:
    """Two channels called Volt, of which none is taken unasked."""
    (tmp_path / "scope.csv").write_text("time,Volt,Volt\n0,1,2\n1,3,4\n")
    form = TableForm()
    file = TableFile(tmp_path / "scope.csv", form, (), what="rows", expected="time", strict=False)
    assert file.columns == ("Volt", "Volt.2")
    rows = [row.cells for row in file.records()]
    assert rows == [{"Volt": "1", "Volt.2": "2"}, {"Volt": "3", "Volt.2": "4"}]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            table("time,az\n", plain, "\n0.50000,0.1e"),
            "1 of 1001 rows left out (0.1 %), line 1002",
        ),
        (table("time,az\n", plain, "\n0.4999"), "'0.4999' is cut: the file ends in it"),
        (table("time,az\n", plain, "\n0.500,0.0"), "'0.500,0.0' is cut: the file ends in it"),
        (table("time,az\n", plain, "\n" + 300 * "\0"), "line 1002: NUL bytes, as a loss of"),
        (
            table("time,az\n", lambda k, t, a: plain(k, t, a) if k % 100 else f"{t},nan"),
            "10 of 1000 values of az left out (1 %), the first in line 2: 'nan' is no finite",
        ),
        (
            table("time,az\n", lambda k, t, a: plain(k, t, a) if k % 100 - 1 else "reset"),
            "10 of 1000 rows left out (1 %), the first in line 3: 'reset' found; expected a time",
        ),
        (
            table("time,az\n", plain) + "\nTrack,Length\n1,219\n2,220\n",
            "3 of 1003 rows left out (0.3 %), the first in line 1003: another table begins there",
        ),
    ],
    ids=["cut", "cut_row", "cut_number", "nul", "nan", "words", "second_table"],
)
def test_what_is_left_out_is_a_warning_with_its_part(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, said: str
) -> None:
    """The other rows give their hits."""
    stamps = detected(tmp_path, "acc.csv", text)
    np.testing.assert_allclose((stamps - SECOND) / SECOND, HITS, atol=0.05 * STEP)
    (warning,) = [line for line in capsys.readouterr().out.splitlines() if "warning" in line]
    assert said in warning


def refused(folder: Path, capsys: pytest.CaptureFixture[str], text: str, *options: str) -> str:
    """The line of the error of ``detect``; no bag is left."""
    path, bag = folder / "acc.csv", folder / "bag"
    path.write_text(text, encoding="utf-8")
    given = ["--contact", "anvil", "--threshold", "20", "-o", str(bag), *options]
    assert main(["detect", str(path), *given]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert not bag.exists()
    return line


def test_a_table_of_which_most_rows_cannot_be_read_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error has the first of them."""
    said = refused(tmp_path, capsys, "time,a\n0,1\nx,2\n2,3\ny,4\nz,5\n")
    assert "line 3: 'x' found; expected a time as a decimal number; 3 of 5 rows" in said


def test_times_that_lost_all_digits_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Times since 1970 with six digits are all equal."""
    text = table("time,az\n", lambda _, t, a: f"{1732340000 + t:g},{a:.5f}")
    said = refused(tmp_path, capsys, text)
    assert "all 1000 rows have the time 1732340000.000000000 s; are their digits lost" in said
    assert "--frame-rate HZ" in said


def test_times_that_lost_some_digits_are_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The warning says by how much the stamps are off at most, and they are off by less."""
    text = table("time,az\n", lambda _, t, a: f"{1732340000 + t:.2f},{a:.5f}")
    stamps = detected(tmp_path, "acc.csv", text)
    said = capsys.readouterr().out
    assert "949 of 1000 rows have the time of the row before" in said
    assert "times change every 0.01 s, rows come every 0.000501 s" in said
    assert "stamps are up to 0.01 s off" in said
    assert np.max(np.abs((stamps - 1732340000 * SECOND) / SECOND - HITS)) < 0.01


def test_impacts_that_lost_their_digits_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A contact cannot close twice at once."""
    path = tmp_path / "impacts.csv"
    path.write_text("time,contact\n1.73234e+09,a\n1.73234e+09,a\n", encoding="utf-8")
    assert main(["import", str(path), "-o", str(tmp_path / "bag")]) == 2
    assert (
        "at the same time; remove one, or write times with more digits" in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("text", "stamps"),
    [
        ("0.500000000\n1.300000000\n", [1.5, 2.3]),
        ("0.500000000 stop\n1.300000000 stop\n", [1.5, 2.3]),
        ("Timestamp (ms),contact\n500,stop\n1300,stop\n", [1.5, 2.3]),
        ("time,contact\n2016-05-23 21:46:20.5,stop\n", [1464039980.5]),
        ("frame,contact\n50,stop\n130,stop\n", [1.5, 2.3]),
        ("0.5000\n1.3000\n1.4000\n1.5000\n1.7", [1.5, 2.3, 2.4, 2.5]),
    ],
    ids=["bare", "blank", "unit", "date", "frames", "cut"],
)
def test_impact_times_come_in_the_same_tables(
    tmp_path: Path, text: str, stamps: list[float]
) -> None:
    """``import`` reads what ``detect`` reads; a last line that is cut is left out."""
    path, bag = tmp_path / "impacts.txt", tmp_path / "bag"
    path.write_text(text, encoding="utf-8")
    options = ["--frame-rate", "100"] if "frame" in text else []
    assert main(["import", str(path), "--model", "two_mass", "-o", str(bag), *options]) == 0
    with BagReader(bag) as reader:
        assert [event.stamp for event in events_in(reader)] == [
            round(Decimal(str(each)) * SECOND) for each in stamps
        ]


def test_an_option_without_a_use_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A frame rate beside times, and a unit of dates."""
    said = refused(tmp_path, capsys, table("time,az\n", plain), "--frame-rate", "2000")
    assert "line 1: has a column of time; leave out --frame-rate" in said
    said = refused(tmp_path, capsys, table("time,az\n", dated(" ")), "--time-unit", "ms")
    assert "--time-unit ms given for dates; leave it out" in said
