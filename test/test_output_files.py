# SPDX-License-Identifier: Apache-2.0
"""No command replaces what it reads, nor what is there; a full disk harms nothing."""

import errno
import resource
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from workloads import OFFLINE, OUT, make_inputs

from impact_observer.cli.main import main
from impact_observer.errors import OutputError, UsageError
from impact_observer.output_files import unwritable
from impact_observer.plain_text import printable
from impact_observer.resources import shared

MINE = "mine\n"
BESIDE = {
    "identify": ["{bag}", "--free", "restitution", "--plot", "out.png"],
    "detect": [
        "{switch}",
        "--contact",
        "stop",
        "--topic",
        "/switch",
        "--plot",
        "out.svg",
        "-o",
        "new",
    ],
    "compare": ["{bag}", "--plot", "out.png"],
    "export": ["{bag}", "-o", "out.parquet"],
}
"""Other files that commands write."""
WRITING = [
    (command, arguments)
    for commands in (OFFLINE, BESIDE)
    for command, arguments in commands.items()
    if command == "new" or any(each.startswith(OUT) for each in arguments)
]
QUICK = {"new", "simulate", "import", "sweep", "export"}
"""Commands that write in less than a second."""
FIGURE = ["compare", "--duration", "0.1", "--figure"]
"""The beginning of a command that reads a model and writes a picture."""
LIMIT = 60
"""Bytes that a file may have on a disk that is full."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What the commands read."""
    return make_inputs(tmp_path_factory.mktemp("inputs"))


pytestmark = pytest.mark.usefixtures("in_tmp_path")


@contextmanager
def full_disk() -> Iterator[None]:
    """No file grows beyond ``LIMIT`` bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def output_of(command: str, arguments: list[str]) -> Path:
    """The file or folder that a command of ``WRITING`` makes."""
    return Path(
        "rig_sensors.yaml"
        if command == "new"
        else next(filter(lambda a: a.startswith(OUT), arguments))
    )


@pytest.mark.parametrize(("command", "arguments"), WRITING)
def test_what_is_there_is_not_replaced(
    command: str, arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2, in one line, before anything is read."""
    output = output_of(command, arguments)
    output.write_text(MINE, encoding="utf-8")
    assert (
        main([command, *(each.format(bag="no", switch="no", csv="no") for each in arguments)]) == 2
    )
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    if output.suffix and command != "new":
        assert f"{output}: exists already; remove it, or choose another name" in error
    assert output.read_text("utf-8") == MINE
    assert list(Path().iterdir()) == [output]


@pytest.mark.slow
@pytest.mark.parametrize(("command", "arguments"), [each for each in WRITING if each[0] in QUICK])
def test_a_full_disk_destroys_nothing_and_leaves_nothing(
    command: str, arguments: list[str], inputs: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, in one line, and no part of the file is left."""
    given = [each.format(**inputs) for each in arguments]
    with full_disk():
        code = main([command, *given])
    error = capsys.readouterr().err
    assert code == 1, error
    assert "cannot be written: " in error
    assert "File too large" in error
    assert not [*Path().iterdir()]


def test_no_room_for_a_temporary_file_is_a_full_disk(tmp_path: Path) -> None:
    """Exit code 1, and not that of a wrong name."""
    error = FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp']")
    assert isinstance(unwritable(tmp_path / "page.html", error), OutputError)
    missing = FileNotFoundError(errno.ENOENT, "No such file or directory")
    assert isinstance(unwritable(tmp_path / "page.html", missing), UsageError)


@pytest.mark.parametrize("name", ["my.svg", "./sub/../my.svg", "symbolic.svg", "hard.svg"])
def test_an_input_is_never_replaced(name: str) -> None:
    """By whatever name."""
    Path("sub").mkdir()
    shutil.copy(shared("config/two_mass.yaml"), "my.svg")
    Path("symbolic.svg").symlink_to("my.svg")
    Path("hard.svg").hardlink_to("my.svg")
    before = Path("my.svg").read_bytes()
    assert main([*FIGURE, "my.svg", "--plot", name]) == 2
    assert Path("my.svg").read_bytes() == before


def test_two_outputs_are_two_files(capsys: pytest.CaptureFixture[str]) -> None:
    """The second would replace the first."""
    outputs = ["-o", "a.png", "--plot", "./a.png"]
    assert main(["identify", "bag", "--free", "restitution", *outputs]) == 2
    assert "a.png: named twice" in capsys.readouterr().err


@pytest.mark.parametrize("target", ["nothing", "out.svg", "/dev/null"])
def test_links_are_not_replaced(target: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Links to nothing, in a circle, and to a device."""
    Path("out.svg").symlink_to(target)
    assert main([*FIGURE, "two_mass", "--plot", "out.svg"]) == 2
    assert capsys.readouterr().err.startswith("impact-observer: out.svg: exists already")
    assert Path("out.svg").is_symlink()


@pytest.mark.parametrize("name", ["/", "."])
def test_a_folder_is_no_name_of_a_bag(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    """One line, before the job."""
    assert main(["simulate", "two_mass", "--duration", "1", "-o", name]) == 2
    assert capsys.readouterr().err.startswith(f"impact-observer: {name}: ")


@pytest.mark.parametrize("name", ["\udcff", "\udcff.png"])
def test_a_name_that_is_not_utf8_is_one_line_before_the_job(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A bag, whose metadata have its name, and a picture."""
    simulate = ["simulate", "two_mass", "--duration", "1", "-o", name]
    picture = [*FIGURE, "two_mass", "--plot", name]
    assert main(simulate if name == "\udcff" else picture) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"impact-observer: {printable(name)}: is not UTF-8")
    assert not [*Path().iterdir()]
