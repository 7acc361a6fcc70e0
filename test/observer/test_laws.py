# SPDX-License-Identifier: Apache-2.0
"""The laws: their proved properties, and how they are found by name."""

import sys
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import (
    EPOCH,
    distance,
    examples,
    moving_systems,
    passes_eigenvalue_test,
    sample,
    switched,
    switchings,
    system,
    systems,
    vectors,
)

from impact_observer.cli.main import main
from impact_observer.errors import ImpactLawError, UsageError
from impact_observer.model import System
from impact_observer.observer import ReplicaLaw, law_named, law_names
from impact_observer.observer import laws as laws_module
from impact_observer.observer.belief import Belief
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws import OWN_LAWS
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.kinematic import Kinematic
from impact_observer.observer.laws.unilateral import Unilateral
from impact_observer.plant import Plant, Switching
from impact_observer.resources import shared
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
CORRECTING = pytest.mark.parametrize(
    "law", [Kinematic, Geometric, Unilateral], ids=lambda law: law.name
)


def switchings_of(model: System, x: Array, seconds: float, most: int = 12) -> list[Switching]:
    """The first switchings of a plant that starts from ``x`` in its frame, about ``most``."""
    found: list[Switching] = []
    try:
        at_epoch = np.zeros(1, dtype=np.int64)
        start = model.from_frame(at_epoch, x[None])[0]
        plant = Plant(model, *np.split(start, 2), epoch=EPOCH)
        while len(found) < most:
            switching = plant.next_switching(EPOCH + round(seconds * NS_PER_S))
            if switching is None:
                break
            found.append(switching)
            plant.cross(switching)
    except ImpactLawError:
        pass
    return found


@CORRECTING
def test_true_state_stays_true_at_an_impact(law: type[ReplicaLaw]) -> None:
    """A replica in the plant's state jumps as the plant does."""
    for name in ("two_mass", "three_mass", "bouncing_ball"):
        model = sample(name)
        x = np.concatenate(model.initial_state())
        replica = law(model.system)
        for impact in switchings_of(model.system, x, seconds=8.0):
            found = replica.impact(impact.before, impact.contacts, impact.closed)
            np.testing.assert_allclose(found, impact.after, atol=1e-12)


def test_kinematic_law_is_a_sprag_clutch() -> None:
    """Velocities jump only where the replica's own contact closes, positions never do."""
    law = Kinematic(sample("two_mass").system)
    closing = law.impact(np.array([0.1, 0.2, 1.0, 2.0]), (0,), ())
    np.testing.assert_allclose(closing, [0.1, 0.2, 1.0, -1.4], rtol=1e-12)
    opening = law.impact(np.array([0.1, 0.2, 1.0, -2.0]), (0,), ())
    assert opening.tolist() == [0.1, 0.2, 1.0, -2.0]


def test_geometric_law_also_closes_the_gap() -> None:
    """``q+ = q- - K^-1 W L^-1 g`` by hand for two_mass: both masses move, the second to 0.5."""
    law = Geometric(sample("two_mass").system)
    found = law.impact(np.array([0.1, 0.2, 1.0, 2.0]), (0,), ())
    # K^-1 w is proportional to (1, 2): the first mass moves half as far as the second.
    np.testing.assert_allclose(found, [0.1 + 0.15, 0.5, 1.0, -1.4], rtol=1e-12)


@pytest.mark.parametrize("law", [Kinematic, Geometric, Unilateral])
@pytest.mark.parametrize(("active", "closed"), [((1,), ()), ((0, 1), ()), ((0, 1), (1,))])
def test_bits_of_a_replica_do_not_depend_on_the_others(
    law: type[ReplicaLaw], active: tuple[int, ...], closed: tuple[int, ...]
) -> None:
    """Many replicas jump as each of them does alone."""
    random = np.random.default_rng(5)
    W = random.normal(size=(4, 2))
    model = system(
        *(np.diag(random.uniform(1, 2, 4)) for _ in range(3)),
        contacts=[(W[:, 0], 0.1, 0.5), (W[:, 1], 0.2, 0.5)],
    )
    replica, x = law(model), random.normal(size=(5, 7, 8))
    found = replica.impact(x, active, closed)
    for k in np.ndindex(5, 7):
        np.testing.assert_array_equal(found[k], replica.impact(x[k], active, closed))


