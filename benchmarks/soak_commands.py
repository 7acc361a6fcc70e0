# SPDX-License-Identifier: Apache-2.0
"""What ``./dev soak`` does to commands: odd inputs, odd outputs, odd numbers, and a full disk.

A command must end with 0, 1 or 2 and, if it fails, with a line of its own. Whatever happens, no
input changes, an existing output only with --force, and nothing half is left.
"""

import os
import random
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from hashlib import sha256
from io import StringIO
from pathlib import Path
from typing import TypeAlias

from benchmarks.soak_files import write_two_mass
from benchmarks.soak_inputs import mutated
from impact_observer.cli.main import main
from impact_observer.errors import UsageError
from impact_observer.resources import shared

Attack: TypeAlias = Callable[[random.Random], object]
_COMMANDS = """
check-model {model}
check {bag}
check {mcap}
check {bag} --model {model}
export {bag} -o {out.csv}
export {mcap} --what events -o {out.csv}
export {bag} -o {out.parquet}
import {csv} -o {new}
import {csv} --model {model} -o {new}
detect {signal} --contact stop --threshold 1 -o {new}
detect {wav} --threshold 0.5 -o {new}
detect {bag} --sources {sensors} -o {new}
simulate {model} --duration 0.2 -o {new}
observe {bag} --law geometric --ensemble 1 -o {new}
observe {bag} --law geometric --measurements {measured} --ensemble 1 -o {new}
compare --figure {model} --duration 0.1 --plot {out.png}
compare {bag} --csv {out.csv}
check-model {model} {bag} --plot {out.svg}
identify {bag} --free restitution -o {out}
plot {bag} -o {out.png}
smooth {bag} -o {new}
sweep {model} --duration 0.1 --runs 1 --jobs 1 -o {out.parquet}
""".strip().splitlines()
_SLOW = ("identify", "plot", "smooth", "sweep", "compare")
"""Commands of seconds, which are tried a tenth as often."""
_OPTIONS = ("--start", "--duration", "--namespace", "--epoch", "--rate", "--seed", "--model")
_VALUES = ("0", "-1", "nan", "1e308", "1e-308", "inf", "", "x", "9" * 400, "--", "two_mass", "1")
_TABLE = "time,contact\n0.5,stop\n1.5,stop\n2.5,stop\n"
_MEASURED = """measurements:
  - {name: a, topic: /plant/joint_states, joint: x1, quantity: position, deviation: 0.1}
"""
_INPUTS = ("pipe", "device", "folder", "missing", "loop", "empty", "noise", "sparse", "dangling")
_OUTPUTS = ("there", "folder", "pipe", "input", "hard", "soft", "null", "nowhere", "long")
_STRANGE = ("\x1b[2J", "a\nb", "\udcff", "%s{}", "'\"")
"""Names of files."""


def commands(folder: Path) -> Attack:
    """All that work without ROS, of files in a folder."""
    seeds = _seeds(folder / "seeds")
    place, before = folder / "place", Path.cwd()

    def attack(draw: random.Random) -> object:
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(folder / "seeds", place)
        usual = draw.random() < 0.1
        pattern = draw.choice(_COMMANDS)
        while pattern.split()[0] in _SLOW and draw.random() < 0.9:
            pattern = draw.choice(_COMMANDS)
        os.chdir(place)
        try:
            words = [_word(draw, word, seeds, usual=usual) for word in pattern.split()]
            if not usual and draw.random() < 0.3:
                words += [draw.choice(_OPTIONS), draw.choice(_VALUES)]
            if draw.random() < 0.4:
                words.append("--force")
            limit = int(10 ** draw.uniform(0, 5)) if not usual and draw.random() < 0.4 else None
            if (code := _tried(words, limit)) != 0:
                raise UsageError(f"exit code {code}")
            return code
        finally:
            os.chdir(before)

    return attack


def _seeds(folder: Path) -> dict[str, str]:
    """Make the usual inputs; returns their names by their places in ``_COMMANDS``."""
    folder.mkdir()
    write_two_mass(folder / "bag")
    shutil.copy(next((folder / "bag").glob("*.mcap")), folder / "one.mcap")
    shutil.copy(shared("config/two_mass.yaml"), folder / "model.yaml")
    shutil.copy(next(shared("config/detector").glob("*.yaml")), folder / "sensors.yaml")
    (folder / "measured.yaml").write_text(_MEASURED, encoding="utf-8")
    (folder / "impacts.csv").write_text(_TABLE, encoding="utf-8")
    rows = "".join(f"{k / 100},{5 * (k % 50 == 0)}\n" for k in range(200))
    (folder / "signal.csv").write_text(f"time,force\n{rows}", encoding="utf-8")
    header = b"RIFF\xff\0\0\0WAVEfmt \x10\0\0\0\1\0\1\0@\x1f\0\0\x80>\0\0\2\0\x10\0data\xd0\7\0\0"
    (folder / "sound.wav").write_bytes(header + bytes(1000) + b"\xff\x7f" * 20 + bytes(960))
    return {
        "{bag}": "bag",
        "{mcap}": "one.mcap",
        "{model}": "model.yaml",
        "{sensors}": "sensors.yaml",
        "{measured}": "measured.yaml",
        "{csv}": "impacts.csv",
        "{signal}": "signal.csv",
        "{wav}": "sound.wav",
    }


