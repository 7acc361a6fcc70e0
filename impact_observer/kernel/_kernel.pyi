from collections.abc import Callable, Sequence
from typing import TypeAlias

from impact_observer.states import Matrix, Vector

SOURCES: str

# Numbers of the arithmetic that kernel and Python share; the headers say what they are.
TINY: float
SETTLED: float
CLOSING: float
BACK: float
MOST_STEPS: float
SLOWEST: float
TIME_SHARE: float
ROUNDS: int
FINE: float
FINER: int
MOST_SAMPLES: int

StateArrays: TypeAlias = tuple[Vector, Vector, Matrix, Matrix]
NegativeInterval: TypeAlias = tuple[int, float, float, float, float, float, bool, float]
CorrectedState: TypeAlias = tuple[Vector, Vector, Matrix, Matrix, float, float, float]

def log_mean_positive(mean: float, deviation: float) -> float: ...
def leading(root: Matrix, first: int, count: int) -> Matrix: ...
def dips_along(
    s: Vector,
    values: Matrix,
    value: Callable[[int, float], float],
    rounding: Callable[[int, float], float],
    deviation: Callable[[int, float], float],
) -> list[NegativeInterval]: ...
def falls_at(function: Callable[[float], float], above: float, below: float) -> float: ...
def measured(
    x: Vector,
    constants: Vector,
    root: Matrix,
    differences: Matrix,
    row: Vector,
    rest: float,
    value: float,
    noise: float,
    gate: float,
    parameters: Parameters,
) -> CorrectedState: ...
def sizes_by(metric: Matrix, x: Vector, columns: Matrix) -> tuple[float, float]: ...

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
    def moved(self, t: float, x: Vector, s: float) -> tuple[Vector, Matrix]: ...

class Sizes:
    def __init__(
        self, modes: Matrix, spread: Matrix, squares: Vector, timescale: float
    ) -> None: ...

class Parameters:
    def __init__(
        self, low: Vector, high: Vector, size: Vector, moving: int, considered: Sequence[bool]
    ) -> None: ...
    def steps(self, theta: Vector, root: Matrix, differences: Matrix) -> Vector: ...
    def bounded(self, z: Vector, root: Matrix, first: int) -> Vector: ...

class MotionChange:
    def __init__(
        self,
        lower: Matrix,
        constant: Vector,
        frequency: Vector,
        cosine: Matrix,
        sine: Matrix,
        rate: float,
    ) -> None: ...

class Family:
    def __init__(
        self,
        motion: FreeMotion,
        sizes: Sizes,
        parameters: Parameters,
        nominal: Vector,
        changes: Sequence[MotionChange],
    ) -> None: ...
    def rates(self, t: float, x: Vector, theta: Vector) -> Vector: ...

class Sensitivity:
    first: Matrix
    def __init__(
        self, at: Callable[[Vector], tuple[Vector, Matrix]], theta: Vector, steps: Vector
    ) -> None: ...
    def noise(self, root: Matrix, own: Matrix) -> Matrix: ...

class Impact:
    def __init__(
        self,
        family: Family,
        w: Vector,
        kick: Vector,
        rest: float,
        kicks: Matrix,
        rests: Vector,
        lags: Vector,
    ) -> None: ...
    def fits(self, t: float, states: Sequence[tuple[object, ...]], clocks: Vector) -> Matrix: ...
    def posteriors(
        self, t: float, flown: float, states: Sequence[tuple[object, ...]], clocks: Vector
    ) -> list[StateArrays]: ...
    def missed(self, t: Vector, states: Sequence[tuple[object, ...]]) -> list[StateArrays]: ...

class Gaps:
    def __init__(self, family: Family, W: Matrix, rest: Vector, rests: Matrix) -> None: ...
    def dips(
        self,
        t: Vector,
        duration: Vector,
        states: Sequence[tuple[object, ...]],
        levels: Vector,
    ) -> list[list[NegativeInterval]]: ...
    def flown(
        self,
        t: Vector,
        s: Vector,
        states: Sequence[tuple[object, ...]],
        levels: Vector,
        declared: float,
    ) -> list[StateArrays]: ...
    def followed(
        self,
        t: float,
        s: float,
        states: Sequence[tuple[object, ...]],
        levels: Vector,
        declared: float,
        row: Vector,
        rest: float,
        value: float,
        noise: float,
        gate: float,
        searches: bool,
    ) -> list[CorrectedState] | None: ...
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