class Mirror(ReplicaLaw):
    """A law of another package."""

    name: ClassVar[str] = "mirror"

    def impact(self, x: Array, active: tuple[int, ...], closed: tuple[int, ...]) -> Array:
        """Reverse the state."""
        del active, closed
        return -x


@pytest.mark.parametrize(
    ("method", "inherited"), [("impact", "energy_removed"), ("motion", "phase")]
)
def test_law_that_inherits_half_of_another_law_is_refused(method: str, inherited: str) -> None:
    """Else its replicas would move by two laws. The error names both methods and the remedy."""
    message = (
        f"Own overrides {method} and inherits {inherited} of another law: override it too, or"
        f" write {inherited} = ReplicaLaw.{inherited}"
    )
    with pytest.raises(TypeError, match=message):
        type("Own", (Geometric,), {method: getattr(Geometric, method)})


class Halfway(Geometric):
    """A law that redefines ``impact``, and with it what must agree with an impact."""

    energy_removed = ReplicaLaw.energy_removed

    def impact(self, x: Array, active: tuple[int, ...], closed: tuple[int, ...]) -> Array:
        """Half of the state."""
        return (x + super().impact(x, active, closed)) / 2


def test_all_replicas_jump_by_the_impact_of_their_law() -> None:
    """The estimate and the other replicas jump alike, and no bound is certified."""
    model = sample("two_mass").system
    replicas = np.array([[0.1, 0.6, 1.0, 0.5], [0.2, 0.3, -1.0, 0.8], [0.0, 0.4, 0.3, -0.2]])
    law, change = Halfway(model), ContactChange(0.0, (), (0,), ())
    found = law.correct(change, Belief.of(replicas))
    wanted = [law.impact(x, (0,), ()) for x in replicas]
    np.testing.assert_allclose(found.replicas, wanted, rtol=0, atol=1e-15)
    assert law.begin(replicas, np.eye(4), ()).bound is None


def install(monkeypatch: pytest.MonkeyPatch, **entries: str) -> None:
    """As if packages with these entry points were installed."""
    found = EntryPoints(
        EntryPoint(name.replace("_", "-"), value, laws_module.ENTRY_POINTS)
        for name, value in entries.items()
    )
    monkeypatch.setattr(laws_module, "entry_points", found.select)


