# SPDX-License-Identifier: Apache-2.0
"""Whether the covariance of ``minimum-variance`` is consistent: ``./dev bench covariance``.

Three tables, without timing:

- ideal stamps (1 ns): V over the initial V just after each of the first 2n + 2 impacts, 20 starts;
- consistency: plants that start at random, stamps with declared normal errors of 1 ms, initial
  errors as declared (standard normal in every coordinate). The normalised estimation error squared
  (NEES) over 2n should be 1 on average: at the 2n-th impact and each second after it, farther than
  five deviations of the clock from any impact;
- jitter: V over the initial V at 60 s, against the geometric law, and against the Cramer-Rao bound
  of its expectation: the covariance of an unbiased estimator that linearises at the true states.

Runs with persistent contact are left out. The model ``random`` is a new chain in every run.

Instead, ``--seeds N`` follows N runs of a minute from random states by an observer with all
options at their defaults, with ideal events: z of each run, the median of |error| over standard
deviation after 10 s, and V over the initial energy of the plant at 30 s. Samples within 5 ms of an
impact do not count.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from benchmarks.impacts import energy
from impact_observer import Options, make_observer
from impact_observer.dynamics import ImpactLaw, Phases
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.saltation import Measured, Mirror, StateRates
from impact_observer.filter.square_root import correction, triangular
from impact_observer.filter.uncertainty import Uncertainty
from impact_observer.model import Contact, Forcing, System, read_model
from impact_observer.observer import Belief, Law
from impact_observer.observer.laws.geometric import Geometric
from impact_observer.observer.laws.minimum_variance import MinimumVariance
from impact_observer.plant import Plant, Run, simulate
from impact_observer.stamps import NS_PER_S, grid, seconds_between

EPOCH = 5 * NS_PER_S
JITTER = 1e-3
"""Standard deviation of the errors of stamps, s."""
MARGIN = 5 * JITTER
"""Distance from an impact at which truth and estimate are on the same side of it, s."""
MODELS = ("two_mass", "three_mass", "random")

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]


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


def simulated(system: System, x: Array, stamps: Stamps) -> Run:
    """A run of the plant from ``x``, with its states at ``stamps``."""
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


def ideal(name: str, seeds: int = 20) -> Array:
    """V over the initial V just after each of 2n + 2 impacts, shape (seeds, 2n + 2)."""
    model = read_model(name)
    system, x, count = model.system, np.concatenate(model.initial_state()), 2 * model.system.n + 2
    impacts = hits(simulated(system, x, np.array([EPOCH + 30 * NS_PER_S])))[:count]
    truth = simulated(system, x, np.array([stamp + 1 for stamp, _ in impacts])).states
    law, ratios = MinimumVariance(system, without_faults(0.0)), np.empty((seeds, count))
    for seed in range(seeds):
        wrong = np.random.default_rng(seed).normal(size=x.size)
        for k, each in enumerate(list(followed(law, x + wrong, impacts))[1:]):
            differences = each.at(law, each.stamp + 1)[0] - truth[k]
            ratios[seed, k] = energy(system, differences) / energy(system, wrong)
    return ratios


def without_faults(clock_error: float) -> Uncertainty:
    """The options of a sensor without faults except in its stamps."""
    return Uncertainty(clock_error=clock_error, missed=0.0, spurious=0.0, mislabelled=0.0)


def nees_of_run(name: str, seed: int, seconds: int) -> Array | None:
    """NEES over 2n at the 2n-th impact and each second, NaN near impacts; None if left out."""
    rng = np.random.default_rng([2014, seed])
    system, x = drawn(name, rng)
    each_second = np.arange(1, seconds + 1) * NS_PER_S + EPOCH
    run, twice = simulated(system, x, each_second), 2 * system.n
    if any(each.closed for each in run.switchings) or len(run.impacts) < twice:
        return None
    instants = np.array([stamp for stamp, _ in hits(run)])
    stamps = np.append(instants[twice - 1] + round(1.1 * MARGIN * NS_PER_S), each_second)
    near = np.min(np.abs(stamps[:, None] - instants), axis=1) < MARGIN * NS_PER_S
    order = np.argsort(stamps)
    truth = np.empty((stamps.size, twice))
    truth[order] = simulated(system, x, stamps[order]).states
    law = MinimumVariance(system, without_faults(JITTER))
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


def jitter(name: str, law: type[Law], clock: float, seeds: int, seconds: int = 60) -> Array:
    """V over the initial V at the end, shape (seeds,)."""
    model = read_model(name)
    system, x = model.system, np.concatenate(model.initial_state())
    end = EPOCH + seconds * NS_PER_S
    run, ratios = simulated(system, x, np.array([end])), np.empty(seeds)
    used = law(system, without_faults(clock))
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        wrong = rng.normal(size=x.size)
        last = list(followed(used, x + wrong, jittered(run, rng)))[-1]
        differences = last.at(used, end)[0] - run.states[0]
        ratios[seed] = energy(system, differences) / energy(system, wrong)
    return ratios


def least(name: str, seconds: int = 60) -> float:
    """The Cramer-Rao bound of the expected ``V`` over the expected initial ``V``.

    Every impact is linearised at the true state.
    """
    model = read_model(name)
    system, x = model.system, np.concatenate(model.initial_state())
    phases, law = Phases(system), ImpactLaw(system)
    phase, start = phases.phase(), np.eye(2 * system.n)
    rates, root, last = StateRates(phase), start, 0.0
    for each in simulated(system, x, np.array([EPOCH + seconds * NS_PER_S])).impacts:
        t, hit = -each.instant.until(EPOCH), each.contacts
        forces = system.forcing.derivatives(np.array([t]), 2)[:, 0]
        joint = linalg.block_diag(JITTER, phase.transition(t - last) @ root)
        rows = Measured.gaps(system, hit).expanded(rates, each.before, forces).H
        corrected = correction(joint, rows, 1e-15 * np.eye(len(hit))).root
        mirror = Mirror.of(system, law.jump(hit), hit)
        jump = mirror.expanded(rates, rates, each.before, forces)
        root = triangular(jump.H @ corrected)
        last = t
    root = phase.transition(seconds - last) @ root
    return float(np.sum(energy(system, root.T)) / np.sum(energy(system, start)))


def print_consistency(name: str, runs: int, seconds: int) -> None:
    """Print a row for each instant."""
    found = [each for k in range(runs) if (each := nees_of_run(name, k, seconds)) is not None]
    print(f"\n{name}: NEES / 2n of {len(found)} runs of {runs}, jitter 1 ms, declared")
    print(f"{'at':>12} {'runs':>5} {'mean':>7} {'median':>7} {'99 %':>7} {'largest':>8}")
    if not found:
        return
    values = np.array(found)
    for k, row in enumerate(values.T):
        kept = row[~np.isnan(row)]
        if kept.size and (k in (0, 1, 2) or k % 5 == 0):
            at = f"{k} s" if k else "2n-th impact"
            parts = (np.mean(kept), np.median(kept), np.quantile(kept, 0.99), np.max(kept))
            print(f"{at:>12} {kept.size:>5} " + " ".join(f"{part:7.3f}" for part in parts))
    means = np.nanmean(values[:, 1:], axis=0)
    print(f"  highest mean of any second: {np.max(means):.3f}")


def of_defaults(name: str, seed: int) -> tuple[float, float, int]:
    """Of a run with all options at their defaults: z, V / V0 at 30 s, impacts by then."""
    system, x = drawn(name, np.random.default_rng([2028, seed]))
    stamps = grid(EPOCH, EPOCH + 60 * NS_PER_S, 10.0)
    run = simulated(system, x, stamps)
    impacts = np.array([stamp for stamp, _ in hits(run)])
    observer = make_observer(system, Options(law="minimum-variance", epoch=EPOCH))
    waiting, z, ratio = list(run.events)[::-1], [], np.nan
    for stamp, truth in zip(stamps.tolist(), run.states, strict=True):
        while waiting and waiting[-1].stamp <= stamp:
            observer.receive(waiting.pop())
        if np.min(np.abs(impacts - stamp), initial=NS_PER_S) < MARGIN * NS_PER_S:
            continue
        estimate = observer.estimate(stamp)
        error = np.concatenate([estimate.q, estimate.u]) - truth
        if stamp >= EPOCH + 10 * NS_PER_S:
            z.append(np.abs(error) / np.sqrt(np.diag(estimate.covariance)))
        if stamp >= EPOCH + 30 * NS_PER_S and np.isnan(ratio):
            ratio = float(energy(system, error) / energy(system, x))
    return float(np.median(z)), ratio, int(np.sum(impacts < EPOCH + 30 * NS_PER_S))


def print_defaults(name: str, seeds: int) -> None:
    """Print z and V of all runs, and how many are within the goals."""
    z, ratios, impacts = np.array([of_defaults(name, seed) for seed in range(seeds)]).T
    print(f"\n{name}: {seeds} runs with all options at their defaults, ideal events")
    for low, high in ((0.5, 1.5), (0.3, 3.0)):
        print(f"  z between {low} and {high}: {np.sum((z >= low) & (z <= high))}")
    print(f"  z: median {np.median(z):.2f}, {np.min(z):.2f} to {np.max(z):.2f}")
    print(
        f"  V / V0 at 30 s below 1e-17: {np.sum(ratios < 1e-17)}, median {np.median(ratios):.1e},"
        f" worst {np.max(ratios):.1e}"
    )
    for k in np.flatnonzero(ratios >= 1e-17):
        fewer = np.sum(impacts < impacts[k])
        print(f"  seed {k}: {ratios[k]:.1e} after {impacts[k]:.0f} impacts; {fewer} had fewer")


def main(args: Sequence[str] | None = None) -> int:
    """Print the three tables, or that of ``--seeds``."""
    parser = argparse.ArgumentParser(prog="./dev bench covariance")
    parser.add_argument(
        "--runs", type=int, default=500, metavar="N", help="of the second table (default 500)"
    )
    parser.add_argument("--seconds", type=int, default=30, metavar="S", help="their length")
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    parser.add_argument("--seeds", type=int, default=0, metavar="N", help="defaults, instead")
    given = parser.parse_args(args)
    if given.runs < 1 or given.seconds < 1 or given.seeds < 0:
        parser.error("--runs, --seconds and --seeds: expected 1 or more")
    if given.seeds:
        for name in given.models:
            print_defaults(name, given.seeds)
        return 0
    samples = [name for name in given.models if name != "random"]
    for name in samples:
        ratios = ideal(name)
        print(f"\n{name}: V / V0 just after impact k, stamps of 1 ns, {len(ratios)} starts")
        for k, column in enumerate(ratios.T, start=1):
            print(f"{k:>12} median {np.median(column):8.1e}   worst {np.max(column):8.1e}")
    for name in given.models:
        print_consistency(name, given.runs, given.seconds)
    for name in samples:
        seeds = min(given.runs, 40)
        print(f"\n{name}: V / V0 after 60 s, jitter 1 ms, {seeds} starts")
        for law, clock in ((MinimumVariance, JITTER), (MinimumVariance, 0.0), (Geometric, 0.0)):
            ratios = jitter(name, law, clock, seeds)
            declared = "declared" if clock else "declared exact"
            print(
                f"{law.name:>18}, {declared:12} median {np.median(ratios):8.1e}"
                f"   worst {np.max(ratios):8.1e}"
            )
        print(f"{'best unbiased':>18}, {'':12} expected {least(name):6.1e}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
