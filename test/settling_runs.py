# SPDX-License-Identifier: Apache-2.0
"""A drill that comes to rest on its stops, and errors of runs in which no contact rests."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.model import Contact, Forcing, System, parse_model, read_model
from impact_observer.observer import Belief, Law
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import NS_PER_S, from_seconds, grid, seconds_between
from impact_observer.states import Vector

DRILL = parse_model(
    """
name: drill
bodies: [{name: motor, mass: 2}, {name: rod, mass: 1}, {name: bit, mass: 0.5}]
springs:
  - {between: [ground, motor], stiffness: 30, damping: 0.6}
  - {between: [motor, rod], stiffness: 60, damping: 0.4}
  - {between: [rod, bit], stiffness: 60, damping: 0.2}
forces:
  - {body: bit, constant: 4}
  - {body: motor, amplitude: 12, frequency: 2.2}
stops:
  - {name: rock, body: bit, limit: 0.05, side: above, restitution: 0.6}
  - {name: collar, body: rod, limit: -0.08, side: below, restitution: 0.4}
""",
    "drill",
).system
"""Three masses with two stops, pressed on the rock by a constant force."""
EPOCH = 5 * NS_PER_S
RATE = 20.0
JITTER = 1e-3
"""Standard deviation of the errors of stamps, s."""
MARGIN = 5 * JITTER
"""Distance from an impact at which truth and estimate are on the same side of it, s."""

Array = NDArray[np.float64]


def start_of(system: System, seed: int) -> Vector:
    """A state of the plant inside no stop, shape (2n,)."""
    rng = np.random.default_rng(seed)
    while True:
        x: Vector = rng.normal(size=2 * system.n) * np.repeat([0.1, 0.7], system.n)
        if np.all(system.gap(x[: system.n]) > 0.0):
            return x


def simulated(system: System, seed: int, seconds: float) -> Run:
    """A run of the plant."""
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), RATE)[1:]
    return simulate(Plant(system, *np.split(start_of(system, seed), 2), epoch=EPOCH), stamps)


class Posterior(NamedTuple):
    """The belief of a law just after an impact, or at the epoch."""

    stamp: int
    belief: Belief

    def at(self, law: Law, stamp: int) -> tuple[Array, Array | None]:
        """The estimate and a square root of its covariance at a later stamp."""
        s = seconds_between(self.stamp, stamp)
        if s == 0:
            return self.belief.x, self.belief.root
        prediction = law.predict(seconds_between(EPOCH, self.stamp), self.belief, ())
        return prediction.state(s), prediction.root(s)


def random_chain(rng: np.random.Generator) -> System:
    """Two to four bodies between two walls, the first forced, the outer ones with a stop each."""
    n = int(rng.integers(2, 5))
    springs = np.vstack([np.eye(n), np.zeros((1, n))]) - np.eye(n + 1, n, k=-1)
    names = tuple(f"x{i + 1}" for i in range(n))
    force = Forcing(
        np.zeros(n),
        rng.uniform(2.0, 5.0, 1),
        rng.uniform(3.0, 8.0) * np.eye(n)[:1],
        np.zeros((1, n)),
    )
    stops = [(np.eye(n)[0], "left"), (-np.eye(n)[-1], "right")]
    return System(
        "random",
        names,
        np.diag(rng.uniform(0.5, 2.0, n)),
        springs.T @ np.diag(rng.uniform(0.02, 0.2, n + 1)) @ springs,
        springs.T @ np.diag(rng.uniform(10.0, 40.0, n + 1)) @ springs,
        force,
        tuple(Contact(name, w, rng.uniform(0.1, 0.4), rng.uniform(0.5, 0.9)) for w, name in stops),
    )


def drawn(name: str, rng: np.random.Generator) -> tuple[System, Array]:
    """A system, and an initial state of the plant inside no stop."""
    system = random_chain(rng) if name == "random" else read_model(name).system
    while True:
        x = rng.normal(size=2 * system.n) * np.repeat([0.2, 0.7], system.n)
        if np.all(system.gap(x[: system.n]) > 0.01):
            return system, x


def moved(system: System, x: Array, stamps: NDArray[np.int64]) -> Run:
    """A run of a plant from ``x``, with its states at ``stamps``."""
    return simulate(Plant(system, *np.split(x, 2), epoch=EPOCH), stamps)


def hits(run: Run) -> list[tuple[int, tuple[int, ...]]]:
    """Stamps and contacts of all impacts."""
    return [(each.instant.stamp, each.contacts) for each in run.impacts]


def followed(
    law: Law, x: Array, impacts: Sequence[tuple[int, tuple[int, ...]]]
) -> Iterator[Posterior]:
    """The belief of a law at the epoch and after each impact."""
    root = law.uncertainty.root(law.system.n)
    now = Posterior(EPOCH, law.begin(x[None], root, ()))
    yield now
    for stamp, contacts in sorted(impacts):
        prediction = law.predict(seconds_between(EPOCH, now.stamp), now.belief, ())
        before = prediction.belief(seconds_between(now.stamp, stamp))
        change = ContactChange(seconds_between(EPOCH, stamp), (), contacts, ())
        now = Posterior(stamp, law.correct(change, before))
        yield now


def jittered(run: Run, rng: np.random.Generator) -> list[tuple[int, tuple[int, ...]]]:
    """Stamps and contacts of all impacts, with jitter."""
    wrong = np.rint(rng.normal(0.0, JITTER * NS_PER_S, len(run.impacts))).astype(int).tolist()
    exact = hits(run)
    return [(max(s + by, EPOCH), hit) for (s, hit), by in zip(exact, wrong, strict=True)]


def nees_of_run(name: str, seed: int, seconds: int) -> Array | None:
    """NEES over 2n at the 2n-th impact and each second, NaN near impacts; None if left out."""
    rng = np.random.default_rng([2014, seed])
    system, x = drawn(name, rng)
    each_second = np.arange(1, seconds + 1) * NS_PER_S + EPOCH
    run, twice = moved(system, x, each_second), 2 * system.n
    if any(each.closed for each in run.switchings) or len(run.impacts) < twice:
        return None
    instants = np.array([stamp for stamp, _ in hits(run)])
    stamps = np.append(instants[twice - 1] + round(1.1 * MARGIN * NS_PER_S), each_second)
    near = np.min(np.abs(stamps[:, None] - instants), axis=1) < MARGIN * NS_PER_S
    order = np.argsort(stamps)
    truth = np.empty((stamps.size, twice))
    truth[order] = moved(system, x, stamps[order]).states
    declared = Uncertainty(clock_error=JITTER, missed=0.0, spurious=0.0, mislabelled=0.0)
    law = MinimumVariance(system, declared)
    beliefs = list(followed(law, x + rng.normal(size=twice), jittered(run, rng)))
    starts = np.array([each.stamp for each in beliefs])
    found = np.full(stamps.size, np.nan)
    for k in np.flatnonzero(~near):
        last = beliefs[int(np.searchsorted(starts, stamps[k], side="right")) - 1]
        estimate, root = last.at(law, int(stamps[k]))
        assert root is not None
        normal = np.linalg.lstsq(root, estimate - truth[k], rcond=None)[0]
        found[k] = normal @ normal / twice
    return found
