# SPDX-License-Identifier: Apache-2.0
"""Make a film of masses, springs and stops of plant and estimates, with V over time below.

The file's ending chooses the format: .mp4 (needs ffmpeg), .gif, or .html, a page that contains all
pictures and needs no network.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import (
    add_force,
    add_model,
    add_namespace,
    add_observers,
    add_part,
    positive,
)
from impact_observer.errors import UsageError
from impact_observer.plain_text import say

if TYPE_CHECKING:
    from impact_observer.draw.scene.film import Film
    from impact_observer.io.reader import BagReader

FPS = 25.0
"""Pictures a second."""
LONGEST = 60.0
"""Longest film without --duration, s."""
MOST_PICTURES = 20_000
_RANGES = {"speed": (1e-6, 1e6), "fps": (1e-3, 1e3), "start": (0.0, 1e9), "duration": (0.0, 1e9)}
"""Ranges of the numbers; stamps then fit into 64 bits."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("bag", metavar="BAG", type=Path, help="a bag with truth or estimates")
    film = "the film: an MP4, GIF or HTML"
    add("-o", "--output", metavar="FILE", type=Path, required=True, help=film)
    add_force(parser, "output")
    speed = "recorded seconds a second of the film (default 1)"
    add("--speed", metavar="X", type=positive, default=1.0, help=speed)
    add_part(parser, duration=f"to the end, up to {LONGEST:g} s of film")
    fps = (
        f"pictures a second of the film (default {FPS:g}); a GIF takes the nearest of 50, 33.3,"
        " 25, 20 and so on"
    )
    add("--fps", metavar="N", type=positive, default=FPS, help=fps)
    add_namespace(parser)
    add_observers(parser, "show only observers of these names (default: all in the bag)")
    add_model(parser)


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return animate(
        args.bag,
        args.output,
        speed=args.speed,
        start=args.start,
        duration=args.duration,
        fps=args.fps,
        observers=args.observers,
        model=args.model,
        namespace=args.namespace,
    )


def animate(
    bag: Path,
    output: Path,
    *,
    speed: float = 1.0,
    start: float | None = None,
    duration: float | None = None,
    fps: float = FPS,
    observers: Sequence[str] | None = None,
    model: str | None = None,
    namespace: str = "",
) -> int:
    """Make a film of a bag.

    Args:
        bag: with truth, estimates, or both.
        output: the film; its suffix is the format.
        speed: recorded seconds a second of the film.
        start: s since ``t = 0``; None for the beginning.
        duration: recorded seconds in the film; None for all, up to a minute of film.
        fps: pictures a second of the film.
        observers: prefixes of the estimates' topics; None for all.
        model: a model file or a sample's name; None for the model in the bag.
        namespace: of the rig; empty for the only rig.

    Returns:
        0.

    Raises:
        UsageError, ModelError: the arguments cannot be used, or there is no encoder.
        BagError: the bag cannot be read, or has no states.
    """
    from impact_observer.cli.progress import Progress
    from impact_observer.draw.film_files import picture_rate, write_film
    from impact_observer.draw.film_from_bag import read_film
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of
    from impact_observer.stamps import seconds_between

    span = LONGEST * speed if duration is None else duration
    _check(speed=speed, fps=fps, start=start or 0.0, duration=duration or 0.0)
    rate = picture_rate(output, fps)
    with BagReader(bag, namespace) as reader, Progress() as progress:
        progress.show(f"reading {bag}")
        system = model_of(reader, model).system
        film = read_film(
            reader,
            system,
            start=start,
            duration=span,
            observers=observers,
            warn=lambda line: progress.line(f"warning: {line}"),
        )
        rest = _rest(reader, film) if duration is None else ""
        count = film.count(rate, speed)
        if count > MOST_PICTURES:
            raise UsageError(
                f"{count} pictures: too many for a film; expected at most {MOST_PICTURES},"
                " with a shorter --duration, a lower --fps or a higher --speed"
            )
        write_film(
            film,
            output,
            title=_title(film, speed),
            speed=speed,
            fps=rate,
            progress=partial(progress.step, f"drawing {output}"),
        )
    changed = f" at {rate:.4g} a second" if abs(rate - fps) > 1e-6 * fps else ""
    length = seconds_between(film.start, film.end)
    say(f"film: {output}, {count} pictures{changed} of {length:.2f} s{rest}")
    return 0


def _check(**given: float) -> None:
    """Raise unless all numbers are in their ranges.

    Raises:
        UsageError: a number is not in its range.
    """
    for name, value in given.items():
        low, high = _RANGES[name]
        if not low <= value <= high:
            raise UsageError(f"--{name} {value:g}: expected a number from {low:g} to {high:g}")


def _title(film: "Film", speed: float) -> str:
    """The title of the film, with its tracks and its speed."""
    shown = "plant and estimates" if film.truth and film.estimates else "plant"
    if film.truth is None:
        shown = "estimate" if len(film.estimates) == 1 else "estimates"
    fast = "" if speed == 1 else f", {speed:g} times as fast"
    return f"{film.scene.system.name}: {shown}{fast}"


def _rest(reader: "BagReader", film: "Film") -> str:
    """A hint if the film ends before the bag does."""
    from impact_observer.stamps import seconds_between

    rest = seconds_between(film.end, reader.end)
    if rest < 0.1 or rest > 1e6:  # log times may be of another clock than stamps
        return ""
    return f"; {rest:.1f} s of the bag are left out, ask for more with --duration or --speed"
