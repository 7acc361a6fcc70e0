# SPDX-License-Identifier: Apache-2.0
"""What ``watch`` shows of a snapshot, to the letter."""

# ruff: noqa: E501 (a screen is as wide as it is)

import io
from dataclasses import replace

import pytest
from rich.cells import cell_len
from rich.console import Console

from impact_observer.events import Ruling, Verdict
from impact_observer.ros.watch.charts import ASCII_BLOCKS
from impact_observer.ros.watch.screen import ScreenStyle, line, screen
from impact_observer.ros.watch.snapshot import (
    EstimateHistory,
    ObserverSnapshot,
    Snapshot,
    StateLine,
    TopicRate,
)
from impact_observer.stamps import NS_PER_S

EPOCH = 1_700_000_000 * NS_PER_S


def at(seconds: float) -> int:
    """A stamp, since the epoch."""
    return EPOCH + round(seconds * NS_PER_S)


def history(*values: float) -> EstimateHistory:
    """The values of the last half of a minute."""
    return EstimateHistory(values[-1], (*[None] * len(values), *values), 60.0)


GEOMETRIC = ObserverSnapshot(
    "/observer_geometric",
    law="geometric",
    stamp=at(12.34),
    lines=(
        StateLine("x1", "m", 0.123456789, 0.12),
        StateLine("x2", "m", -1.5, -1.49),
        StateLine("x1", "m/s", 12345.678, 12345.0),
        StateLine("x2", "m/s", 0.0, -0.25),
    ),
    distance=history(40.0, 3.0, 0.5, 0.02),
    source="monitor",
    convergence=history(100.0, 10.0, 1.0),
    synchronized=False,
    bound=436.4,
    closed=("stop",),
    verdicts=(
        (Verdict(at(12.0), Ruling.APPLIED, 3, "stop"), 0.0021),
        (Verdict(at(10.5), Ruling.REJECTED, 2, "stop", "nothing has happened"), 0.0),
        (Verdict(at(1.25), Ruling.DUPLICATE, 1), 0.0),
    ),
    counts=(("applied", 7), ("rejected", 1)),
    health=(1, "1 events were not applied"),
    flows=(
        TopicRate("/observer_geometric/state", 900, 100.0, 0.0012, 0.01),
        TopicRate("/observer_geometric/verdicts", 8, None, None, 0.3),
        TopicRate("/monitor_geometric/error", 900, 99.6, None, 7.4),
    ),
)
FILTER = ObserverSnapshot(
    "/observer_minimum_variance",
    law="minimum-variance",
    stamp=at(12.34),
    lines=(
        StateLine("x1", "m", 0.12, 0.12, 1e-9),
        StateLine("x2", "m", -1.49, -1.49, 2e-9),
        StateLine("x1", "m/s", 1.0, 1.0, 3e-9),
        StateLine("x2", "m/s", 0.0, 0.0, 4e-9),
    ),
    distance=history(1e-3, 1e-12, 1e-19),
    source="here",
    convergence=EstimateHistory(-1.0),
    synchronized=True,
    learned=(("clock_error", 2.9e-4, 1e-5),),
    verdicts=((Verdict(at(12.0), Ruling.APPLIED, 3, "stop", innovation=1.4), 0.0),),
    counts=(("applied", 8),),
)


def both() -> Snapshot:
    """Two observers of one plant."""
    return Snapshot(
        at(12.35),
        simulated=True,
        epoch=EPOCH,
        model="two_mass",
        truth=True,
        impacts=8,
        last_impact=(at(12.0), "stop"),
        observers=(GEOMETRIC, FILTER),
        flows=(
            TopicRate("/clock", 1200, 100.0, None, 0.01),
            TopicRate("/plant/joint_states", 1200, 99.9, 0.0005, 0.01),
            TopicRate("/plant/model", 1, None, None, 12.0),
        ),
    )


def printed(snapshot: Snapshot, style: ScreenStyle) -> str:
    """What a terminal of that size gets, without the blanks at line ends."""
    console = Console(
        file=io.StringIO(), record=True, width=style.width, height=style.height, color_system=None
    )
    console.print(screen(snapshot, style))
    return "\n".join(row.rstrip() for row in console.export_text().splitlines())


