# SPDX-License-Identifier: Apache-2.0
"""Memory and time of the commands on a bag that is far larger than memory should ever be.

    ./dev bench long_bags                  # a bag of 2 GB in a temporary folder
    ./dev bench long_bags --gigabytes 0.2 --commands compare check

Prints time and largest memory of each command, and of reading every message. The bag repeats a run
of two_mass and its estimates with later stamps, like a recording of many hours.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from impact_observer.cli.main import main as run_command
from impact_observer.io.interfaces import PLANT_MODEL, interface
from impact_observer.io.reader import BagReader, RawMessage
from impact_observer.io.state_blocks import layout_of
from impact_observer.io.writer import BagWriter
from impact_observer.stamps import NS_PER_S

SECONDS = 60
RATE = 500
MOST_MEMORY = 300.0
"""Allowed for a command on a bag of any size, MB."""
READING = (
    "import sys; from impact_observer.io import BagReader;"
    "print(sum(1 for _ in BagReader(sys.argv[1]).raw()))"
)
COMMANDS = {
    "compare": ("compare", "BAG"),
    "check": ("check", "BAG"),
    "info": ("info", "BAG"),
    "export": ("export", "BAG", "--what", "errors", "-o", "FILE.csv"),
    "observe": ("observe", "BAG", "--ensemble", "1", "-o", "OUT"),
}
USUAL = ("compare", "check", "info")


@dataclass(frozen=True, slots=True)
class CommandCost:
    """Wall time, s, and largest memory, MB, of a process."""

    seconds: float
    megabytes: float


def main(args: Sequence[str] | None = None) -> int:
    """Make the bag, run the commands, print the table.

    Returns:
        0; 1 when a command failed or took more memory than it may.
    """
    parser = argparse.ArgumentParser(prog="./dev bench long_bags", description=__doc__)
    parser.add_argument("--gigabytes", type=float, default=2.0, metavar="GB")
    parser.add_argument("--commands", nargs="+", choices=[*COMMANDS], default=USUAL)
    given = parser.parse_args(args)
    if not 0 < given.gigabytes < 1000:
        parser.error(f"argument --gigabytes: {given.gigabytes}; expected 0 to 1000")
    console = Console()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder, "long")
        _make(bag, Path(folder), given.gigabytes * 1e9, console)
        table = Table(title=f"a bag of {_size(bag) / 1e9:.2f} GB", title_justify="left")
        for heading in ("command", "time [s]", "over reading", "memory [MB]"):
            table.add_column(heading, justify="right")
        reading = _measured([sys.executable, "-c", READING, str(bag)])
        table.add_row("reading", f"{reading.seconds:.1f}", "1", f"{reading.megabytes:.0f}")
        fits = True
        for name in given.commands:
            output = Path(folder, f"{name}_out")
            words = [
                w.replace("BAG", str(bag)).replace("OUT", str(output)) for w in COMMANDS[name]
            ]
            words = [w.replace("FILE", str(output)) for w in words]
            cost = _measured([sys.executable, "-m", "impact_observer", *words])
            ratio = f"{cost.seconds / reading.seconds:.2f}"
            table.add_row(name, f"{cost.seconds:.1f}", ratio, f"{cost.megabytes:.0f}")
            fits &= cost.megabytes <= MOST_MEMORY
        console.print(table)
        console.print(f"allowed: {MOST_MEMORY:g} MB", highlight=False)
    return 0 if fits else 1


def _make(bag: Path, folder: Path, size: float, console: Console) -> None:
    """A bag of about ``size`` bytes at ``bag``."""
    plant, estimates = folder / "plant", folder / "estimates"
    duration, rate = str(SECONDS), str(RATE)
    run_command(["simulate", "two_mass", "--duration", duration, "--rate", rate, "-o", str(plant)])
    run_command(["observe", str(plant), "--initial", "random:1", "-o", str(estimates)])
    with BagReader(estimates) as reader, BagWriter(bag) as writer, Progress() as progress:
        passes = max(round(size / reader.size), 1)
        task = progress.add_task("making the bag", total=passes)
        for topic, info in reader.topics.items():
            writer.declare(topic, type_name=info.type, quality=info.quality)
        once = [(message, [*_stamps_in(message)]) for message in reader.raw()]
        for k in range(passes):
            for message, places in once:
                if not k:
                    writer.write_raw(*message)
                elif places:
                    writer.write_raw(*_later(message, places, k * (SECONDS + 1)))
            progress.advance(task)
    console.print(f"{writer.message_count} messages", highlight=False)


def _later(message: RawMessage, places: Sequence[int], seconds: int) -> RawMessage:
    """The message with stamps ``seconds`` later."""
    data = bytearray(message.data)
    for place in places:
        if stamp := int.from_bytes(data[place : place + 4], "little"):  # 0 is no stamp
            data[place : place + 4] = (stamp + seconds).to_bytes(4, "little")
    return RawMessage(message.topic, message.log_time + seconds * NS_PER_S, bytes(data))


def _stamps_in(message: RawMessage) -> Iterator[int]:
    """Offsets of the seconds of stamps in a message; none for the model, which comes once."""
    own = interface(message.topic)
    if own is None or own is PLANT_MODEL:
        return
    yield 4
    layout = layout_of(own.type, message.data)
    if layout is not None and layout.last_event is not None:
        yield layout.last_event


def _measured(command: Sequence[str]) -> CommandCost:
    """Run a command to its end and measure it.

    Raises:
        RuntimeError: it failed.
    """
    begin = time.monotonic()
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.monotonic() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            output.seek(0)
            raise RuntimeError(f"{' '.join(command)}: {output.read().decode()[-500:]}")
    return CommandCost(seconds, usage.ru_maxrss / 1024)


def _size(bag: Path) -> int:
    return sum(file.stat().st_size for file in bag.iterdir())


if __name__ == "__main__":
    sys.exit(main())
