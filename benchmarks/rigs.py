# SPDX-License-Identifier: Apache-2.0
"""Texts of model files: rigs whose size or speed is chosen."""

from itertools import pairwise

DRILL = 40.8
"""Speed-up over the sample two_mass, at its speeds: 32 hits a second."""


def fast(faster: float = DRILL, size: float = 1 / DRILL, restitution: float = 0.7) -> str:
    """``two_mass`` in other units of time and length; by default a drill."""
    s = faster
    return f"""
name: fast
coordinates: [x1, x2]
mass: [[1, 0], [0, 1]]
damping: [[{0.2 * s}, {-0.1 * s}], [{-0.1 * s}, {0.1 * s}]]
stiffness: [[{20 * s**2}, {-10 * s**2}], [{-10 * s**2}, {10 * s**2}]]
forcing:
  harmonics: [{{frequency: {2.5 * s}, cosine: [0, {4 * s**2 * size}], sine: [0, 0]}}]
contacts: [{{name: stop, direction: [0, -1], gap: {0.5 * size}, restitution: {restitution}}}]
initial_state: {{position: [{0.1 * size}, {-0.2 * size}], velocity: [{0.5 * s * size}, 0]}}
"""


def chain(n: int) -> str:
    """``n`` unit masses in a row on a wall, driven at the three that hit stops."""
    names = ["ground", *(f"x{k + 1}" for k in range(n))]
    bodies = ", ".join(f"{{name: {name}, mass: 1}}" for name in names[1:])
    springs = [
        f"{{between: [{a}, {b}], stiffness: {20 * n}, damping: {0.02 * n}}}"
        for a, b in pairwise(names)
    ]
    hit = [names[k] for k in (n // 3, 2 * n // 3, n)]
    forces = [
        f"{{body: {body}, amplitude: 20, frequency: {frequency}, phase: {phase}}}"
        for body, frequency, phase in zip(hit, (5.3, 8.1, 6.7), range(3), strict=True)
    ]
    stops = [
        f"{{name: at_{body}, body: {body}, limit: 0.2, side: above, restitution: 0.6}}"
        for body in hit
    ]
    return f"""
name: chain_{n}
bodies: [{bodies}]
springs: [{", ".join(springs)}]
forces: [{", ".join(forces)}]
stops: [{", ".join(stops)}]
initial_state: {{position: {[0] * n}, velocity: {[0] * n}}}
"""