NARROW = """\
two_mass   t = 12.35 s (/clock)
8 impacts, last 0.3 s ago (stop)
/clock 100 Hz   /plant/joint_states 99.9 Hz 0.5 ms ...
╭─ observer_geometric (geometric) ─────────────────────────╮
│              estimate         truth     error            │
│ x1  m       +0.123457     +0.120000  +3.5e-03            │
│ x2  m       -1.500000     -1.490000  -1.0e-02            │
│ x1  m/s  +1.23457e+04  +1.23450e+04  +6.8e-01            │
│ x2  m/s     +0.000000     -0.250000  +2.5e-01            │
│ V  2.00e-02 J by the monitor, last 30 s                  │
│ convergence  1.00e+00 J, not synchronized  █████▄▄▄▄▁▁▁▁ │
│ bound  V <= 436 J, certified                             │
│ closed  stop                                             │
│ events  7 applied, 1 rejected                            │
│ health  warning: 1 events were not applied               │
╰──────────────────────────────────────────────────────────╯
╭─ observer_minimum_variance (minimum-variance) ───────────╮
│           estimate      truth     error  std. dev.       │
│ x1  m    +0.120000  +0.120000  +0.0e+00    1.0e-09       │
│ x2  m    -1.490000  -1.490000  +0.0e+00    2.0e-09       │
│ x1  m/s  +1.000000  +1.000000  +0.0e+00    3.0e-09       │
│ x2  m/s  +0.000000  +0.000000  +0.0e+00    4.0e-09       │
│ V  1.00e-19 J, last 30 s                                 │
│  1e-19 █████████████████▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁ │
│ one replica                                              │
│ learned  clock error 2.90e-04 s +- 1.0e-05               │
│ events  8 applied                                        │
│ health  no diagnostics yet                               │
╰──────────────────────────────────────────────────────────╯
space freezes   q ends
"""
MEDIUM = """\
two_mass   t = 12.35 s (/clock)   8 impacts, last 0.3 s ago (stop)
/clock 100 Hz   /plant/joint_states 99.9 Hz 0.5 ms   /plant/model 1x
╭─ observer_geometric (geometric) ─────────────────────────────────────────────────────────────────╮
│              estimate         truth     error                                                    │
│ x1  m       +0.123457     +0.120000  +3.5e-03                                                    │
│ x2  m       -1.500000     -1.490000  -1.0e-02                                                    │
│ x1  m/s  +1.23457e+04  +1.23450e+04  +6.8e-01                                                    │
│ x2  m/s     +0.000000     -0.250000  +2.5e-01                                                    │
│ V  2.00e-02 J by the monitor, last 30 s                                                          │
│ convergence  1.00e+00 J, not synchronized  ████████▄▄▄▄▄▄▄▄▁▁▁▁▁▁▁▁                              │
│ bound  V <= 436 J, certified                                                                     │
│ closed  stop                                                                                     │
│ events  7 applied, 1 rejected                                                                    │
│ health  warning: 1 events were not applied                                                       │
╰──────────────────────────────────────────────────────────────────────────────────────────────────╯
╭─ observer_minimum_variance (minimum-variance) ───────────────────────────────────────────────────╮
│           estimate      truth     error  std. dev.                                               │
│ x1  m    +0.120000  +0.120000  +0.0e+00    1.0e-09                                               │
│ x2  m    -1.490000  -1.490000  +0.0e+00    2.0e-09                                               │
│ x1  m/s  +1.000000  +1.000000  +0.0e+00    3.0e-09                                               │
│ x2  m/s  +0.000000  +0.000000  +0.0e+00    4.0e-09                                               │
│ V  1.00e-19 J, last 30 s                                                                         │
│  1e-19 ██████████████████████████████▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁ │
│ one replica                                                                                      │
│ learned  clock error 2.90e-04 s +- 1.0e-05                                                       │
│ events  8 applied                                                                                │
│ health  no diagnostics yet                                                                       │
╰──────────────────────────────────────────────────────────────────────────────────────────────────╯
space freezes   q ends
"""
WIDE = """\
two_mass   t = 12.35 s (/clock)   8 impacts, last 0.3 s ago (stop)
/clock 100 Hz   /plant/joint_states 99.9 Hz 0.5 ms   /plant/model 1x
╭─ observer_geometric (geometric) ─────────────────────────────────────────────╮╭─ observer_minimum_variance (minimum-variance) ───────────────────────────────╮
│              estimate         truth     error                                ││           estimate      truth     error  std. dev.                           │
│ x1  m       +0.123457     +0.120000  +3.5e-03                                ││ x1  m    +0.120000  +0.120000  +0.0e+00    1.0e-09                           │
│ x2  m       -1.500000     -1.490000  -1.0e-02                                ││ x2  m    -1.490000  -1.490000  +0.0e+00    2.0e-09                           │
│ x1  m/s  +1.23457e+04  +1.23450e+04  +6.8e-01                                ││ x1  m/s  +1.000000  +1.000000  +0.0e+00    3.0e-09                           │
│ x2  m/s     +0.000000     -0.250000  +2.5e-01                                ││ x2  m/s  +0.000000  +0.000000  +0.0e+00    4.0e-09                           │
│ V  2.00e-02 J by the monitor, last 30 s                                      ││ V  1.00e-19 J, last 30 s                                                     │
│  1e+02 ▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅                                                    ││  1e-03 ███████████████████████                                               │
│        ██████████████████▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄▄                                   ││        ███████████████████████                                               │
│        ███████████████████████████████████▆▆▆▆▆▆▆▆▆▆▆▆▆▆▆▆▆                  ││        ███████████████████████                                               │
│  1e-02 ████████████████████████████████████████████████████▂▂▂▂▂▂▂▂▂▂▂▂▂▂▂▂▂ ││        ███████████████████████▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅▅                        │
│ convergence  1.00e+00 J, not synchronized  ████████▄▄▄▄▄▄▄▄▁▁▁▁▁▁▁▁          ││        ██████████████████████████████████████████████                        │
│ bound  V <= 436 J, certified                                                 ││  1e-19 ██████████████████████████████████████████████▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁▁ │
│ closed  stop                                                                 ││ one replica                                                                  │
│ events  7 applied, 1 rejected                                                ││ learned  clock error 2.90e-04 s +- 1.0e-05                                   │
│     12.000000 s  stop  applied  2.1 ms                                       ││ events  8 applied                                                            │
│     10.500000 s  stop  rejected  nothing has happened                        ││     12.000000 s  stop  applied  1.4 std. dev.                                │
│      1.250000 s  all  duplicate                                              ││ health  no diagnostics yet                                                   │
│ health  warning: 1 events were not applied                                   │╰──────────────────────────────────────────────────────────────────────────────╯
│ state 100 Hz 1.2 ms   verdicts 8x   monitor_geometric/error silent 7 s       │
╰──────────────────────────────────────────────────────────────────────────────╯
space freezes   q ends
"""
NO_OBSERVERS = """\
nothing received yet: no plant, no observer; is one running
on this ROS domain?
╭──────────────────────────────────────────────────────────╮
│ waiting for observers: no node publishes observer/state  │
│ or observer_<law>/state                                  │
╰──────────────────────────────────────────────────────────╯
"""


