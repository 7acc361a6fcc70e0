# SPDX-License-Identifier: Apache-2.0
"""Free motion of a robot against MuJoCo, from the same URDF."""

import numpy as np
import pytest
from arms import random_arm

from impact_observer.plant import Plant, simulate
from impact_observer.robots.robot import Robot
from impact_observer.stamps import NS_PER_S, grid

pytest.importorskip("pinocchio", reason="not installed: extra robots")
mujoco = pytest.importorskip("mujoco", reason="not installed: requirements/mujoco.txt")


def test_seven_joints_move_as_in_mujoco() -> None:
    """One second of a tumbling chain with rotors and damping, to 1e-4."""
    model = random_arm(3, 7, contacts=0)
    assert model.robot is not None
    robot, n = Robot(model.robot), 7
    rng = np.random.default_rng(3)
    q, u = rng.normal(size=(2, n))
    run = simulate(Plant(robot, q, u, epoch=NS_PER_S), grid(NS_PER_S, 2 * NS_PER_S, 10))
    text = model.robot.known_urdf.text
    options = '<mujoco><compiler fusestatic="false" balanceinertia="false"/></mujoco></robot>'
    other = mujoco.MjModel.from_xml_string(text.replace("</robot>", options))
    place = [other.joint(name).dofadr[0] for name in robot.coordinates]
    other.dof_armature[place] = model.robot.rotor_inertia
    other.dof_damping[place] = robot.damping
    other.opt.gravity[:] = model.robot.gravity
    other.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    other.opt.timestep = 5e-4
    other.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    other.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(other)
    data.qpos[place], data.qvel[place] = q, u
    for state in run.states[1:]:
        mujoco.mj_step(other, data, nstep=200)
        assert np.max(np.abs(data.qpos[place] - state[:n])) < 1e-4
        assert np.max(np.abs(data.qvel[place] - state[n:])) < 1e-4 * np.max(np.abs(state[n:]))