def _word(draw: random.Random, word: str, seeds: dict[str, str], *, usual: bool) -> str:
    """An argument for a word of a pattern."""
    if word in seeds:
        name = seeds[word]
        return name if usual or draw.random() < 0.5 else _odd_input(draw, name)
    if word.startswith("{"):
        name = word.strip("{}")
        return name if usual or draw.random() < 0.4 else _odd_output(draw, name, [*seeds.values()])
    return word


def _odd_input(draw: random.Random, name: str) -> str:
    """Change an input, or name something else instead; returns the name."""
    path = Path(name)
    kind = draw.choice((*_INPUTS, "changed", "changed", "changed", "other", "name", "long"))
    if kind == "changed":
        file = draw.choice(sorted(path.iterdir())) if path.is_dir() else path
        file.write_bytes(mutated(draw, file.read_bytes(), [b"0"]))
        return name
    if kind == "other":
        return draw.choice(sorted(each.name for each in Path().iterdir()))
    if kind == "long":
        return "a" * draw.choice((250, 256, 5000)) + path.suffix
    odd = Path((draw.choice(_STRANGE) if kind == "name" else "odd") + path.suffix)
    if kind == "name":
        (shutil.copytree if path.is_dir() else shutil.copy)(path, odd)
    else:
        _make(draw, kind, odd)
    return str(odd)


def _make(draw: random.Random, kind: str, odd: Path) -> None:
    """Make something of a kind that is no input."""
    targets = {"loop": str(odd), "dangling": "nowhere"}
    targets["device"] = draw.choice(("/dev/zero", "/dev/full", "/dev/tty", "/dev/urandom"))
    if kind in targets:
        odd.symlink_to(targets[kind])
    elif kind == "pipe":
        os.mkfifo(odd)
    elif kind == "folder":
        odd.mkdir()
    elif kind != "missing":
        odd.write_bytes(draw.randbytes(3000) if kind == "noise" else b"")
        if kind == "sparse":
            os.truncate(odd, 2**33)


def _odd_output(draw: random.Random, name: str, inputs: list[str]) -> str:
    """Make something odd where an output will be, and return its name."""
    path = Path(name)
    kind = draw.choice(_OUTPUTS)
    source = draw.choice([each for each in inputs if Path(each).is_file()])
    if kind == "there":
        path.write_text("mine", encoding="utf-8")
    elif kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "input":
        return draw.choice((source, f"./{source}", f"bag/../{source}"))
    elif kind == "hard":
        path.hardlink_to(source)
    elif kind == "soft":
        path.symlink_to(draw.choice((source, "/dev/null", "nowhere", name)))
    elif kind == "null":
        return "/dev/null"
    elif kind == "nowhere":
        return f"no/{name}"
    else:
        return "b" * draw.choice((250, 256, 5000)) + path.suffix
    return name


def _tried(words: list[str], limit: int | None) -> int:
    """Run a command, and look at what is there then; returns its exit code.

    Raises:
        AssertionError: the command broke a promise.
    """
    before, said = _contents(), StringIO()
    with _limited(limit), redirect_stdout(StringIO()) as printed, redirect_stderr(said):
        try:
            code = main(words)
        except SystemExit as end:
            code = int(end.code or 0)
    line = f"{' '.join(words)!r:.90} with {limit} bytes: "
    text = said.getvalue()
    assert code in (0, 1, 2), f"{line}exit code {code}"
    assert "unforeseen" not in text, f"{line}{text[-400:]}"
    assert "Traceback" not in text, f"{line}{text:.400}"
    assert code == 0 or text.strip() or printed.getvalue(), f"{line}nothing is said"
    after, named = _contents(), {os.path.realpath(each) for each in words}
    for path, content in before.items():
        may_change = "--force" in words and code == 0 and os.path.realpath(path) in named
        assert after.get(path) == content or may_change, f"{line}{path} is another"
    new = {path for path in after if path not in before}
    assert not [each for each in new if each.name.startswith(".")], f"{line}{new} are left"
    assert code != 1 or limit is None or not new, f"{line}{new} are left: {text:.200}"
    return code


def _contents() -> dict[Path, str]:
    """What is in the working folder: the checksum of each small file, the kind of all else."""
    found = {}
    for folder, folders, files in os.walk("."):
        for name in (*folders, *files):
            path = Path(folder, name)
            is_plain = path.is_file() and not path.is_symlink() and path.stat().st_size < 2**30
            kind = oct(path.lstat().st_mode)
            found[path] = sha256(path.read_bytes()).hexdigest() if is_plain else kind
    return found


@contextmanager
def _limited(limit: int | None) -> Iterator[None]:
    """No file grows beyond ``limit`` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    if limit is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
