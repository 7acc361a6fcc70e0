"""What is seen when: tracks of a plant and its estimates, cut at impacts, and closed contacts.

Between two samples a track goes straight. Where an impact lies between them it stays at the
earlier sample until the impact, and is at the later one from then on: a jump is no motion.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from impact_observer.draw.scene.scene import Scene
from impact_observer.dynamics.lyapunov import distance
from impact_observer.events import ImpactEvent, Kind
from impact_observer.model import System
from impact_observer.observer.event_order import impacts_of
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Stamps, Vector

_MOST_POSITIONS = 20_000
"""Most samples of a track that the scene is measured by."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """How one plant or estimate moves; make it by ``Track.of``.

    Attributes:
        label: what it is called.
        law: name of an estimate's law; empty for a plant.
        stamps: ascending, each once, ns, shape (samples,).
        q: coordinates, shape (samples, n).
        u: velocities, shape (samples, n).
        cuts: stamps of its jumps, ascending, ns.
    """

    label: str
    law: str
    stamps: Stamps
    q: Matrix
    u: Matrix
    cuts: Stamps

    @classmethod
    def of(
        cls, label: str, law: str, states: tuple[Stamps, Matrix, Matrix], cuts: Iterable[int]
    ) -> "Track":
        """The track of states in any order; of those with one stamp the last one counts.

        Args:
            label: what it is called.
            law: name of an estimate's law; empty for a plant.
            states: stamps (ns), coordinates and velocities.
            cuts: stamps of jumps, ns.
        """
        stamps, q, u = states
        found, from_behind = np.unique(stamps[::-1], return_index=True)
        last = stamps.size - 1 - from_behind
        jumps = np.array(sorted(set(cuts)), dtype=np.int64)
        return cls(label, law, found, q[last], u[last], jumps)

    def at(self, stamp: int) -> Vector | None:
        """Coordinates at ``stamp``, ns, shape (n,); None before the first and after the last."""
        if not self.stamps.size or not self.stamps[0] <= stamp <= self.stamps[-1]:
            return None
        i = int(np.searchsorted(self.stamps, stamp, side="right")) - 1
        start = int(self.stamps[i])
        if start == stamp:
            return np.asarray(self.q[i])
        end = int(self.stamps[i + 1])
        # A sample at the stamp of an impact is the state after it.
        first, behind = np.searchsorted(self.cuts, [start, end], side="right")
        if first == behind:
            part = (stamp - start) / (end - start)
            return np.asarray(self.q[i] + part * (self.q[i + 1] - self.q[i]))
        return np.asarray(self.q[i + 1 if stamp >= self.cuts[behind - 1] else i])


@dataclass(frozen=True, slots=True, eq=False)
class Distance:
    """``V`` of an estimate where it has the stamps of the truth.

    Attributes:
        stamps: ns, shape (samples,).
        V: J, shape (samples,).
    """

    stamps: Stamps
    V: Vector

    @classmethod
    def between(cls, system: System, truth: Track, estimate: Track) -> "Distance":
        """That of an estimate from the truth; no samples where they have no stamp in common."""
        common, i, j = np.intersect1d(truth.stamps, estimate.stamps, True, return_indices=True)
        q, u = estimate.q[j] - truth.q[i], estimate.u[j] - truth.u[i]
        return cls(common, np.asarray(distance(system, q, u)))


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """When contacts are hit, and when they stay closed.

    Attributes:
        hits: by index of a contact, stamps of its impacts and closings, ascending, ns.
        closed: by index of a contact, stamps of closing and opening in turn, ascending, ns.
    """

    hits: Mapping[int, Stamps]
    closed: Mapping[int, Stamps]

    @classmethod
    def of(cls, system: System, events: Sequence[ImpactEvent]) -> "Contacts":
        """What a stream of events says of the contacts of a system; others are left out."""
        index = {name: i for i, name in enumerate(system.contact_names)}
        stamps: dict[int, list[int]] = {}
        switches: dict[int, list[int]] = {}
        told = [(s, index[c], k) for s, c, k in impacts_of(events) if c in index]
        opened = [
            (event.stamp, index[switch.contact], switch.kind)
            for event in events
            for switch in event.switches
            if switch.kind is Kind.OPEN and switch.contact in index
        ]
        for stamp, contact, kind in sorted([*told, *opened]):
            if kind is not Kind.OPEN:
                stamps.setdefault(contact, []).append(stamp)
            turns = switches.setdefault(contact, [])
            # An impact of a closed contact says nothing new, nor an opening of an open one.
            if (kind is Kind.OPEN) if len(turns) % 2 else (kind is Kind.CLOSE):
                turns.append(stamp)
        return cls(_arrays(stamps), _arrays(switches))

    def is_closed(self, contact: int, stamp: int) -> bool:
        """Whether a contact stays closed at ``stamp``, ns."""
        turns = self.closed.get(contact)
        return turns is not None and bool(np.searchsorted(turns, stamp, side="right") % 2)

    def glow(self, contact: int, stamp: int, lasting: int) -> float:
        """1 at a hit, fading to 0 within ``lasting``, ns."""
        found = self.hits.get(contact)
        last = -1 if found is None else int(np.searchsorted(found, stamp, side="right")) - 1
        if found is None or last < 0:
            return 0.0
        return max(1.0 - (stamp - int(found[last])) / lasting, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """All that is shown.

    Attributes:
        scene: what stands where, the same for every track.
        truth: the plant's track; None where it is not known.
        estimates: the estimates' tracks.
        distances: V of each estimate, as many; none without truth.
        contacts: when stops are hit or closed.
        epoch: stamp from which time is counted, ns.
        start: stamp of the first picture, ns.
        end: stamp of the last picture, ns.
    """

    scene: Scene
    truth: Track | None
    estimates: tuple[Track, ...]
    distances: tuple[Distance, ...]
    contacts: Contacts
    epoch: int
    start: int
    end: int

    @property
    def tracks(self) -> tuple[Track, ...]:
        """The plant's track, if there is one, and those of the estimates."""
        return self.estimates if self.truth is None else (self.truth, *self.estimates)

    def stamps(self, fps: float, speed: float) -> Stamps:
        """When the pictures are taken, ns, the first at the start.

        Args:
            fps: pictures a second of the film.
            speed: recorded seconds a second of the film.
        """
        steps = np.arange(self.count(fps, speed)) * (NS_PER_S * speed / fps)
        return np.asarray(self.start + np.rint(steps).astype(np.int64))

    def count(self, fps: float, speed: float) -> int:
        """How many pictures these are."""
        return int((self.end - self.start) / (NS_PER_S * speed / fps) + 1e-9) + 1

    def seconds(self, stamps: Stamps) -> Vector:
        """``stamps`` as seconds since the epoch."""
        return np.asarray((stamps - self.epoch) / NS_PER_S)


def scene_of(system: System, tracks: Sequence[Track]) -> Scene:
    """A scene with room for all ``tracks``."""
    positions = [each.q[:: max(len(each.q) // _MOST_POSITIONS, 1)] for each in tracks]
    return Scene.of(system, np.vstack([np.empty((0, system.n)), *positions]))


def _arrays(stamps: Mapping[int, Sequence[int]]) -> dict[int, Stamps]:
    return {contact: np.array(each, dtype=np.int64) for contact, each in stamps.items()}
