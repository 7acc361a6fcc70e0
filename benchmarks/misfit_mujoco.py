# SPDX-License-Identifier: Apache-2.0
"""A plant in MuJoCo: bodies on slides, stops as limits of tendons (``pip install mujoco``)."""

import importlib
from types import ModuleType

import numpy as np

from benchmarks.harness import SkippedError
from benchmarks.misfit_motion import (
    RATE,
    AccumulationError,
    Array,
    Recording,
    kelvin_voigt,
    stamps,
)
from impact_observer.model import System

_STEPS = 20
"""Steps of MuJoCo in a contact."""
_HARD = 0.9999
"""Impedance of a limit: 1 would leave no compliance but the spring's."""


def modules() -> tuple[ModuleType, ModuleType]:
    """``mujoco`` and ``mujoco.rollout``.

    Raises:
        SkippedError: it is not installed.
    """
    try:
        return importlib.import_module("mujoco"), importlib.import_module("mujoco.rollout")
    except ImportError:
        raise SkippedError("mujoco is not installed: pip install mujoco") from None


def follow(
    system: System, duration: float, x: Array, seconds: float, _: np.random.Generator
) -> Recording:
    """A run from the state ``x``, with contacts of about ``duration``, s.

    A contact ends where its gap opens.

    Raises:
        SkippedError: MuJoCo is not installed.
        AccumulationError: a contact stays closed for three durations.
    """
    mujoco, rollout = modules()
    substeps = round(_STEPS / (RATE * duration))  # in a sample
    step, n = 1 / (RATE * substeps), system.n
    model = mujoco.MjModel.from_xml_string(document(system, duration, step))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = np.split(x, 2)
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    start = np.zeros(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, start, full)
    times = np.linspace(0, seconds, round(seconds / step) + 1)
    forces = system.forcing.derivatives(times[:-1] + step / 2, 0)[0]
    applied = mujoco.mjtState.mjSTATE_QFRC_APPLIED
    states, _sensors = rollout.rollout(
        model, data, initial_state=start, control=forces[None], control_spec=applied
    )
    history = np.vstack([x, states[0, :, 1 : 2 * n + 1]])
    return recording(system, times, history, round(3 * duration / step), substeps)


def document(system: System, duration: float, step: float) -> str:
    """The model in MuJoCo's XML.

    Raises:
        ValueError: the mass matrix is not diagonal.
    """
    if np.count_nonzero(system.M - np.diag(np.diag(system.M))):
        raise ValueError(f"{system.name}: mass matrix is not diagonal")
    bodies = [
        f'<body><joint name="x{i}" type="slide" axis="1 0 0"/>'
        f'<geom type="sphere" size="0.01" mass="{mass!r}" contype="0" conaffinity="0"/></body>'
        for i, mass in enumerate(np.diag(system.M).tolist())
    ]
    tendons = [
        fixed(f'{key}="1"', column)
        for key, matrix in (("stiffness", system.K), ("damping", system.C))
        for column in factor(matrix).T
        if np.any(column)
    ]
    for w, gap, eps in zip(system.W.T, system.q_r.tolist(), system.eps.tolist(), strict=True):
        stiffness, damping = kelvin_voigt(1.0, eps, duration)  # MuJoCo's are by mass
        limit = (
            f'limited="true" range="{-gap!r} 1000" '
            f'solreflimit="{-stiffness!r} {-damping!r}" solimplimit="{_HARD} {_HARD} 0.001"'
        )
        tendons.append(fixed(limit, w))
    return (
        f'<mujoco><option timestep="{step!r}" gravity="0 0 0"/>'
        f"<worldbody>{''.join(bodies)}</worldbody><tendon>{''.join(tendons)}</tendon></mujoco>"
    )


def factor(matrix: Array) -> Array:
    """``F`` with ``matrix = F F^T``."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)))


def fixed(attributes: str, coefficients: Array) -> str:
    """A fixed tendon; its length is the sum of the coordinates with these coefficients."""
    joints = "".join(
        f'<joint joint="x{i}" coef="{value!r}"/>'
        for i, value in enumerate(coefficients.tolist())
        if value
    )
    return f"<fixed {attributes}>{joints}</fixed>"


def recording(
    system: System, times: Array, history: Array, longest: int, substeps: int
) -> Recording:
    """Onsets and ends of contacts between the steps, by linear interpolation of the gaps.

    ``history`` has the states of all steps, shape (steps + 1, 2n); no contact may have more than
    ``longest`` steps.
    """
    onsets: list[Array] = []
    ends: list[Array] = []
    contacts = []
    for i, gaps in enumerate((history[:, : system.n] @ system.W + system.q_r).T):
        first = np.flatnonzero((gaps[:-1] >= 0) & (gaps[1:] < 0))
        last = np.flatnonzero((gaps[:-1] < 0) & (gaps[1:] >= 0))
        last = np.append(last, np.full(first.size - last.size, gaps.size - 2))
        if np.any(last - first > longest):
            raise AccumulationError(system.contact_names[i])
        for found, at in ((onsets, first), (ends, last)):
            share = np.clip(gaps[at] / (gaps[at] - gaps[at + 1]), 0, 1)
            found.append(times[at] + share * (times[1] - times[0]))
        contacts.append(np.full(first.size, i))
    order = np.argsort(np.concatenate(onsets))
    return Recording(
        stamps(np.concatenate(onsets)[order]),
        np.concatenate(contacts)[order],
        stamps(np.concatenate(ends)[order]),
        stamps(times[::substeps]),
        history[::substeps],
    )
