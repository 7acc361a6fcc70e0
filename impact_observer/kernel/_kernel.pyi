from collections.abc import Sequence
from typing import TypeAlias

from impact_observer.states import Matrix, Vector

SOURCES: str

State: TypeAlias = tuple[Vector, Vector, Matrix, Matrix]

def triangular(root: Matrix) -> Matrix: ...

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