@pytest.mark.parametrize(
    ("width", "height", "wanted"), [(60, 30, NARROW), (100, 30, MEDIUM), (160, 24, WIDE)]
)
def test_the_screen_to_the_letter(width: int, height: int, wanted: str) -> None:
    """One under another where it is narrow, side by side where it is wide; it always fits."""
    found = printed(both(), ScreenStyle(width, height, keys=True))
    assert found == wanted.rstrip("\n")
    assert len(found.splitlines()) <= height
    assert max(map(cell_len, found.splitlines())) <= width


def test_a_screen_without_observers_says_so() -> None:
    """With a plant its figures are still shown."""
    assert printed(Snapshot(0), ScreenStyle(60, 30)) == NO_OBSERVERS.rstrip("\n")
    found = printed(replace(both(), observers=()), ScreenStyle(60, 30))
    assert "8 impacts, last 0.3 s ago (stop)" in found
    assert "waiting for observers" in found


@pytest.mark.parametrize(
    ("observer", "snapshot", "words"),
    [
        (ObserverSnapshot("/observer"), {}, "no estimate yet: it begins with the first impact"),
        (ObserverSnapshot("/observer"), {}, "waiting for impacts ..."),
        (ObserverSnapshot("/observer"), {}, "no diagnostics yet"),
        (ObserverSnapshot("/observer"), {}, "unknown: no estimate yet"),
        (replace(FILTER, distance=EstimateHistory()), {"truth": False}, "unknown: no truth"),
        (replace(FILTER, distance=EstimateHistory()), {"truth": False}, "no truth"),
        (
            replace(FILTER, distance=EstimateHistory()),
            {},
            "no monitor, and no model of the plant's; give",
        ),
        (replace(FILTER, bound=-1.0), {}, "bound  none certified"),
        (FILTER, {"last_impact": None}, "waiting for impacts ..."),
        (FILTER, {"trouble": "/impacts: no CDR header"}, "not understood: /impacts: no CDR"),
        (FILTER, {"model": ""}, "no model"),
        (FILTER, {"simulated": False}, "(system clock)"),
        (replace(GEOMETRIC, obstacle="one replica"), {}, "not synchronized  one replica"),
        (replace(FILTER, health=(2, "bad")), {}, "health  error: bad"),
        (replace(FILTER, health=(7, "odd")), {}, "health  stale: odd"),
    ],
)
def test_what_is_not_there_is_said(
    observer: ObserverSnapshot, snapshot: dict[str, object], words: str
) -> None:
    """It names what is missing, or what to do."""
    shown = replace(both(), observers=(observer,), **snapshot)  # type: ignore[arg-type]
    assert words in printed(shown, ScreenStyle(100, 40))


