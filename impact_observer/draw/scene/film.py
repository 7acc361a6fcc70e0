# SPDX-License-Identifier: Apache-2.0
"""The content of a film: tracks of a plant and its estimates, and the contacts over time.

Between two samples a track is interpolated linearly. If an impact lies between two samples, the
track holds the earlier sample before the impact, and the later sample from the impact on.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from impact_observer.draw.scene.scene import Scene
from impact_observer.dynamics.lyapunov import distance
from impact_observer.events import ImpactEvent, Kind
from impact_observer.io.bag_part import TimeZero
from impact_observer.model import System
from impact_observer.observer.event_order import impacts_of
from impact_observer.stamps import NS_PER_S
from impact_observer.states import Matrix, Stamps, Vector

_MOST_POSITIONS = 20_000
"""Most samples of a track by which the scene is arranged."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The motion of the plant or of an estimate; made by ``Track.of_states``.

    Attributes:
        label: name in the film.
        law: name of an estimate's law; empty for a plant.
        stamps: strictly ascending, ns, shape (samples,).
        q: coordinates, shape (samples, n).
        u: velocities, shape (samples, n).
        jumps: stamps of impacts, ascending, ns.
    """

    label: str
    law: str
    stamps: Stamps
    q: Matrix
    u: Matrix
    jumps: Stamps

    @classmethod
    def of_states(
        cls, label: str, law: str, states: tuple[Stamps, Matrix, Matrix], jumps: Iterable[int]
    ) -> "Track":
        """The track of states in any order; of equal stamps the last one counts.

        Args:
            label: name in the film.
            law: name of an estimate's law; empty for a plant.
            states: stamps (ns), coordinates and velocities.
            jumps: stamps of impacts, ns.
        """
        stamps, q, u = states
        unique, from_end = np.unique(stamps[::-1], return_index=True)
        last = stamps.size - 1 - from_end
        at = np.array(sorted(set(jumps)), dtype=np.int64)
        return cls(label, law, unique, q[last], u[last], at)

    def position(self, stamp: int) -> Vector | None:
        """Coordinates at ``stamp``, ns, shape (n,); None before the first and after the last."""
        if not self.stamps.size or not self.stamps[0] <= stamp <= self.stamps[-1]:
            return None
        i = int(np.searchsorted(self.stamps, stamp, side="right")) - 1
        start = int(self.stamps[i])
        if start == stamp:
            return np.asarray(self.q[i])
        end = int(self.stamps[i + 1])
        # A sample at the stamp of an impact is the state after it.
        first, after = np.searchsorted(self.jumps, [start, end], side="right")
        if first == after:
            part = (stamp - start) / (end - start)
            return np.asarray(self.q[i] + part * (self.q[i + 1] - self.q[i]))
        return np.asarray(self.q[i + 1 if stamp >= self.jumps[after - 1] else i])


@dataclass(frozen=True, slots=True, eq=False)
class Distance:
    """``V`` of an estimate at the common stamps of estimate and truth.

    Attributes:
        stamps: ns, shape (samples,).
        V: J, shape (samples,).
    """

    stamps: Stamps
    V: Vector

    @classmethod
    def between(cls, system: System, truth: Track, estimate: Track) -> "Distance":
        """``V`` of the difference of estimate and truth; empty without common stamps."""
        common, i, j = np.intersect1d(truth.stamps, estimate.stamps, True, return_indices=True)
        q, u = estimate.q[j] - truth.q[i], estimate.u[j] - truth.u[i]
        return cls(common, np.asarray(distance(system, q, u)))


@dataclass(frozen=True, slots=True, eq=False)
class ContactHistory:
    """Impacts and persistent contact over time.

    Attributes:
        hits: by index of a contact, stamps of its impacts and closings, ascending, ns.
        closed: by index of a contact, stamps of closing and opening in turn, ascending, ns.
    """

    hits: Mapping[int, Stamps]
    closed: Mapping[int, Stamps]

    @classmethod
    def of_events(cls, system: System, events: Sequence[ImpactEvent]) -> "ContactHistory":
        """The history of a stream of events; contacts of other systems are left out."""
        index = {name: i for i, name in enumerate(system.contact_names)}
        stamps: dict[int, list[int]] = {}
        switches: dict[int, list[int]] = {}
        closing = [(s, index[c], k) for s, c, k in impacts_of(events) if c in index]
        opening = [
            (event.stamp, index[switch.contact], switch.kind)
            for event in events
            for switch in event.switches
            if switch.kind is Kind.OPEN and switch.contact in index
        ]
        for stamp, contact, kind in sorted([*closing, *opening]):
            if kind is not Kind.OPEN:
                stamps.setdefault(contact, []).append(stamp)
            changes = switches.setdefault(contact, [])
            # Closing a closed contact or opening an open one changes nothing.
            if kind is (Kind.OPEN if len(changes) % 2 else Kind.CLOSE):
                changes.append(stamp)
        return cls(_arrays(stamps), _arrays(switches))

    def is_closed(self, contact: int, stamp: int) -> bool:
        """Whether a contact stays closed at ``stamp``, ns."""
        changes = self.closed.get(contact, ())
        return bool(np.searchsorted(changes, stamp, side="right") % 2)

    def highlight(self, contact: int, stamp: int, duration: int) -> float:
        """1 at an impact, fading to 0 within ``duration``, ns."""
        hits = self.hits.get(contact, np.empty(0, np.int64))
        last = int(np.searchsorted(hits, stamp, side="right")) - 1
        return max(1.0 - (stamp - int(hits[last])) / duration, 0.0) if last >= 0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """The content of a film.

    Attributes:
        scene: positions of everything, the same for every track.
        truth: the plant's track; None without true states.
        estimates: the estimates' tracks.
        distances: V of each estimate, as many; none without truth.
        contacts: impacts and persistent contact over time.
        zero: time zero; the epoch, if the model depends on time.
        start: stamp of the first picture, ns.
        end: stamp of the last picture, ns.
    """

    scene: Scene
    truth: Track | None
    estimates: tuple[Track, ...]
    distances: tuple[Distance, ...]
    contacts: ContactHistory
    zero: TimeZero
    start: int
    end: int

    @property
    def tracks(self) -> tuple[Track, ...]:
        """The plant's track, unless the film has none, and the estimates' tracks."""
        return self.estimates if self.truth is None else (self.truth, *self.estimates)

    def ground_motion(self, stamp: int) -> Vector:
        """Addition of moving grounds to the gaps at ``stamp`` (ns), m, shape (m,)."""
        system = self.scene.system
        return np.asarray(system.gap_motion(np.array([stamp - self.zero.stamp]))[0])

    def stamps(self, fps: float, speed: float) -> Stamps:
        """Stamps of the pictures, ns, the first at the start.

        Args:
            fps: pictures a second of the film.
            speed: recorded seconds a second of the film.
        """
        steps = np.arange(self.count(fps, speed)) * (NS_PER_S * speed / fps)
        return np.asarray(self.start + np.rint(steps).astype(np.int64))

    def count(self, fps: float, speed: float) -> int:
        """Number of pictures."""
        return int((self.end - self.start) / (NS_PER_S * speed / fps) + 1e-9) + 1

    def seconds(self, stamps: Stamps) -> Vector:
        """``stamps`` as seconds since time zero."""
        return np.asarray((stamps - self.zero.stamp) / NS_PER_S)


def scene_of(system: System, tracks: Sequence[Track]) -> Scene:
    """A scene with room for all ``tracks``."""
    positions = [each.q[:: max(len(each.q) // _MOST_POSITIONS, 1)] for each in tracks]
    return Scene.of_system(system, np.vstack([np.empty((0, system.n)), *positions]))


def _arrays(stamps: Mapping[int, Sequence[int]]) -> dict[int, Stamps]:
    return {contact: np.array(each, dtype=np.int64) for contact, each in stamps.items()}
