"""The correction by a single impact: against that by any event, and compiled."""

import math
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import FunctionType, ModuleType
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from systems import (
    EPOCH,
    PRESSED,
    chain,
    examples,
    forcing,
    observer,
    run,
    sample,
    system,
    systems,
    without_faults,
)

from impact_observer.cli.main import main
from impact_observer.errors import UsageError
from impact_observer.estimation import compiled, impact_filter, square_root
from impact_observer.estimation import single as single_module
from impact_observer.estimation.compiled import Single, compiled_single
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.impact_filter import ImpactFilter
from impact_observer.estimation.likelihood import Likelihood
from impact_observer.estimation.single import Contact, Fit, State, single
from impact_observer.events import ImpactEvent, Kind, Switch, Verdict
from impact_observer.model import System
from impact_observer.observer import COMPILING, Observer, Options, make_observer, needs_compiling
from impact_observer.observer.laws import BUILT_IN
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.plant import Run
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
STAMP = 1e-9 / math.sqrt(12)
"""Standard deviation of the rounding of a stamp to 1 ns, s."""


@pytest.fixture(scope="module")
def machine() -> Single:
    """``single``, compiled; half a minute where it was never compiled before."""
    pytest.importorskip("numba")
    return compiled_single()


class Case(NamedTuple):
    """An impact of one contact, and the prior."""

    filter: ImpactFilter
    change: ContactChange
    state: GaussianState
    clock: float

    def asked(self) -> tuple[float, float, State, float, Contact]:
        """The arguments with which the filter calls ``single``."""
        found: list[tuple[float, float, State, float, Contact]] = []

        def kept(*question: float | State | Contact) -> tuple[bool, State, Fit]:
            found.append(question)  # type: ignore[arg-type]
            return single(*question)  # type: ignore[arg-type]

        self.filter._single = kept
        self.filter.correct(self.change, self.state, self.clock)
        self.filter._single = single
        (question,) = found
        return question

    def in_general(self) -> tuple[Likelihood, GaussianState]:
        """Likelihood and posterior by the general methods."""
        prior = self.filter.joint_prior(self.change, self.state, self.clock)
        likelihood = self.filter.likelihood(self.change, prior)
        joint = self.filter.joint_posterior(self.change, prior, likelihood)
        return likelihood, self.filter.posterior(self.change, joint)


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """Any system, contact and instant; any covariance, and an error within it or far beyond."""
    model = draw(systems(max_n=4, contacts=(1, 3)))
    contact, size = draw(st.integers(0, model.m - 1)), 2 * model.n
    random = np.random.default_rng(draw(st.integers(0, 999)))
    root = random.normal(size=(size, draw(st.sampled_from([1, size, size + 3]))))
    root *= 10.0 ** -draw(st.integers(0, 10))
    x, w = random.normal(size=size), model.W[:, contact]
    flown = draw(st.sampled_from([0.0, 3.0]))
    change = ContactChange(draw(st.integers(0, 640)) / 64, (), (contact,), (), flown=flown)
    filter_ = ImpactFilter(model)
    rows, _ = filter_.members.given.guard((), (contact,), True)
    at_rest = float(rows.rest[0])
    x[: model.n] -= w * (w @ x[: model.n] + at_rest) / (w @ w)
    if w @ x[model.n :] > 0:
        x[model.n :] *= -1
    x += root @ random.normal(size=root.shape[1]) * draw(st.sampled_from([0.0, 1.0, 1.0, 20.0]))
    differences = random.normal(size=(size, draw(st.integers(0, 3))))
    clock = draw(st.sampled_from([STAMP, STAMP, 1e-8, 1e-3]))
    return Case(filter_, change, GaussianState(x, np.zeros(0), root, differences), clock)


def correlated(near: float = 0.5) -> Case:
    """A mass whose speed has the same error as its position.

    Args:
        near: deviation of its stamp, over what counts as near.
    """
    model = system([[1.0]], [[0.0]], [[0.0]], contacts=[([1], 0.0, 0.5)], force=forcing(1, [-9.8]))
    root = np.array([[0.1, 0.0], [1.0, 0.01]])
    state = GaussianState(
        np.array([0.05, -2.0]), np.zeros(0), root, np.array([[0.1, 0.3], [0.2, -0.4]])
    )
    filter_ = ImpactFilter(model)
    return Case(filter_, ContactChange(1.0, (), (0,), ()), state, near * filter_._near)


