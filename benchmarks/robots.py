# SPDX-License-Identifier: Apache-2.0
"""Processor time of what a filter asks of a robot, in microseconds, for 2 and 7 joints.

The least of several batches counts, in this process; pinocchio's own share is a tenth to a half.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from impact_observer.model import parse_model
from impact_observer.robots import Robot, VelocityObserver

CALLS, BATCHES = 40, 15
STEP = 1e-3
"""Length of a step of Runge and Kutta, s."""


def chain_text(n: int) -> str:
    """Name, URDF and joints of rods of 1 kg and 0.3 m in a row, which turn about y and x."""
    links, joints = '<link name="base"/>', ""
    for k in range(n):
        parent, axis = f"link{k - 1}" if k else "base", "0 1 0" if k % 2 == 0 else "1 0 0"
        links += (
            f'<link name="link{k}"><inertial><origin xyz="0 0 -0.15"/><mass value="1"/><inertia'
            ' ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        )
        joints += (
            f'<joint name="joint{k}" type="continuous"><origin xyz="0 0 {-0.3 if k else 0}"/>'
            f'<parent link="{parent}"/><child link="link{k}"/><axis xyz="{axis}"/></joint>'
        )
    names = ", ".join(f"joint{k}" for k in range(n))
    text = f"<robot name='chain'>{links}{joints}</robot>"
    return f"name: chain_{n}\nurdf: |\n  {text}\njoints: [{names}]\n"


def chain(n: int) -> Robot:
    """The rods above a plane below the last."""
    plane = f"{{name: floor, frame: link{n - 1}, normal: [0, 0, 1], offset: -9, restitution: 0.5}}"
    return Robot(parse_model(f"{chain_text(n)}contacts: [{plane}]\n", "chain"))


def microseconds(job: Callable[[], object]) -> float:
    """Processor time of one call."""
    job()
    best = np.inf
    for _ in range(BATCHES):
        begin = time.process_time()
        for _ in range(CALLS):
            job()
        best = min(best, (time.process_time() - begin) / CALLS)
    return float(best) * 1e6


def costs(n: int) -> dict[str, float]:
    """Microseconds of each question to a robot of ``n`` joints."""
    robot, rng = chain(n), np.random.default_rng(n)
    q, u, tau = rng.normal(size=(3, n)) * 0.3
    u = -u if (robot.directions(q).T @ u)[0] > 0 else u
    x, observer = np.concatenate([q, u]), VelocityObserver(robot, u)
    jobs: dict[str, Callable[[], object]] = {
        "acceleration": lambda: robot.acceleration(q, u, tau),
        "acceleration, one contact closed": lambda: robot.acceleration(q, u, tau, (0,)),
        "derivatives of the flow": lambda: robot.rate_derivatives(x, tau),
        "step": lambda: robot.advanced(x, tau, STEP),
        "step with derivatives": lambda: robot.advanced_with_derivatives(x, tau, STEP),
        "gap and its two derivatives in time": lambda: robot.gap_rates(x, tau, (0,)),
        "impact": lambda: robot.velocity_after(q, u, (0,)),
        "saltation": lambda: robot.saltation(x, tau, 0),
        "step of the certified observer": lambda: observer.step(np.array([q, q, q]), STEP, tau),
    }
    return {name: microseconds(job) for name, job in jobs.items()}


def main(args: Sequence[str] | None = None) -> int:
    """Print a table."""
    argparse.ArgumentParser(prog="./dev bench robots", description=__doc__).parse_args(args)
    table = Table("us", "2 joints", "7 joints")
    few, many = costs(2), costs(7)
    for name, value in few.items():
        table.add_row(name, f"{value:.1f}", f"{many[name]:.1f}")
    Console(width=100).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
