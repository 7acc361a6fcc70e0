# SPDX-License-Identifier: Apache-2.0
"""Model files: what is read, what is written, and each mistake in one line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import io, sparse
from systems import examples, sample, systems, vectors

from impact_observer.errors import ImpactObserverError, ModelError, UsageError
from impact_observer.model import Model, parse_model, read_model

MATRICES = """\
name: two_mass
coordinates: [x1, x2]
mass:      [[1, 0], [0, 1]]
damping:   [[0.2, -0.1], [-0.1, 0.1]]
stiffness: [[20, -10], [-10, 10]]
forcing:
  constant: [0, 0]
  harmonics: [{frequency: 2.5, cosine: [0, 4], sine: [0, 0]}]
contacts: [{name: stop, direction: [0, -1], gap: 0.5, restitution: 0.7}]
initial_state: {position: [0.1, -0.2], velocity: [0.5, 0]}
"""
ELEMENTS = """\
name: pair
bodies:  [{name: a, mass: 1}, {name: b, mass: 1}]
springs: [{between: [ground, a], stiffness: 10, damping: 0.1}]
forces:  [{body: b, amplitude: 4, frequency: 2.5, phase: 0}, {body: a, constant: 1}]
stops:   [{name: stop, body: b, limit: 0.5, side: above, restitution: 0.7}]
"""


def mistaken(text: str, old: str, new: str) -> str:
    """``text`` with one thing changed, which must be there."""
    assert text.count(old) == 1, f"{old!r} occurs {text.count(old)} times"
    return text.replace(old, new)


def assert_one_line(error: ImpactObserverError, *fragments: str) -> None:
    """The message is one line, begins with the first fragment and holds all ``fragments``."""
    line = str(error)
    assert len(line.splitlines()) == 1, line
    assert line.startswith(fragments[0]), line
    for fragment in fragments:
        assert fragment in line


@pytest.mark.parametrize(
    ("written", "value"),
    [("1e-3", 1e-3), ("1.0e-3", 1e-3), ("1E+2", 100.0), ("3", 3.0), (".5", 0.5), ("-0.0", 0.0)],
)
def test_numbers_are_read_in_every_notation(written: str, value: float) -> None:
    """Also 1e-3, which YAML 1.1 would take for a string."""
    contact = parse_model(mistaken(MATRICES, "gap: 0.5", f"gap: {written}"), "m").system.contacts[
        0
    ]
    assert contact.gap == value


def test_gyroscopic_damping_is_accepted() -> None:
    """Only the symmetric part of C must be semidefinite; the skew part is kept."""
    turning = mistaken(MATRICES, "[[0.2, -0.1], [-0.1, 0.1]]", "[[0.1, 5], [-5, 0]]")
    assert parse_model(turning, "m").system.C.tolist() == [[0.1, 5], [-5, 0]]


def test_asymmetry_of_printed_digits_is_accepted_and_removed() -> None:
    """A matrix that was printed with ten digits is made symmetric."""
    printed = mistaken(MATRICES, "[[20, -10], [-10, 10]]", "[[20, -10.000000001], [-10, 10]]")
    K = parse_model(printed, "m").system.K
    assert K[0, 1] == K[1, 0] == pytest.approx(-10.0000000005, abs=1e-14)


def test_missing_initial_state_is_an_error_for_the_plant_only() -> None:
    """An observer reads such a file; a plant gets a line with the key and the form that fits."""
    lines = [line for line in MATRICES.splitlines() if not line.startswith("initial_state")]
    model = parse_model("\n".join(lines), "m")
    assert model.position is None
    with pytest.raises(ModelError, match="initial_state") as said:
        model.initial_state()
    form = str(said.value).partition("such as ")[2]
    assert form == "initial_state: {position: [0, 0], velocity: [0, 0]}"
    assert parse_model("\n".join([*lines, form]), "m").initial_state()[0].tolist() == [0, 0]


@pytest.mark.parametrize("form", ["k.npy", "whole.npy", "dense.mtx", "sparse.mtx"])
def test_matrix_is_read_from_a_file_beside_the_model(form: str, tmp_path: Path) -> None:
    """The path is relative to the model file; a sparse file stores one triangle."""
    stiffness, path = np.array([[20.0, -10], [-10, 10]]), tmp_path / form
    if form.endswith(".npy"):
        np.save(path, stiffness.astype(np.int32) if form == "whole.npy" else stiffness)
    elif form == "dense.mtx":
        io.mmwrite(path, stiffness)
    else:
        io.mmwrite(path, sparse.coo_matrix(stiffness), symmetry="symmetric")
    file = tmp_path / "model.yaml"
    file.write_text(mistaken(MATRICES, "[[20, -10], [-10, 10]]", form))
    assert read_model(file).system.K.tolist() == [[20, -10], [-10, 10]]


NO_MATRICES: dict[str, bytes | np.ndarray | None] = {
    "none.npy": None,
    "bad.npy": b"no numpy",
    "bad.mtx": b"no market\nat all\n",
    "cut.mtx": b"%%MatrixMarket matrix array real general\n2 2\n1\n",
    "empty.npy": b"",
    "m.csv": b"1,0\n0,1\n",
    "large.npy": np.eye(3),
    "flat.npy": np.ones(4),
    "complex.npy": 1j * np.eye(2),
    "words.npy": np.array([["a", "b"]] * 2),
}


@pytest.mark.parametrize("name", NO_MATRICES)
def test_matrix_file_that_is_no_matrix_is_one_line(name: str, tmp_path: Path) -> None:
    """Missing, broken, of another kind, size or type."""
    content = NO_MATRICES[name]
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    elif content is not None:
        np.save(tmp_path / name, content)
    with pytest.raises(ModelError) as caught:
        parse_model(mistaken(MATRICES, "[[1, 0], [0, 1]]", name), "my.yaml", tmp_path)
    assert_one_line(caught.value, "my.yaml: mass: ", name)


def test_a_matrix_with_a_number_that_is_not_finite_names_its_place(tmp_path: Path) -> None:
    """By row and column."""
    np.save(tmp_path / "nan.npy", np.diag([1.0, np.nan]))
    with pytest.raises(ModelError, match=r"^my.yaml: mass\[1\]\[1\]: "):
        parse_model(mistaken(MATRICES, "[[1, 0], [0, 1]]", "nan.npy"), "my.yaml", tmp_path)


def test_file_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    """A missing file, a folder and a binary file are named, with the sample models."""
    binary = tmp_path / "model.bin"
    binary.write_bytes(b"\xff\xfe\x00")
    for path, problem in (
        (tmp_path / "none.yaml", "no such file; expected a model file, or a sample model: ball"),
        (tmp_path, "a folder; expected a model file"),
        (binary, "cannot be read as text"),
    ):
        with pytest.raises(UsageError) as caught:
            read_model(path)
        assert_one_line(caught.value, f"{path}: {problem}")
    with pytest.raises(UsageError, match="three_mass, two_mass"):
        read_model("four_mass")


def test_file_in_the_working_folder_takes_precedence_over_a_sample(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file called two_mass, and the sample of that name."""
    monkeypatch.chdir(tmp_path)
    assert read_model("two_mass").system.n == 2
    Path("two_mass").write_text(ELEMENTS)
    assert read_model("two_mass").system.name == "pair"