def assert_near(found: Array, wanted: Array, error: float) -> None:
    """Equal within ``error`` of the largest."""
    most = float(np.max(np.abs(wanted), initial=0.0))
    np.testing.assert_allclose(found, wanted, rtol=0, atol=error * most)


def assert_same(found: tuple[bool, State, Fit], wanted: tuple[bool, State, Fit]) -> None:
    """Both are near or not; if so all numbers are equal but for rounding."""
    assert found[0] == wanted[0]
    if not wanted[0]:
        return
    (x, root, differences), (y, own, others) = found[1], wanted[1]
    assert_near(x, y, 1e-12)
    assert_near(root @ root.T, own @ own.T, 1e-12)
    assert root.shape == own.shape
    assert not np.any(np.triu(root, 1))
    assert_near(differences, others, 1e-12)
    np.testing.assert_allclose(found[2], wanted[2], rtol=1e-12)


def assert_general(case: Case, error: float) -> None:
    """``single`` and the general methods agree on an impact that is near."""
    near, (x, root, differences), (white, *rest) = single(*case.asked())
    assert near
    likelihood, after = case.in_general()
    assert_near(x, after.x, error)
    assert_near(root @ root.T, after.root @ after.root.T, error)
    assert_near(differences, after.differences, error)
    (innovation,) = likelihood.innovations.values()
    assert abs(white) == pytest.approx(innovation, rel=1e-13)
    found, posterior = case.filter.correct(case.change, case.state, case.clock)
    assert found.density == pytest.approx(likelihood.density, rel=1e-13, abs=1e-13)
    assert list(found.innovations) == list(likelihood.innovations)
    assert all(type(each) is float for each in found.innovations.values())
    assert posterior().x.tolist() == x.tolist()
    assert len(rest) == 3


@pytest.mark.slow
@given(case=cases())
@examples(80)
def test_compiled_function_equals_its_source(machine: Single, case: Case) -> None:
    """Also for impacts that ``single`` declines."""
    question = case.asked()
    assert_same(machine(*question), single(*question))


@pytest.mark.slow
@given(case=cases())
@examples(80)
def test_single_agrees_with_the_general_methods(case: Case) -> None:
    """Whenever ``single`` accepts it."""
    if single(*case.asked())[0]:
        assert_general(case, 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("q", "clock", "near"), [(0.0, STAMP, True), (1.0, STAMP, False), (0.0, 1e-3, False)]
)
def test_single_declines_outliers_and_inaccurate_stamps(
    machine: Single, q: float, clock: float, near: bool
) -> None:
    """A gap of a hundred deviations; a stamp's deviation of 1 ms."""
    state = GaussianState(np.array([q, -2.0]), np.zeros(0), 0.01 * np.eye(2), np.zeros((2, 1)))
    case = correlated()._replace(state=state, clock=clock)
    assert [how(*case.asked())[0] for how in (single, machine)] == [near, near]


