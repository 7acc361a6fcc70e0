# SPDX-License-Identifier: Apache-2.0
"""The sample hammer_arm in MuJoCo: a plant whose contacts and joints are not those of the model.

A contact is a spring and a damper on the axis of the hit, so that a hit lasts some milliseconds.
The tip may rub on the wall. Joints may be springs between the motors and the links; the encoders
are on the motors.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP = 4e-5
"""Time step, s."""
RESTITUTION = 0.4
DEBOUNCE = 0.02
"""Onsets of contact that soon after the one before are not reported, s."""
_WALL, _RADIUS = -0.38, 0.03
_SPRINGS = {"shoulder": (0.1, 1600.0, 0.8), "elbow": (0.02, 320.0, 0.4)}
"""Rotor inertia, kg m^2, stiffness, N m/rad, and damping, N m s/rad, of a flexible joint.

A rotor on its spring alone oscillates at 20 Hz.
"""


@dataclass(frozen=True, slots=True)
class Contact:
    """How the hammer hits.

    Attributes:
        seconds: that a hit lasts.
        friction: coefficient of the tip.
        flexible: whether springs are between motors and links.
    """

    seconds: float = 1e-3
    friction: float = 0.0
    flexible: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A motion of the hammer.

    Attributes:
        states: positions and velocities at the encoders, shape (samples, 4), rad and rad/s.
        hits: onsets of contact, s.
    """

    states: Array
    hits: list[float]


def _joint(name: str, *, flexible: bool) -> tuple[str, str, str]:
    """A joint, a rotor beside it, and the spring between them, as elements of a model."""
    axis, (rotor, stiffness, damping) = 'type="hinge" axis="0 -1 0"', _SPRINGS[name]
    if not flexible:
        return f'<joint name="{name}" {axis} damping="0.35" armature="{rotor}"/>', "", ""
    motor = (
        f'<joint name="{name}" {axis} damping="0.35"/><inertial pos="0 0 0" mass="1e-6"'
        f' diaginertia="{rotor} {rotor} {rotor}"/>'
    )
    spring = (
        f'<fixed stiffness="{stiffness}" damping="{damping}"><joint joint="{name}" coef="1"/>'
        f'<joint joint="{name}_link" coef="-1"/></fixed>'
    )
    return f'<joint name="{name}_link" {axis}/>', motor, spring


def _text(contact: Contact) -> str:
    """The model as MuJoCo reads it."""
    zeta = -math.log(RESTITUTION) / math.hypot(math.pi, math.log(RESTITUTION))
    natural = math.pi / contact.seconds / math.sqrt(1.0 - zeta * zeta)
    soft = f'solref="{-(natural**2):.9g} {-2 * zeta * natural:.9g}" solimp="0.999 0.999 1"'
    rough = f'condim="{3 if contact.friction else 1}" friction="{contact.friction} 0 0"'
    shoulder, motor, spring = _joint("shoulder", flexible=contact.flexible)
    elbow, second_motor, second_spring = _joint("elbow", flexible=contact.flexible)
    motors = (
        (f"<body>{motor}</body>", f'<body pos="0 0 -0.4">{second_motor}</body>')
        if contact.flexible
        else ("", "")
    )
    return f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{STEP}" integrator="implicit" cone="elliptic"/>
  <worldbody>
    <geom type="plane" pos="{_WALL} 0 0" zaxis="1 0 0" size="1 1 1" {soft} {rough}/>
    {motors[0]}
    <body>
      {shoulder}
      <inertial pos="0 0 -0.2" mass="1.2" diaginertia="0.0162 0.0162 0.0004"/>
      {motors[1]}
      <body pos="0 0 -0.4">
        {elbow}
        <inertial pos="0 0 -0.22" mass="0.8" diaginertia="0.0072 0.0072 0.0002"/>
        <geom type="sphere" pos="0 0 -0.3" size="{_RADIUS}" {soft} {rough}/>
      </body>
    </body>
  </worldbody>
  <tendon>{spring}{second_spring}</tendon>
</mujoco>"""


def moved(
    contact: Contact, q: Array, torques: Callable[[float], Array], rate: float, seconds: float
) -> Motion:
    """The motion from rest at ``q``, shape (2,), rad, under ``torques`` by time, N m.

    States are sampled at ``rate``, 1/s, the first at zero.
    """
    import mujoco  # type: ignore[import-untyped,unused-ignore]  # noqa: PLC0415 (an extra)

    model: Any = mujoco.MjModel.from_xml_string(_text(contact))
    data: Any = mujoco.MjData(model)
    names = ("shoulder", "elbow")
    for name, value in zip(names, q.tolist(), strict=True):
        for joint in (name, f"{name}_link") if contact.flexible else (name,):
            data.joint(joint).qpos[0] = value
    place = np.array([model.joint(name).dofadr[0] for name in names])
    steps, latest = round(1.0 / rate / STEP), -math.inf
    states, hits = [np.concatenate([data.qpos[place], data.qvel[place]])], list[float]()
    for k in range(round(seconds * rate) * steps):
        data.qfrc_applied[place] = torques(data.time)
        mujoco.mj_step(model, data)
        if data.ncon:
            if data.time - latest > DEBOUNCE:
                hits.append(data.time)
            latest = data.time
        if (k + 1) % steps == 0:
            states.append(np.concatenate([data.qpos[place], data.qvel[place]]))
    return Motion(np.array(states), hits)
