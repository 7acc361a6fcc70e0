# SPDX-License-Identifier: Apache-2.0
"""Arms of rods as URDF texts, for the tests of robots."""

import numpy as np

from impact_observer.model import Model, parse_model
from impact_observer.states import Vector


def urdf(links: str, joints: str) -> str:
    """A URDF with a link ``base`` beside ``links``."""
    return f'<robot name="arm"><link name="base"/>{links}{joints}</robot>'


def link(name: str, mass: float, centre: str, inertia: str = "0.1 0.1 0.1") -> str:
    """A link with the moments of ``inertia`` about its ``centre``."""
    ixx, iyy, izz = inertia.split()
    return (
        f'<link name="{name}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>"
    )


def joint(name: str, parent: str, child: str, **parts: str) -> str:
    """A joint; ``parts`` are ``kind``, ``xyz``, ``rpy``, ``axis`` and ``more`` elements."""
    return (
        f'<joint name="{name}" type="{parts.get("kind", "continuous")}">'
        f'<origin xyz="{parts.get("xyz", "0 0 0")}" rpy="{parts.get("rpy", "0 0 0")}"/>'
        f'<parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{parts.get("axis", "0 1 0")}"/>{parts.get("more", "")}</joint>'
    )


PENDULUM = urdf(
    link("rod", 1.0, "0 0 -1", "0 0 0") + '<link name="tip"/>',
    joint("hinge", "base", "rod", axis="0 -1 0")
    + joint("end", "rod", "tip", kind="fixed", xyz="0 0 -1"),
)
"""A point mass of 1 kg at 1 m; at a positive angle the tip is on the side of positive x."""
DOUBLE = urdf(
    link("one", 1.5, "0 0 -0.4", "0 0.05 0")
    + link("two", 0.8, "0 0 -0.3", "0 0.02 0")
    + '<link name="tip"/>',
    joint("shoulder", "base", "one", axis="0 -1 0")
    + joint("elbow", "one", "two", axis="0 -1 0", xyz="0 0 -0.7")
    + joint("end", "two", "tip", kind="fixed", xyz="0 0 -0.5"),
)
"""A double pendulum in the plane y = 0 whose second angle is relative."""
SLIDER = urdf(
    link("cart", 2.0, "0 0 0") + '<link name="tip"/>',
    joint("rail", "base", "cart", kind="prismatic", axis="0 0 1")
    + joint("end", "cart", "tip", kind="fixed"),
)
"""A mass of 2 kg that moves along z."""


def model_of(text: str, joints: str, **keys: object) -> Model:
    """The model of a robot with the URDF ``text``; other keys of the model file as YAML texts."""
    lines = [f"{key}: {value}" for key, value in keys.items()]
    indented = "\n".join(f"  {line}" for line in text.splitlines())
    return parse_model(
        "\n".join(["name: arm", "urdf: |", indented, f"joints: [{joints}]", *lines]), "arm.yaml"
    )


def wall(**keys: object) -> str:
    """The value of ``contacts`` with one plane that the link ``tip`` hits."""
    given = {
        "name": "wall",
        "frame": "tip",
        "normal": "[1, 0, 0]",
        "offset": 0,
        "restitution": 0.5,
        **keys,
    }
    return "[{" + ", ".join(f"{key}: {value}" for key, value in given.items()) + "}]"


def random_arm(seed: int, n: int = 0, *, contacts: int = 1, **keys: object) -> Model:
    """A chain of ``n`` joints, 2 to 4 if 0, of random sizes, axes, rotors and planes.

    Planes are random, so coordinates say nothing of which side of them the arm is on.
    """
    rng = np.random.default_rng(seed)
    n = n or int(rng.integers(2, 5))
    links, joints, parent = [], [], "base"
    for k in range(n):
        kind = "prismatic" if k and rng.random() < 0.2 else ["continuous", "revolute"][k % 2]
        centre = " ".join(map(str, rng.normal(size=3) * 0.1))
        size = rng.uniform(0.01, 0.03)
        links.append(link(f"link{k}", rng.uniform(0.3, 2.0), centre, f"{size} {size} {size}"))
        joints.append(
            joint(
                f"joint{k}",
                parent,
                f"link{k}",
                kind=kind,
                xyz=" ".join(map(str, rng.normal(size=3) * 0.3)),
                rpy=" ".join(map(str, rng.normal(size=3))),
                axis=" ".join(map(str, _unit(rng))),
                more='<limit lower="-9" upper="9" velocity="10" effort="50"/>',
            )
        )
        parent = f"link{k}"
    links.append('<link name="tip"/>')
    joints.append(joint("end", parent, "tip", kind="fixed", xyz="0.2 -0.1 0.3"))
    frames = ["tip", parent]
    planes = ", ".join(
        f"{{name: plane{i}, frame: {frames[i % 2]}, normal: {_unit(rng).tolist()}, offset: -0.3,"
        f" restitution: {float(rng.uniform(0.2, 0.8))}}}"
        for i in range(contacts)
    )
    names = ", ".join(f"joint{k}" for k in range(n))
    rotors = {f"joint{k}": float(rng.uniform(0.01, 0.1)) for k in range(n)}
    damping = {f"joint{k}": float(rng.uniform(0.0, 0.3)) for k in range(n)}
    return model_of(
        urdf("".join(links), "".join(joints)),
        names,
        **{"contacts": f"[{planes}]", "rotor_inertia": rotors, "damping": damping, **keys},
    )


def _unit(rng: np.random.Generator) -> Vector:
    axis = rng.normal(size=3)
    return np.asarray(axis / np.linalg.norm(axis))