def test_law_of_another_package_is_found_by_its_entry_point(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It stands after the built-in ones and cannot replace one of them."""
    install(monkeypatch, a_mirror=f"{__name__}:Mirror", geometric=f"{__name__}:Mirror")
    monkeypatch.setitem(sys.modules, __name__, SimpleNamespace(Mirror=Mirror))
    assert law_names() == (*OWN_LAWS, "a-mirror")
    assert law_named("a-mirror") is Mirror
    assert law_named("geometric") is Geometric


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("math:pi", "law 'broken': math:pi is not a subclass of Law"),
        ("math:no_such", "law 'broken': math:no_such cannot be imported: .*no_such"),
        ("no_such_module:Law", "law 'broken': no_such_module:Law cannot be imported: .*No mod"),
    ],
)
def test_entry_point_that_is_no_law_is_one_line(
    value: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether it cannot be imported or is something else."""
    install(monkeypatch, broken=value)
    with pytest.raises(UsageError, match=message):
        law_named("broken")


LAW = """import numpy as np
from impact_observer.dynamics import PositionProjection
from impact_observer.observer import ReplicaLaw
class Mine(ReplicaLaw):
    name = "mine"
    def impact(self, x, active, closed):
        return {returned}
"""


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (LAW.format(returned="1 / len(())"), "ZeroDivisionError in {path}, line 7: division by"),
        (LAW.format(returned="np.linalg.inv(x)"), "LinAlgError in {path}, line 7: 1-dimensional"),
        (
            LAW.format(returned="PositionProjection(self.system).position_after(x, active)"),
            "ValueError in {path}, line 7: ",
        ),
        (LAW.format(returned="x[:3]"), "ValueError after Mine: "),
        (
            LAW.replace("np", "numby", 1).format(returned="np.zeros(4)"),
            "NameError in {path}, line 7",
        ),
        (
            LAW.format(returned="x\nMine.none()"),
            "law 'mine': my_laws:Mine cannot be imported: AttributeError in {path}, line 8: ",
        ),
        (
            LAW.replace("(ReplicaLaw)", "(LAWS[2])").replace("import Re", "import LAWS, Re"),
            "law 'mine': my_laws:Mine cannot be imported: ImportError in {path}, line 3: ",
        ),
        (
            LAW.format(returned="x +"),
            "law 'mine': my_laws:Mine cannot be imported: SyntaxError: invalid syntax (my_",
        ),
    ],
)
def test_an_error_in_a_law_of_ones_own_names_its_line(
    text: str,
    line: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The file and line of the user, no plea for a report, and one line."""
    path, metadata = tmp_path / "my_laws.py", tmp_path / "my_laws-1.dist-info"
    path.write_text(text)
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: my-laws\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text("[impact_observer.laws]\nmine = my_laws:Mine\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_laws", raising=False)
    bag = str(shared("bags/two_mass"))
    assert main(["observe", bag, "--law", "mine", "-o", str(tmp_path / "bag")]) > 0
    errors = capsys.readouterr().err
    assert line.format(path=path) in errors
    assert "report it" not in errors
    assert errors.count("\n") == 1


def test_unknown_law_is_one_line_with_the_existing_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of other packages included."""
    install(monkeypatch, a_mirror="x:y")
    with pytest.raises(UsageError, match="law 'geo'"):
        law_named("geo")


def rounding(*states: Array) -> float:
    """Rounding error of V at large states."""
    return 1e-13 * max(float(np.max(np.abs(x))) for x in states) ** 2


@pytest.mark.slow
@CORRECTING
@examples(20)
@given(st.data())
def test_distance_of_two_replicas_never_rises_under_any_switching(
    law: type[ReplicaLaw], data: st.DataObject
) -> None:
    """Without a plant: random instants and contacts, pulses and intervals, K singular or not."""
    model = data.draw(st.one_of(*(each(contacts=(1, 3)) for each in (systems, moving_systems))))
    assume(passes_eigenvalue_test(model))
    replica, t = law(model), data.draw(st.integers(0, 3)) / 2
    states = [replica.admissible(data.draw(vectors(2 * model.n))) for _ in range(2)]
    last = distance(model, *states)
    tolerance = 1e-10 * (1 + last)
    for found, _ in switched(replica, states, data.draw(switchings(model.m)), t):
        now = distance(model, *found)
        assert now <= last + tolerance + rounding(*found)
        last = now


@pytest.mark.slow
@CORRECTING
@examples(8)
@given(st.data())
def test_distance_of_a_replica_to_its_plant_never_rises(
    law: type[ReplicaLaw], data: st.DataObject
) -> None:
    """Under the true switching, at the true instants: V falls in every phase and every jump."""
    kinds = [each(contacts=(1, 3), gaps=(0.0, 1.0)) for each in (systems, moving_systems)]
    model = data.draw(st.one_of(*kinds))
    assume(passes_eigenvalue_test(model))
    x = np.concatenate([data.draw(vectors(model.n, -0.5, 0.5)), data.draw(vectors(model.n))])
    assume(np.all(model.gap(x[: model.n]) >= 0))
    switchings = switchings_of(model, x, seconds=5.0)
    assume(switchings)
    replica, t = law(model), 0.0
    y = replica.admissible(data.draw(vectors(2 * model.n)))
    first = last = distance(model, x, y)
    closed: tuple[int, ...] = ()
    for switching in switchings:
        until = -switching.instant.until(EPOCH)
        y = replica.motion(t, y, closed).state(until - t)
        size = 1e-9 * (first + 1e-3) + 1e-12 * float(np.max(np.abs(y))) ** 2
        before = distance(model, switching.before, y)
        assert before <= last + size
        closed, true = switching.closed, switching.before
        if switching.contacts:
            try:
                y = replica.impact(y, switching.contacts, closed)
                true = Kinematic(model).impact(true, switching.contacts, closed)
            except ImpactLawError:
                assume(False)
        # Where impacts accumulate the plant leaves out the last of them.
        cut = distance(model, switching.after, true)
        last = distance(model, switching.after, y)
        assert last <= before + size + 2 * np.sqrt(cut * before) + cut
        t = until