def test_topics_of_several_nodes_are_named() -> None:
    """In the head of the screen, with the remedy."""
    found = printed(replace(both(), merged=("/observer/state",)), ScreenStyle(100))
    words = " ".join(found.split())
    assert "several nodes publish /observer/state, and what is shown is a mixture" in words
    for width, height in ((40, 20), (60, 30)):
        found = printed(replace(both(), merged=("/a/state",) * 9), ScreenStyle(width, height))
        assert len(found.splitlines()) <= height


def test_a_frozen_screen_says_so() -> None:
    """And how to go on; where no keys are read none are named."""
    assert "FROZEN: space goes on   q ends" in printed(
        both(), ScreenStyle(100, 40, keys=True, frozen=True)
    )
    assert "space" not in printed(both(), ScreenStyle(100, 40))


@pytest.mark.parametrize("coordinates", [1, 7, 100])
@pytest.mark.parametrize(("width", "height"), [(40, 20), (60, 30), (100, 50), (240, 16)])
def test_it_fits_whatever_the_system(coordinates: int, width: int, height: int) -> None:
    """Lines that have no room are counted; V and the health are always there."""
    lines = tuple(StateLine(f"q{i}", "m", 0.5, 0.25, 0.1) for i in range(coordinates))
    shown = replace(both(), observers=(replace(GEOMETRIC, lines=lines, obstacle="one replica"),))
    found = printed(shown, ScreenStyle(width, height, keys=True)).splitlines()
    assert len(found) <= height
    assert max(map(cell_len, found)) <= width
    there = sum("+0.500000" in row for row in found)
    more = [row for row in found if " more" in row and "..." in row]
    assert there + sum(int(row.split("...")[1].split()[0]) for row in more) == coordinates
    assert any("V  2.00e-02 J" in row for row in found)
    assert any("health  warning" in row for row in found)


@pytest.mark.parametrize("several", [1, 2, 3, 5])
@pytest.mark.parametrize(("width", "height"), [(40, 12), (60, 16), (80, 24), (120, 24), (200, 60)])
def test_observers_without_room_are_named(several: int, width: int, height: int) -> None:
    """The last row says that the screen is frozen, the one above names the other observers."""
    observers = tuple(replace(GEOMETRIC, name=f"/rig{i}/observer") for i in range(several))
    shown = replace(both(), observers=observers)
    found = printed(shown, ScreenStyle(width, height, keys=True, frozen=True)).splitlines()
    assert len(found) <= height
    assert max(map(cell_len, found)) <= width
    assert "FROZEN" in found[-1]
    framed = sum(row.count("╭") for row in found)
    assert framed == sum(row.count("╰") for row in found)
    if framed < several:
        assert found[-2].startswith(f"... {several - framed} more, shown with --observers: ")


def test_times_of_events_are_since_their_own_epoch() -> None:
    """Two plants that began at different times have one each."""
    later = replace(GEOMETRIC, name="/rig/observer", epoch=at(1.0))
    found = printed(
        replace(both(), epoch=0, observers=(replace(later, epoch=EPOCH), later)), ScreenStyle(80)
    )
    assert "    12.000000 s  stop" in found
    assert "    11.000000 s  stop" in found


def test_as_high_as_it_takes_everything_is_shown() -> None:
    """Where there is no terminal to fit into."""
    found = printed(both(), ScreenStyle(80))
    for words in ("nothing has happened", "closed  stop", "silent 7 s", "/plant/model 1x"):
        assert words in found
    assert "..." not in found


def test_charts_are_ascii_where_nothing_else_can_be_printed() -> None:
    """Of as many levels."""
    found = printed(both(), ScreenStyle(100, 60, levels=ASCII_BLOCKS))
    assert "@" in found
    assert not set("▁▂▃▄▅▆▇█") & set(found)


def test_one_line_has_the_same_figures() -> None:
    """For a file: V, convergence, whether the replicas agree, and what is wrong."""
    assert line(both()) == (
        "t = 12.35 s, 8 impacts, last 0.3 s ago (stop);"
        " observer_geometric: V 2.00e-02 J, convergence 1.00e+00 J,"
        " warning: 1 events were not applied;"
        " observer_minimum_variance: V 1.00e-19 J, synchronized"
    )
    assert line(Snapshot(0)) == "nothing received yet: neither a plant nor an observer"
    assert line(replace(both(), observers=())).endswith("(stop); no estimate yet")
    waiting = replace(FILTER, synchronized=False, obstacle="covariance too wide")
    waiting = replace(waiting, distance=EstimateHistory(3e-314), convergence=EstimateHistory(0.0))
    seen = line(replace(both(), observers=(waiting,), merged=("/observer/state",)))
    assert "V 0 J, convergence 0 J, not synchronized: covariance too wide" in seen
    assert "warning: several nodes publish /observer/state, and what is shown is a mix" in seen
    unknown = replace(
        both(), truth=False, observers=(replace(FILTER, distance=EstimateHistory()),)
    )
    assert "V unknown: no truth" in line(unknown)