def assert_equal_models(one: Model, two: Model) -> None:
    """Equal to the last bit."""
    a, b = one.system, two.system
    assert (a.name, a.coordinates, a.contact_names) == (b.name, b.coordinates, b.contact_names)
    for name in ("M", "C", "K", "W", "q_r", "eps"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    for name in ("constant", "frequency", "cosine", "sine"):
        np.testing.assert_array_equal(getattr(a.forcing, name), getattr(b.forcing, name))
    for mine, theirs in ((one.position, two.position), (one.velocity, two.velocity)):
        assert (mine is None) == (theirs is None)
        if mine is not None and theirs is not None:
            np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("name", ["two_mass", "three_mass", "bouncing_ball", "yielding_stop"])
def test_sample_model_survives_its_text(name: str) -> None:
    """Write then read is identity, whichever form it was written in."""
    model = sample(name)
    again = parse_model(model.text({"version": 1}), "text")
    assert_equal_models(model, again)
    assert [each.label for each in again.elements] == [each.label for each in model.elements]
    assert again.text() == model.text({"version": 1})


@examples(25)
@given(st.data())
def test_any_model_survives_its_text(data: st.DataObject) -> None:
    """Write then read is identity, and the second text is the first."""
    system = data.draw(systems())
    position, velocity = data.draw(vectors(system.n)) / 3, data.draw(vectors(system.n)) / 7e9
    outside = bool(np.all(system.gap(position) >= 0))
    model = Model(system, position, velocity) if outside else Model(system)
    text = model.text()
    again = parse_model(text, "text")
    assert_equal_models(model, again)
    assert again.text() == text


def test_provenance_is_carried_and_can_be_replaced() -> None:
    """Provenance survives reading and writing, unless another is given."""
    model = parse_model(MATRICES + "provenance: {version: 0.1.0, seed: 3}\n", "m")
    again = parse_model(model.text(), "m")
    assert dict(again.provenance) == {"version": "0.1.0", "seed": 3}
    replaced = parse_model(model.text({"seed": 4}), "m")
    assert dict(replaced.provenance) == {"seed": 4}


def test_a_file_that_takes_minutes_to_parse_is_refused_at_once(tmp_path: Path) -> None:
    """By its size; a text of the same length, as in a bag, too."""
    large = tmp_path / "large.yaml"
    large.write_bytes(b"name: x\n#" + b"-" * 10_000_000)
    with pytest.raises(UsageError, match=r"large\.yaml"):
        read_model(large)
    with pytest.raises(ModelError, match="10000009 characters found"):
        parse_model(large.read_text(), "model")


def test_aliases_without_an_end_are_refused_at_once() -> None:
    """A list of lists that repeat each other ten times over, and lists that contain themselves."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    bomb = "\n".join([*lines, "name: *a11", "bodies: *a11"])
    with pytest.raises(ModelError, match="bomb"):
        parse_model(bomb, "bomb")
    for text in (
        "name: q\nbodies: &a [*a]",
        "&a {name: q, bodies: *a}",
        "name: q\nx: &a {b: [*a]}",
    ):
        with pytest.raises(ModelError, match="itself"):
            parse_model(text, "itself")
    repeated = "springs: [&s {between: [ground, x], stiffness: 1, damping: &d 2}, *s]"
    text = f"name: q\nbodies: [{{name: x, mass: *d}}]\n{repeated}"
    with pytest.raises(ModelError, match="undefined alias"):
        parse_model(text, "before")
    text = f"name: q\n{repeated}\nbodies: [{{name: x, mass: *d}}]"
    assert parse_model(text, "twice").system.K == 2.0
