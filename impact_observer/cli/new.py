# SPDX-License-Identifier: Apache-2.0
"""Copy a commented rig into this folder, to be edited: model, sensors, launch file.

    impact-observer new my_rig --from chisel

chisel: two bodies that hit each other at both ends, a force of a table, a microphone
gear:   a wheel that rattles between two flanks, a switch at one of them
shaker: a mass that a shaker drives against a stop, a piezo
ball:   a ball that bounces and is slowed by the air, typed times or a microphone

No file is replaced.
"""

import argparse
import re
from pathlib import Path

from impact_observer.errors import UsageError
from impact_observer.plain_text import say

_NAME = re.compile(r"[A-Za-z_][\w-]*", re.ASCII)
_PLACE = "NAME"
"""What stands for the name in the files of a template and in their names."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("name", metavar="NAME", help="of the rig and its files")
    parser.add_argument("--from", dest="template", metavar="TEMPLATE", help="the rig to copy")


def run(args: argparse.Namespace) -> int:
    """Write the files.

    Raises:
        UsageError: the name is that of no file, there is no such template, or a file exists.
        OutputError: the disk is full or gone.
    """
    from impact_observer.output_files import check_outputs, replacing
    from impact_observer.resources import read_text, shared

    templates = {each.name: each for each in sorted(shared("config/templates").iterdir())}
    if args.template not in templates:
        found = f"{args.template!r} found" if args.template else "not given"
        raise UsageError(f"--from: {found}; expected one of {', '.join(templates)}")
    if not _NAME.fullmatch(args.name):
        raise UsageError(
            f"NAME: {args.name!r} found; expected letters, digits, - and _, such as my_rig"
        )
    texts = {
        Path(path.name.replace(_PLACE, args.name)): read_text(path).replace(_PLACE, args.name)
        for path in sorted(templates[args.template].glob(f"{_PLACE}*"))
    }
    check_outputs([(path, ()) for path in texts])
    for path, text in texts.items():
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    say(f"{', '.join(map(str, texts))}: written")
    say(f"Next: open {args.name}.yaml, whose first lines say what to run.")
    return 0
