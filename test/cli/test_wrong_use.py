# SPDX-License-Identifier: Apache-2.0
"""Wrong use of any command: one line that names the thing, exit code 2, and nothing is made."""

from pathlib import Path
from shutil import copytree

import pytest

pytest.importorskip("rosbags")

from impact_observer.cli.main import main
from impact_observer.resources import shared

SIMULATE = "simulate two_mass -o x"
SWEEP = "sweep two_mass -o x.parquet"
ARGUMENTS = {
    "simulate two_mass": "-o/--output",
    f"{SIMULATE} --duration -1": "above 0",
    f"{SIMULATE} --rate nan": "expected a number",
    f"{SIMULATE} --seed 1.5": "whole number",
    f"{SIMULATE} --jiter 0.1": "unrecognized arguments",
    f"{SIMULATE} --what": "see impact-observer simulate --help",
    f"{SIMULATE} --impacts-only -1e-3": "--impacts-only: ignored explicit argument '-1e-3'",
    f"{SIMULATE} --missed 1.5": "1.5 found; expected 0 to 1",
    f"{SIMULATE} --jitter -1e-3": "-1e-3 found; expected 0 to 1 s",
    f"{SIMULATE} --delay nan": "nan found; expected 0 to 10 s",
    f"{SIMULATE} --spurious often": "often found; expected 0 to 10000 1/s",
    "observe bag -o x --start -1": "-1 found; expected a number, 0 or more",
    "smooth bag -o x --duration 0": "0 found; expected a number above 0",
    "detect bag -o x --epoch 0": "above zero",
    "detect bag --kind switch -o x": "--kind",
    "observe bag --modl x.yaml": "required",
    "observe bag -o x --epoch 5000000000": "5000000000 found; expected 0 to 2147483647.9",
    "magic": "invalid choice",
    "info bag": "info",
    "": "COMMAND",
    "play sample --rate 0": "--rate: 0 found",
    "play sample --rate nan": "--rate: nan found",
    "record -o x --duration -1": "--duration: -1 found",
    f"{SWEEP} --jitter 0,late": "0,late found; expected values with commas, each 0 to 1 s",
    f"{SWEEP} --jitter 0,2": "each 0 to 1 s",
    f"{SWEEP} --impacts-only perhaps": "each true | false",
    f"{SWEEP} --off gap": "expected NAME=V,V",
    f"{SWEEP} --jobs 2 --dask tcp://a:1": "not allowed with",
    f"{SWEEP} --runs 0": "1 or more",
}
"""What is wrong in the arguments alone; the line says where help is."""
TRUTH = "/plant/joint_states"
INPUTS = [
    ("simulate no_model -o x", "no_model"),
    (f"{SIMULATE} --rate 1e12", "samples: too many"),
    (f"{SIMULATE} --duration 1e10", "too late; the last one is"),
    ("simulate two_mass --duration 1 -o sample", "sample: exists already"),
    (f"{SIMULATE} --mislabelled 0.1", "a model with 2 contacts or more: two_mass has 1"),
    ("new ../a --from ball", "NAME: '../a' found"),
    ("new rigs/a --from ball", "NAME: 'rigs/a' found"),
    ("new 1 --from ball", "NAME: '1' found"),
    ("check-model two_mass sample --initial-deviation 1,2", "expected one number"),
    ("check-model two_mass --initial-deviation 1", "initial_deviation: given without a BAG"),
    ("check-model hammer_arm sample", "hammer_arm: a robot"),
    ("observe nowhere -o x", "nowhere: does not exist"),
    *(
        (f"{command} sample --start {start}", said)
        for command in ("observe -o x", "smooth -o x", "identify --free gap", "export -o x.csv")
        for start, said in (
            ("99", "from 99 s to the end after the epoch, 1.000000000 s; its stamps are"),
            ("1e300", "choose another part with --start and --duration"),
        )
    ),
    ("compare", "no bag named"),
    ("compare nowhere", "nowhere: does not exist"),
    ("compare nowhere --plot v.gif", "v.gif"),
    ("compare sample --plot nowhere/f.svg", "nowhere/f.svg"),
    ("compare sample --figure two_mass", "bags is of bags"),
    ("compare sample --laws geometric,quick", "law 'quick': not installed"),
    ("compare sample --laws=", "laws: none named"),
    ("compare sample --initial-state random:1", "name some with --laws"),
    ("compare sample --laws geometric --initial-state 1,2", "expected 4"),
    ("compare --figure startless.yaml", "initial_state: is missing"),
    ("compare --figure two_mass --laws quick", "law 'quick'"),
    ("compare --figure two_mass --initial-state here", "initial state 'here'"),
    ("compare --figure two_mass --laws=", "laws: none named"),
    ("compare --figure hammer_arm", "hammer_arm: a robot"),
    ("compare --figure two_mass --start 1", "start is of bags"),
    ("check nowhere", "nowhere: does not exist"),
    ("check sample --model nothing", "nothing: no such file"),
    ("fit times.csv two_mass -o no/out", "no/out: no folder no"),
    ("fit startless.yaml times.csv -o x", "startless.yaml"),
    ("fit two_mass times.csv -o x", "two_mass"),
    ("identify sample", "names no parameter"),
    ("identify sample --free gap --check", "identifies nothing"),
    ("identify sample --check", "--clock-error"),
    ("identify sample --free colour", "colour"),
    ("smooth times -o x", "carries no truth to sample with; give --rate"),
    ("smooth times -o x --rate 1e6", "expected at most 10000000"),
    ("plot sample -o a.gif", "a.gif"),
    ("plot sample -o nowhere/a.png", "nowhere; make it first"),
    ("plot sample -o a.svg --select x9", "--select x9: "),
    ("plot sample -o a.svg --start 99", "from 99 s to the end after the epoch"),
    ("export sample -o x.xlsx", "x.xlsx"),
    ("export sample -o no/x.csv", "no/x.csv"),
    ("export sample -o x.csv --topics /absent", "no topic or observer /absent; in the bag: /"),
    ("export sample -o x.csv --topics /impacts", "/impacts is impact_observer_msgs/msg/Impac"),
    ("export sample -o x.csv --what events --topics /a", "events have their own topic"),
    (f"export sample -o x.csv --what errors --topics {TRUTH}", "has no estimates; make them"),
    (f"export sample -o x.csv --impacts --topics {TRUTH}", "has no estimates of impacts"),
    ("export times -o x.csv", "has no states; topics: /impacts"),
    ("export times -o x.csv --impacts", "run observe or smooth"),
    (f"{SWEEP} --duration 0.1 --rate 1", "one sample found in 0.1 s at 1 Hz; expected two"),
    ("sweep two_mass -o sweep.csv", "sweep.csv: expected a name that ends in .parquet"),
    (f"{SWEEP} --laws magic", "law 'magic': not installed"),
    (f"{SWEEP} --off gap=0.4 --off gap=0.5", "off: gap found twice"),
    (f"{SWEEP} --plot v.gif", "v.gif: expected a name"),
    (f"{SWEEP} --mislabelled 0.1", "sensor mislabelled"),
]
"""What is wrong with a file, a model, a law or an option beside another one."""