@pytest.mark.slow
def test_iterated_linearisations_agree_with_the_general_methods(
    machine: Single, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the prior speed is far from the posterior one."""
    case, count = correlated(), [0]
    product = square_root.product

    def counted(*given: Array) -> tuple[Array, Array]:
        count[0] += 1
        return product(*given)

    with monkeypatch.context() as patch:
        patch.setattr(single_module, "product", counted)
        question = case.asked()
    rounds = (count[0] - 1) / 2  # of two products each, and one for the impact
    assert 2 <= rounds < single_module.ROUNDS
    assert_general(case, 1e-11)
    assert_same(machine(*question), single(*question))


@pytest.mark.slow
def test_root_of_one_column_is_factorised(machine: Single) -> None:
    """A covariance of rank one; the compiler's own factorisation would be too small."""
    case = correlated()
    model = chain(4, contacts=[([1, 0, 0, 0], 0.0, 0.5)])
    x = np.array([0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 2.0, 0.0])
    state = GaussianState(x, np.zeros(0), 0.1 * np.ones((8, 1)), np.zeros((8, 0)))
    question = case._replace(filter=ImpactFilter(model), state=state, clock=STAMP).asked()
    assert single(*question)[0]
    assert_same(machine(*question), single(*question))


class Output(NamedTuple):
    """Verdicts and estimates of an observer."""

    verdicts: list[Verdict]
    x: Array
    covariances: Array
    replicas: Array


def output_of(watcher: Observer, events: Sequence[ImpactEvent]) -> Output:
    """Of an observer that receives ``events`` in this order; one estimate a second."""
    verdicts = [each for event in events for each in watcher.receive(event)]
    last = max(each.stamp for each in events)
    found = [watcher.estimate(stamp) for stamp in range(EPOCH, last, NS_PER_S)]
    assert watcher._timeline is not None
    return Output(
        verdicts,
        np.array([[*each.q, *each.u] for each in found]),
        np.array([each.covariance for each in found]),
        watcher._timeline.entries[-1].belief.replicas,
    )


def counted(watcher: Observer) -> list[bool]:
    """For each call of ``single`` by ``watcher``, whether it accepted the impact."""
    assert isinstance(watcher.law, MinimumVariance)
    filter_, found = watcher.law._bank.filter, list[bool]()
    own = filter_._single

    def asked(
        t: float, flown: float, state: State, clock: float, contact: Contact
    ) -> tuple[bool, State, Fit]:
        result = own(t, flown, state, clock, contact)
        found.append(result[0])
        return result

    filter_._single = asked
    return found


@pytest.fixture
def moving(request: pytest.FixtureRequest) -> tuple[System, Run]:
    """A system by its name, and what its plant does."""
    name = str(request.param)
    if name == "pressed":
        return PRESSED, run(PRESSED, [0, 0], [0, 0], seconds=6.0, rate=10.0)
    model = sample(name)
    return model.system, run(model.system, *model.initial_state(), seconds=10.0, rate=10.0)


@pytest.mark.slow
@pytest.mark.usefixtures("machine")
@pytest.mark.parametrize("moving", ["two_mass", "three_mass", "pressed"], indirect=True)
@pytest.mark.parametrize("doubt", [0.0, 0.01])
def test_compiled_observer_gives_the_same_estimates(
    moving: tuple[System, Run], doubt: float
) -> None:
    """Ten replicas, an event that comes late, contacts that stay closed."""
    model, whole = moving
    events = [*whole.events[:3], *whole.events[4:8], whole.events[3], *whole.events[8:]]
    options = Options(
        law="minimum-variance",
        initial_state="random:1",
        initial_deviation="0.5",
        clock_error=0.0,
        missed=doubt,
        spurious=doubt,
        mislabelled=doubt,
        epoch=EPOCH,
        history=1e3,
    )
    plain, fast = (make_observer(model, replace(options, compiled=each)) for each in (False, True))
    near = counted(fast)
    wanted, found = output_of(plain, events), output_of(fast, events)
    assert sum(near) >= 3
    kinds = {switch.kind for each in whole.events for switch in each.switches}
    assert (Kind.CLOSE in kinds) == (model is PRESSED)
    for one, other in zip(found.verdicts, wanted.verdicts, strict=True):
        assert one._replace(innovation=0) == other._replace(innovation=0)
        # With exact stamps a deviation soon is as small as rounding.
        assert one.innovation == pytest.approx(other.innovation, rel=1e-6, abs=1.0)
    assert_near(found.x, wanted.x, 1e-9)
    assert_near(found.covariances, wanted.covariances, 1e-9)
    assert_near(found.replicas, wanted.replicas, 1e-9)


def test_single_hypothesis_equals_a_filter_bank_of_one() -> None:
    """Where every event is trusted: equal states and verdicts."""
    model = sample("three_mass")
    start = np.concatenate(model.initial_state())
    whole = run(model.system, *model.initial_state(), seconds=10.0, rate=10.0)
    watchers = []
    for single_ in (True, False):
        options = {"epoch": EPOCH, "history": 1e3, "ensemble": 3, "uncertainty": without_faults()}
        watcher = observer(model.system, "minimum-variance", start + 0.2, **options)
        assert isinstance(watcher.law, MinimumVariance)
        assert watcher.law._single
        watcher.law._single = single_
        watchers.append(watcher)
    found, wanted = (output_of(watcher, whole.events) for watcher in watchers)
    assert found.verdicts == wanted.verdicts
    assert all(each.innovation >= 0 for each in found.verdicts)
    assert all(type(each.innovation) is float for each in found.verdicts)
    assert len({each.innovation for each in found.verdicts}) == len(whole.events)
    assert found.x.tolist() == wanted.x.tolist()
    assert found.covariances.tolist() == wanted.covariances.tolist()
    assert found.replicas.tolist() == wanted.replicas.tolist()
    assert watchers[0]._timeline is not None
    assert watchers[1]._timeline is not None
    assert not any(entry.belief.hypotheses for entry in watchers[0]._timeline.entries)
    assert all(len(entry.belief.hypotheses) == 1 for entry in watchers[1]._timeline.entries[1:])


@pytest.mark.parametrize("law", BUILT_IN)
def test_only_the_law_that_can_be_compiled_is_compiled(
    law: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The others take the option and have nothing to compile."""
    made = list[ImpactFilter]()

    def kept(filter_: ImpactFilter) -> None:
        made.append(filter_)

    monkeypatch.setattr(ImpactFilter, "compile", kept)
    model = sample("two_mass").system
    for wanted in (False, True):
        options = Options(law, compiled=wanted)
        watcher = make_observer(model, options)
        assert needs_compiling(options) == (wanted and law == "minimum-variance")
        assert len(made) == needs_compiling(options)
        assert watcher.receive(ImpactEvent(EPOCH, (Switch("stop"),), 1, 0, EPOCH))


@pytest.fixture
def without_numba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba is not installed, and nothing is compiled in this process."""
    monkeypatch.setitem(sys.modules, "numba", None)
    monkeypatch.setattr(impact_filter, "compiled_single", compiled_single.__wrapped__)


def test_a_compiler_that_cannot_be_loaded_gives_the_error_of_a_missing_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As where llvmlite does not find its library."""
    (tmp_path / "numba.py").write_text("raise OSError('no shared object file')\n")
    for name in [each for each in sys.modules if each.partition(".")[0] == "numba"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UsageError, match=r"^compiled needs numba \(no shared object file\)"):
        compiled_single.__wrapped__()


@pytest.mark.usefixtures("without_numba")
def test_a_missing_compiler_is_named_with_its_extra() -> None:
    """In one line, by the law that needs it only."""
    model = sample("two_mass").system
    make_observer(model, Options("geometric", compiled=True))
    with pytest.raises(UsageError) as error:
        make_observer(model, Options("minimum-variance", compiled=True))
    assert len(str(error.value).splitlines()) == 1
    assert "numba" in str(error.value)
    assert "pip install impact_observer[compiled]" in str(error.value)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Two seconds of two_mass."""
    made = tmp_path / "plant"
    assert main(["simulate", "two_mass", "--duration", "2", "-o", str(made)]) == 0
    return made


@pytest.mark.usefixtures("without_numba")
@pytest.mark.parametrize("command", ["observe", "compare", "sweep"])
def test_commands_without_the_compiler_end_in_one_line(
    command: str, bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And exit code 2; nothing is written."""
    if command == "sweep":
        pytest.importorskip("joblib")
        pytest.importorskip("pyarrow")
    output = bag.parent / "output.parquet"
    words = {
        "observe": [str(bag), "--law", "minimum-variance", "-o", str(output)],
        "compare": [str(bag), "--laws", "geometric,minimum-variance"],
        "sweep": ["two_mass", "--laws", "geometric,minimum-variance", "-o", str(output)],
    }[command]
    capsys.readouterr()
    assert main([command, *words, "--compiled"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("impact-observer: compiled needs numba")
    assert len(error.splitlines()) == 1
    assert not output.exists()


@pytest.mark.usefixtures("without_numba")
def test_a_law_that_is_not_compiled_does_not_need_the_compiler(bag: Path) -> None:
    """The option is accepted and has no effect."""
    output = bag.parent / "output"
    assert main(["observe", str(bag), "--compiled", "-o", str(output)]) == 0
    assert output.exists()


@pytest.mark.slow
def test_observe_prints_that_it_compiles_beforehand(
    bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only with ``--compiled``."""
    from impact_observer.cli.progress import Progress

    shown, before = list[str](), list[list[str]]()
    monkeypatch.setattr(Progress, "show", lambda _, text: shown.append(text))
    monkeypatch.setattr(ImpactFilter, "compile", lambda _: before.append([*shown]))
    for k, words in enumerate([[], ["--compiled"]]):
        law = ["--law", "minimum-variance", *words]
        assert main(["observe", str(bag), *law, "-o", str(bag.parent / f"output_{k}")]) == 0
    assert before == [[COMPILING]]


def test_option_compiled_is_in_the_description_of_a_sweep_only_if_set() -> None:
    """So files of sweeps from before the option existed can still be resumed."""
    from impact_observer.plant import SensorModel
    from impact_observer.sweep.model_variants import model_variants
    from impact_observer.sweep.plan import PlantSetup, Sweep

    model = sample("two_mass")
    rig, replicas = PlantSetup(model.text(), 1.0), model_variants(model, {})
    plain, other = (
        Sweep(rig, ("geometric",), (SensorModel(),), replicas, options=Options(compiled=wanted))
        for wanted in (False, True)
    )
    one, two = (each.description()["options"] for each in (plain, other))
    assert isinstance(one, dict)
    assert isinstance(two, dict)
    assert "compiled" not in one
    assert two == {**one, "compiled": True}


def parts() -> Iterator[FunctionType]:
    """All functions of ours that are compiled."""
    waiting, found = [single], list[object]()
    while waiting:
        function = waiting.pop()
        if function in found:
            continue
        found.append(function)
        assert isinstance(function, FunctionType)
        yield function
        used = [function.__globals__.get(name) for name in function.__code__.co_names]
        waiting += [each for each in used if isinstance(each, FunctionType)]


def test_every_compiled_source_is_in_the_digest() -> None:
    """The modules of every compiled function and of every constant in it."""
    watched = {module.__name__: module for module in compiled._SOURCES}
    texts = {name: Path(str(each.__file__)).read_text() for name, each in watched.items()}
    constants = set[str]()
    for function in parts():
        if function.__module__.startswith("impact_observer"):
            assert function.__module__ in watched
            values = {name: function.__globals__.get(name) for name in function.__code__.co_names}
            kinds = (int, float, np.ndarray)
            constants |= {name for name, value in values.items() if isinstance(value, kinds)}
    assert constants >= {"ROUNDING", "FAR", "SETTLED", "ROUNDS", "_SQRT2"}
    for name in constants:
        written = [k for k, text in texts.items() if re.search(rf"^{name} = ", text, re.MULTILINE)]
        assert written, name


def test_a_changed_source_has_another_digest(tmp_path: Path) -> None:
    """Whichever of them changes; machine code of the old ones is not used."""
    modules = []
    for name in ("one", "two"):
        module = ModuleType(name)
        module.__file__ = str(tmp_path / f"{name}.py")
        Path(module.__file__).write_text("FAR = 30.0\n")
        modules.append(module)
    first = compiled._digest((modules[0], modules[1]))
    assert compiled._digest((modules[0], modules[1])) == first
    (tmp_path / "two.py").write_text("FAR = 31.0\n")
    second = compiled._digest((modules[0], modules[1]))
    assert second != first
    kept = [compiled._from(digest).__closure__ for digest in (first, second)]
    assert [[cell.cell_contents for cell in cells or ()] for cells in kept] == [[first], [second]]


def test_it_is_compiled_without_a_cache_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container without a writable folder."""
    numba = pytest.importorskip("numba")
    asked = list[bool]()

    def njit(_: object, cache: bool = False) -> object:
        asked.append(cache)
        if cache:
            raise RuntimeError("cannot cache function 'run': no locator available")
        return lambda function: function

    monkeypatch.setattr(numba, "njit", njit)
    monkeypatch.setattr("numba.extending.overload", lambda _: lambda made: made)
    monkeypatch.setattr("numba.extending.register_jitable", lambda made: made)
    question = correlated().asked()
    found = compiled_single.__wrapped__()(*question)
    assert asked == [True, False]
    assert_same(found, single(*question))
