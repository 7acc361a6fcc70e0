# SPDX-License-Identifier: Apache-2.0
"""From a recording to a page: find the impacts, identify what is uncertain, smooth the motion.

The recording is a sound, a table of a signal or of times of impacts, or a bag. Numbers of the
model that bear a deviation are identified, others are taken as typed. Without --epoch the phase
of the drive is free. The folder has fitted.yaml, impacts.csv, motion.png and the bag smoothed.

    impact-observer fit hits.wav rig.yaml -o out
"""

import argparse
from pathlib import Path

from impact_observer.cli.arguments import add_shared
from impact_observer.cli.progress import Progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("recording", metavar="RECORDING", type=Path, help="a WAV, a table (CSV, TXT), or a bag")
    add("model", metavar="MODEL", help="a model file, or a sample")
    add("-o", "--output", metavar="FOLDER", type=Path, required=True, help="a folder to make")
    epoch = "stamp of t = 0 of forces (default: unknown)"
    add_shared(parser, "sources", "epoch", "clock-error", "time-zero", epoch=epoch)


def run(args: argparse.Namespace) -> int:
    """Fit a recording; return 1 where the model does not fit."""
    from impact_observer.recording.fit_page import fit_recording

    with Progress() as progress:
        page = fit_recording(
            args.recording,
            args.model,
            args.output,
            sources=args.sources,
            zero=args.time_zero,
            epoch=args.epoch,
            clock_error=args.clock_error,
            say=progress.line,
            show=progress.show,
            step=progress.step,
        )
        for line in page.lines:
            progress.line(line)
    return 0 if page.fits else 1
