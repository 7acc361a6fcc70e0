from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from impact_observer.states import Matrix, Vector

SOURCES: str

State: TypeAlias = tuple[Vector, Vector, Matrix, Matrix]

def triangular(root: Matrix) -> Matrix: ...
def largest_distance(columns: Matrix, metric: Matrix) -> float: ...

class FreeMotion:
    def __init__(
        self,
        lower: Matrix,
        constant: Vector,
        frequency: Vector,
        cosine: Matrix,
        sine: Matrix,
        rate: float,
        decay: float,
    ) -> None: ...
    def rates(self, t: float, x: Vector) -> Vector: ...
    def diffusion(self, s: float) -> Matrix: ...
    def flown(self, t: float, x: Vector, s: float) -> Vector: ...

class Sizes:
    def __init__(
        self, modes: Matrix, spread: Matrix, squares: Vector, timescale: float
    ) -> None: ...

class Impact:
    def __init__(
        self, motion: FreeMotion, sizes: Sizes, w: Vector, kick: Vector, rest: float
    ) -> None: ...
    def fits(self, t: float, states: Sequence[tuple[object, ...]], clocks: Vector) -> Matrix: ...
    def posteriors(
        self, t: float, flown: float, states: Sequence[tuple[object, ...]], clocks: Vector
    ) -> list[State]: ...
    def missed(
        self, t: float, flown: float, states: Sequence[tuple[object, ...]]
    ) -> list[State]: ...

class ModalFlow:
    def __init__(
        self,
        splitting: tuple[Matrix, Matrix, Matrix, Matrix, NDArray[np.bool_]],
        waves: tuple[Vector, NDArray[np.uint64]],
        response: Matrix,
        load: Matrix,
        near: NDArray[np.bool_],
        driven: NDArray[np.bool_],
        energy: Matrix,
        small: float,
        young: float,
    ) -> None: ...
    def start(self, t: float, x: Vector) -> ModalMotion: ...
    def transition(self, s: float) -> Matrix: ...

class ModalMotion:
    t: float
    def state(self, s: float, /) -> Vector: ...
    def states(self, s: Vector, /) -> Matrix: ...
    def each(self, s: Vector, /) -> Matrix: ...

class Guards:
    def __init__(
        self, flow: ModalFlow, seen: Matrix, reach: Matrix, harmonics: Matrix, constant: Vector
    ) -> None: ...
    def trace(self, motion: ModalMotion, shift: Vector) -> Trace: ...

class Trace:
    def known(self, s: float, stop: float) -> tuple[Matrix, Matrix, Vector]: ...

class RootSearch:
    looks: int
    def __init__(self, trace: Trace, window: float, end: float, start: float = 0.0) -> None: ...
    def first(self, horizon: float) -> tuple[float, tuple[int, ...]] | None: ...

def divided(points: NDArray[np.complex128], s: Vector) -> NDArray[np.complex128]: ...

class Gaps:
    def __init__(self, motion: FreeMotion, sizes: Sizes, W: Matrix, rest: Vector) -> None: ...
    def dips(
        self,
        t: float,
        duration: float,
        states: Sequence[tuple[object, ...]],
        levels: Vector,
    ) -> list[list[tuple[int, float, float, float, float, float, bool, float]]]: ...
    def root(
        self,
        t: float,
        state: tuple[object, ...],
        level: float,
        contact: int,
        above: float,
        below: float,
        depth: float = 0.0,
    ) -> float: ...

class Arena:
    def __init__(
        self,
        gaps: Guards,
        M: Matrix,
        W: Matrix,
        q_r: Vector,
        length: Vector,
        times: tuple[float, float, float],
        lowest: float,
    ) -> None: ...
    def learn(self, contact: int, kick: Vector, Z: Vector) -> None: ...
    def start(self, stamp: int, remainder: float, x: Vector) -> Flights: ...
    def fly_all(
        self, stamp: int, remainder: float, x: Matrix, limit: int, most: int
    ) -> list[
        tuple[
            NDArray[np.int64],
            Vector,
            NDArray[np.int64],
            Matrix,
            tuple[float, tuple[int, ...]] | None,
        ]
    ]: ...

class Flights:
    def advance(
        self, limit: int, most: int
    ) -> tuple[
        list[tuple[int, float, int, float, Vector, Vector]],
        tuple[float, tuple[int, ...]] | None,
    ]: ...