@pytest.fixture(scope="module")
def folder(first_sample_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with an estimate, one of impacts alone, and a model without a start."""
    made = tmp_path_factory.mktemp("wrong")
    copytree(first_sample_bag, made / "sample")
    (made / "times.csv").write_text("time,contact\n1.0,stop\n1.5,stop\n12.0,stop\n")
    imported = ["import", str(made / "times.csv"), "--model", "two_mass"]
    assert main([*imported, "-o", str(made / "times")]) == 0
    lines = shared("config/two_mass.yaml").read_text("utf-8").splitlines()
    kept = [line for line in lines if not line.startswith("initial_state")]
    (made / "startless.yaml").write_text("\n".join(kept), encoding="utf-8")
    return made


def refusal(
    words: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> str:
    """The error line of a command that is wrong use."""
    monkeypatch.chdir(folder)
    before = {*folder.rglob("*")}
    capsys.readouterr()
    try:
        code = main(words.split())
    except SystemExit as end:
        code = int(end.code or 0)
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert code == 2
    assert {*folder.rglob("*")} == before
    return line


@pytest.mark.parametrize("words", ARGUMENTS)
def test_a_wrong_argument_is_one_line(
    words: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line says what was found, or what is expected, and where help is."""
    line = refusal(words, folder, monkeypatch, capsys)
    assert ARGUMENTS[words] in line
    assert "--help" in line


@pytest.mark.parametrize(("words", "said"), INPUTS)
def test_what_cannot_be_used_is_one_line(
    words: str,
    said: str,
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The line comes before any work is done."""
    if "sweep" in words:
        pytest.importorskip("pyarrow")
    if "hammer_arm" in words:
        pytest.importorskip("pinocchio", reason="not installed: extra robots")
    assert said in refusal(words, folder, monkeypatch, capsys)
