# SPDX-License-Identifier: Apache-2.0
"""The sample ``two_mass`` as elements; ``RESTITUTION`` stands for a number, which is 0.7."""

MODEL = """\
name: rig
bodies: [{name: x1, mass: 1}, {name: x2, mass: 1}]
springs:
  - {between: [ground, x1], stiffness: 10, damping: 0.1}
  - {between: [x1, x2], stiffness: 10, damping: 0.1}
forces: [{body: x2, amplitude: 4, frequency: 2.5}]
stops: [{name: stop, body: x2, limit: 0.5, side: above, restitution: RESTITUTION}]
"""
