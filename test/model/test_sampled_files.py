# SPDX-License-Identifier: Apache-2.0
"""Sampled forcing in model files: what is read, what is written, and each mistake in one line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from systems import examples, system

from impact_observer.errors import ModelError
from impact_observer.model import Forcing, Model, System, parse_model, read_model
from impact_observer.model.force_samples import Samples

MATRICES = """\
name: shaken
coordinates: [x1, x2]
mass:      [[1, 0], [0, 1]]
damping:   [[0, 0], [0, 0]]
stiffness: [[20, -10], [-10, 10]]
forcing: {sampled: forces.csv, hold: linear}
contacts: [{name: stop, direction: [0, -1], gap: 0.5, restitution: 0.7}]
"""
ELEMENTS = """\
name: pair
bodies:  [{name: x1, mass: 1}, {name: x2, mass: 1}]
springs: [{between: [ground, x1], stiffness: 10}]
forcing: {sampled: forces.csv, hold: previous}
stops:   [{name: stop, body: x2, limit: 0.5, side: above, restitution: 0.7}]
"""
CSV = "time,x1,x2\n-0.5,1,2\n0,3,4e-3\n1.5, 5 ,6\n"


def read(folder: Path, csv: str | bytes, model: str = MATRICES) -> Forcing:
    """The forcing of a model file beside a CSV file."""
    content = csv.encode() if isinstance(csv, str) else csv
    (folder / "forces.csv").write_bytes(content)
    (folder / "model.yaml").write_text(model)
    return read_model(folder / "model.yaml").system.forcing


@pytest.mark.parametrize(
    "csv",
    [
        CSV,
        CSV.replace("\n", "\r\n"),
        "\ufeff" + CSV,
        CSV + "\n\n",
        "x2, time ,x1\n2,-0.5,1\n4e-3,0,3\n6,1.5,5\n",
        '"time","x1","x2"\n"-0.5",1,2\n0,3,.004\n1.5,5.0,6',
    ],
    ids=["plain", "CRLF", "byte order mark", "empty lines", "other order", "quoted"],
)
@pytest.mark.parametrize(("model", "hold"), [(MATRICES, "linear"), (ELEMENTS, "previous")])
def test_samples_are_read_from_a_file_beside_the_model(
    csv: str, model: str, hold: str, tmp_path: Path
) -> None:
    """Columns are found by name, in both forms of a model."""
    samples = read(tmp_path, csv, model).sampled
    assert samples is not None
    assert samples.time.tolist() == [-0.5, 0.0, 1.5]
    assert samples.force.tolist() == [[1, 2], [3, 0.004], [5, 6]]
    assert samples.hold == hold


@pytest.mark.parametrize(
    ("csv", "problem"),
    [
        ("", "column 'time' is missing; expected time, x1, x2"),
        ("t,x1,x2\n0,1,2\n1,1,2\n", "column 'time' is missing; expected time, x1, x2"),
        ("time\n0\n1\n", "only the column 'time' found; expected some of time, x1, x2"),
        ("time,x1,x2,x3\n0,1,2,3\n", "column 'x3' is not known; expected time, x1, x2"),
        ("time,x1,x2,x1\n0,1,2,3\n", "column 'x1' stands there twice"),
        (CSV.replace("4e-3", "four"), "line 3, column x2"),
        (CSV.replace("4e-3", ""), "line 3, column x2"),
        (CSV.replace("4e-3", "nan"), "line 3, column x2"),
        (CSV.replace("4e-3", "1e16"), "line 3, column x2"),
        (CSV.replace("3,4e-3", "3"), "line 3 has 2 values; expected 3"),
        (CSV.replace("1.5", "-0.1"), "-0.1 follows 0.0; expected times that ascend by 1e-09 s"),
        ("time,x1,x2\n0,1,2\n", "1 samples found; expected at least two"),
        ("time,x1,x2\n", "0 samples found; expected at least two"),
        ("time,x1,x2\n0.1,1,2\n1,1,2\n", "begins at 0.1; expected a first time of 0 or before"),
        (b"time,x1,x2\n\xff,1,2\n", "cannot be read as text: "),
        ('time,x1,x2\n"0,1,2\n', "line 2 has 1 values; expected 3"),
    ],
)
def test_mistake_in_the_file_is_one_line(csv: str | bytes, problem: str, tmp_path: Path) -> None:
    """It names the model, the key, the file, and the line and column where there are."""
    with pytest.raises(ModelError) as caught:
        read(tmp_path, csv)
    line = str(caught.value)
    assert len(line.splitlines()) == 1
    assert line.startswith(f"{tmp_path / 'model.yaml'}: forcing.sampled: ")
    assert "forces.csv" in line
    assert problem in line


@pytest.mark.parametrize("form", ["matrices", "elements"])
def test_samples_add_to_constants_and_harmonics(form: str, tmp_path: Path) -> None:
    """They name only the coordinates that they drive, and survive the text of the model."""
    table = "forcing: {sampled: forces.csv, hold: linear"
    if form == "matrices":
        row = "{frequency: 2, cosine: [0, 4], sine: [0, 0]}"
        more = table + f", constant: [1, 0], harmonics: [{row}]"
        model = MATRICES.replace(table, more)
    else:
        forces = "[{body: x1, constant: 1}, {body: x2, amplitude: 4, frequency: 2}]"
        model = ELEMENTS.replace("hold: previous", "hold: linear") + f"forces: {forces}\n"
    found = read(tmp_path, "time,x2\n0,0\n2,6\n", model)
    expected = [1.0, 4 * np.cos(2.0) + 3.0]
    np.testing.assert_allclose(found(1.0), expected, rtol=1e-15)
    text = read_model(tmp_path / "model.yaml").text()
    again = parse_model(text, "again")
    assert again.text() == text
    assert again.system.forcing(1.0).tolist() == found(1.0).tolist()


def test_text_without_a_folder_names_no_file() -> None:
    """Such as the model that came in a bag."""
    with pytest.raises(ModelError, match="only a model file on disk may do so"):
        parse_model(MATRICES, "m")


def samples_of(model: System) -> Samples:
    """The samples, which must be there."""
    assert model.forcing.sampled is not None
    return model.forcing.sampled


@pytest.mark.parametrize(
    "sampled",
    [
        "{time: [-0.5, 0, 1.5], force: [[1, 2], [3, 4.0e-3], [5, 6]]}",
        "|\n    time,x1,x2\n    -0.5,1,2\n    0,3,4e-3\n    1.5,5,6\n",
    ],
    ids=["lists", "CSV"],
)
def test_samples_may_stand_in_the_model_itself(sampled: str) -> None:
    """As lists, or as the text of a CSV file."""
    text = MATRICES.replace(
        "forcing: {sampled: forces.csv, hold: linear}",
        f"forcing:\n  hold: linear\n  sampled: {sampled}",
    )
    samples = samples_of(parse_model(text, "m").system)
    assert samples.time.tolist() == [-0.5, 0.0, 1.5]
    assert samples.force.tolist() == [[1, 2], [3, 0.004], [5, 6]]


@examples(25)
@given(st.data())
def test_sampled_model_survives_its_text(data: st.DataObject) -> None:
    """Write then read needs no other file and is identity to the last bit."""
    count, n = data.draw(st.integers(2, 6)), data.draw(st.integers(1, 3))
    number = st.floats(-1e15, 1e15)
    steps = data.draw(st.lists(st.floats(1e-6, 1e6), min_size=count - 1, max_size=count - 1))
    time = np.concatenate([[0.0], np.cumsum(steps)]) - data.draw(st.floats(0.0, 10.0))
    rows = st.lists(number, min_size=n, max_size=n)
    force = data.draw(st.lists(rows, min_size=count, max_size=count))
    hold = data.draw(st.sampled_from(["previous", "linear"]))
    forcing = Forcing.of_samples(Samples(time, np.array(force), hold))
    model = system(np.eye(n), np.eye(n), np.eye(n), force=forcing)
    again = parse_model(Model(model).text(), "m")
    one, two = samples_of(model), samples_of(again.system)
    np.testing.assert_array_equal(one.time, two.time)
    np.testing.assert_array_equal(one.force, two.force)
    assert one.hold == two.hold
    assert again.text() == Model(model).text()


@pytest.mark.parametrize("name", ["time", " x", "a,b", 'a"b', "#1", "null", "ä"])
def test_odd_names_survive_the_text(name: str) -> None:
    """The column of a coordinate with an unusual name is found again."""
    forcing = Forcing.of_samples(Samples(np.array([0.0, 1.0]), np.array([[1.0], [2]]), "linear"))
    one = np.eye(1)
    again = parse_model(Model(System("s", (name,), one, one, one, forcing, ())).text(), "m")
    assert again.system.coordinates == (name,)
    assert samples_of(again.system).force.tolist() == [[1], [2]]


def test_coordinate_called_time_needs_a_table(tmp_path: Path) -> None:
    """In a CSV file its column would have the name of the column of instants."""
    model = MATRICES.replace("[x1, x2]", "[time, x2]")
    with pytest.raises(ModelError, match="a coordinate is named 'time' as the column of instants"):
        read(tmp_path, CSV, model)


@pytest.mark.slow
def test_hundred_seconds_at_one_kilohertz_are_read(tmp_path: Path) -> None:
    """A whole measurement, exact to the last bit."""
    rng = np.random.default_rng(5)
    table = np.column_stack([np.arange(100_000) / 1000, rng.normal(size=(100_000, 2))])
    rows = "\n".join(",".join(map(repr, row)) for row in table.tolist())
    samples = read(tmp_path, "time,x1,x2\n" + rows).sampled
    assert samples is not None
    np.testing.assert_array_equal(samples.time, table[:, 0])
    np.testing.assert_array_equal(samples.force, table[:, 1:])
