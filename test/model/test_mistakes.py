# SPDX-License-Identifier: Apache-2.0
"""Each mistake in a model file is one line that begins with the file and the key."""

import pytest
from mistakes import mistakes

from impact_observer.errors import ModelError
from impact_observer.model import parse_model

ELEMENTS = """\
name: rig
bodies:  [{name: a, mass: 1}, {name: b, mass: 2}]
grounds:
  - {name: table, motion: {harmonics: [{amplitude: 0.1, frequency: 3, phase: 0.4}]}}
  - {name: wall, motion: {sampled: "time,displacement\\n-1,0\\n0.5,0.2\\n2,0.1\\n"}}
springs:
  - {between: [table, a], stiffness: 10, damping: 0.3}
  - {between: [a, b], stiffness: 20}
forces:
  - {body: b, amplitude: 4, frequency: 2.5, phase: 0.1}
  - {body: a, constant: 1}
  - {body: a, shape: square, amplitude: 50, hertz: 19}
  - {body: b, input: motor}
forcing: {sampled: "time,b\\n-1,0\\n2,3\\n", hold: linear}
stops:
  - {name: foot, between: [table, a], gap: 0.5, restitution: {value: 0.6, speed: 1, exponent: 0}}
  - {name: head, body: b, limit: 0.7, side: above, ground: wall, restitution: 0.8}
sensors: {foot: {clock_error: 1.0e-4, missed: 0.02, latency: -0.001}, head: none}
initial_state: {position: [0, 0], velocity: [0.5, 0]}
uncertainty:
  names: [restitution.head, constant-force.a]
  covariance: [[1.0e-4, 2.0e-6], [2.0e-6, 4.0e-6]]
  fitted_to: {first: 1000, last: 6000}
"""
IN_ELEMENTS = """
name: rig | name: rig\\nmass: [[1]] | mass
name: rig | name: rig\\nunit: cm | unit
name: rig | name: rig\\nfriction: [] | friction
name: rig | name: rig\\nunit: deg | unit
name: rig | name: rig\\nx: &a {b: [*a]} |
bodies:  [{name: a, mass: 1}, {name: b, mass: 2}] | bodies: [] | bodies
bodies:  [{name: a, mass: 1}, {name: b, mass: 2}] | bodies: &a [*a] |
mass: 1}, | mass: 0}, | bodies[0].mass
mass: 1}, | mass: }, | bodies[0].mass
mass: 1}, | mass: {value: 1, deviation: -1}}, | bodies[0].mass.deviation
mass: 1}, | mass: {value: 1, deviation: wide}}, | bodies[0].mass.deviation
mass: 1}, | mass: {value: one, deviation: 1}}, | bodies[0].mass
mass: 1}, | mass: {deviation: 0.1}}, | bodies[0].mass.value
mass: 1}, | mass: {value: 1, deviaton: 0.1}}, | bodies[0].mass
name: a, | name: ground, | bodies[0].name
name: wall, | name: table, | grounds[1].name
name: wall, | name: a, | grounds[1].name
name: wall, | name: ground, | grounds[1].name
frequency: 3, | frequency: 0, | grounds[0].motion.harmonics[0].frequency
{harmonics: [{a | {harmonic: [{a | grounds[0].motion.harmonic
{harmonics: [{a | {live: true, harmonics: [{a | grounds[0].motion.live
motion: {sampled | motion: {harmonics: [], sampled | grounds[1].motion.harmonics
\\n-1,0\\n0.5 | \\n1,0\\n0.5 | grounds[1].motion.sampled
time,dis | time,mis | grounds[1].motion.sampled
[table, a], s | [tabel, a], s | springs[0].between[0]
[table, a], s | [a, a], s | springs[0].between
[table, a], s | [a], s | springs[0].between
stiffness: 10 | stiffness: -1 | springs[0].stiffness
damping: 0.3 | damping: {value: 0, deviation: 1} | springs[0].damping
{body: b, amp | {body: table, amp | forces[0].body
amplitude: 4, | amplitude: {value: 0, deviation: 1}, | forces[0].amplitude
amplitude: 4, | amplitude: {value: -4, deviation: 5}, | forces[0].amplitude.deviation
frequency: 2.5 | frequency: 2.5, order: 1 | forces[0].order
frequency: 2.5 | frequency: 2.5, hertz: 3 | forces[0].hertz
frequency: 2.5 | hertz: two | forces[0].hertz
frequency: 2.5, | | forces[0].frequency
constant: 1} | constant: 1, phase: 2} | forces[1].phase
constant: 1} | constant: {value: 1, deviation: 1}} | forces[1].constant
shape: square | shape: saw | forces[2].shape
hertz: 19 | hertz: 0 | forces[2].hertz
amplitude: 50, | | forces[2].amplitude
amplitude: 50, | amplitude: {value: 50, deviation: 1}, | forces[2].amplitude
input: motor | input: motor, amplitude: 1 | forces[3].amplitude
hold: linear | hold: cubic | forcing.hold
hold: linear | hold: linear, constant: [1, 2] | forcing.constant
{sampled: "time,b\\n-1,0\\n2,3\\n", hold | {hold | forcing.sampled
[table, a], g | [table, wall], g | stops[0].direction
between: [table, a], gap: 0.5 | body: b, limit: -2, side: below | stops[1]
gap: 0.5, | limit: 0.5, | stops[0].limit
gap: 0.5, | | stops[0].gap
gap: 0.5, | gap: {value: 0.5, deviation: 60}, | stops[0].gap.deviation
gap: 0.5, | gap: {value: 0.5, deviation: 1.0e+9}, | stops[0].gap.deviation
exponent: 0 | exponent: 0, deviation: 60 | stops[0].restitution.deviation
value: 0.6, | value: 1.2, | stops[0].restitution.value
speed: 1, | speed: 0, | stops[0].restitution.speed
speed: 1, | velocity: 1, | stops[0].restitution.velocity
exponent: 0 | exponent: 0.1 | stops[0].restitution.exponent
exponent: 0 | exponent: -1 | stops[0].restitution.exponent
exponent: 0 | exponent: 0, limit: 1 | stops[0].restitution.limit
, exponent: 0 | | stops[0].restitution.exponent
value: 0.6, speed: 1, exponent: 0 | speeds: [1, 3] | stops[0].restitution.speeds
{value: 0.6, speed: 1, exponent: 0} | [0.5] | stops[0].restitution
side: above | side: left | stops[1].side
ground: wall | ground: walls | stops[1].ground
restitution: 0.8 | restitution: 7 | stops[1].restitution
restitution: 0.8 | restitution: {value: 0.8, deviation: 0.1} | stops[1].restitution
restitution: 0.8 | restitution: 0.8, contact_time: 0.01 | stops[1].contact_time
restitution: 0.8 | restitution: 0.8, velocity_offset: 0.2 | stops[1].velocity_offset
foot: {clock | bell: {clock | sensors.bell
missed: 0.02 | jitter: 1 | sensors.foot.jitter
missed: 0.02 | missed: 1.1 | sensors.foot.missed
clock_error: 1.0e-4 | clock_error: -1 | sensors.foot.clock_error
latency: -0.001 | latency: 11 | sensors.foot.latency
latency: -0.001 | latency: fast | sensors.foot.latency
latency: -0.001 | latency: null | sensors.foot.latency
head: none | head: no | sensors.head
position: [0, 0] | position: [-0.41, 0] | initial_state.position
position: [0, 0] | position: [0] | initial_state.position
position: [0, 0] | position: [{value: 0, deviation: 1}, 0] | initial_state.position[0]
restitution.head, | restitution.door, | uncertainty.names[0]
restitution.head, | restitution, | uncertainty.names[0]
restitution.head, | clock-offset, | uncertainty.names[0]
restitution.head, | constant-force.a, | uncertainty.names[1]
restitution.head, | mass.a, | uncertainty.names[0]
[restitution.head, constant-force.a] | [] | uncertainty.names
[1.0e-4, 2.0e-6] | [1.0e-4, 3.0e-6] | uncertainty.covariance
[1.0e-4, 2.0e-6] | [-1.0e-4, 2.0e-6] | uncertainty.covariance[0][0]
[1.0e-4, 2.0e-6] | [0, 2.0e-6] | uncertainty.covariance
[1.0e-4, 2.0e-6], | | uncertainty.covariance
[[1.0e-4, 2.0e-6], [2.0e-6, | [[1.0e-4, 3.0e-5], [3.0e-5, | uncertainty.covariance
[[1.0e-4, 2.0e-6], [2.0e-6, 4.0e-6]] | abc | uncertainty.covariance
1.0e-4, 2.0e-6] | 4.0, 2.0e-6] | uncertainty.covariance[0][0]
first: 1000 | first: 1.5 | uncertainty.fitted_to.first
first: 1000 | first: 7000 | uncertainty.fitted_to
last: 6000 | last: 99999999999999999999999 | uncertainty.fitted_to
fitted_to | fitted | uncertainty.fitted
"""
MATRICES = """\
name: rig
coordinates: [x1, x2]
mass:      [[1, 0], [0, 1]]
damping:   [[0.2, -0.1], [-0.1, 0.1]]
stiffness: [[20, -10], [-10, 10]]
grounds: [{name: table, motion: {harmonics: [{amplitude: 0.1, frequency: 3}]}}]
forcing:
  constant: [0, 0]
  harmonics: [{frequency: 2.5, cosine: [0, 4], sine: [0, 0]}]
  squares: [{hertz: 19, amplitude: [50, 0]}]
  grounds: [{name: table, stiffness: [10, 1], damping: [0.3, 0]}]
  sampled: {time: [0, 1], force: [[1, 2], [3, 4]]}
  hold: linear
contacts:
  - {name: stop, direction: [0, -1], gap: 0.5, restitution: 0.7, motion: [{ground: table,
     factor: 1}]}
initial_state: {position: [0.1, -0.2], velocity: [0.5, 0]}
uncertainty: {names: [gap.stop], covariance: [[1.0e-4]]}
"""
IN_MATRICES = """
name: rig | name: 2 | name
name: rig | name: rig\\nmas: 3 | mas
name: rig | name: rig\\n1: 3 | 1
name: rig | name: rig\\nname: b |
name: rig | name: rig\\nsprings: [] | springs
name: rig | name:\\n\\t- x |
name: rig | name: !!python/object:os.system x |
name: rig | --- |
[x1, x2] | [x1, x1] | coordinates[1]
mass:      [[1, 0], [0, 1]]\\n | | mass
[[1, 0], [0, 1]] | [[1, 2], [0, 1]] | mass
[[1, 0], [0, 1]] | [[0.49, 0.21], [0.21, 0.09]] | mass
[[1, 0], [0, 1]] | [[1, 0]] | mass
[[1, 0], [0, 1]] | [[1, 0], [1]] | mass
[[1, 0], [0, 1]] | [[1, 0], [0, one]] | mass[1][1]
[[1, 0], [0, 1]] | m.npy | mass
[[1, 0], [0, 1]] | [[{value: 1, deviation: 1}, 0], [0, 1]] | mass[0][0]
[[20, -10], [-10, 10]] | [[20, -20], [-20, 10]] | stiffness
[[0.2, -0.1], [-0.1, 0.1]] | [[0.2, 0], [0, -0.1]] | damping
frequency: 2.5 | frequency: 0 | forcing.harmonics[0].frequency
frequency: 2.5 | order: 1 | forcing.harmonics[0].order
[0, 4] | [4] | forcing.harmonics[0].cosine
[0, 4] | [0, {value: 4, deviation: 1}] | forcing.harmonics[0].cosine[1]
hertz: 19 | frequency: -1 | forcing.squares[0].frequency
[50, 0] | [50] | forcing.squares[0].amplitude
name: table, s | name: tale, s | forcing.grounds[0].name
[10, 1] | [10] | forcing.grounds[0].stiffness
hold: linear | | forcing.hold
{time: [0, 1], force: [[1, 2], [3, 4]]} | none.csv | forcing.sampled
{time: [0, 1], force: [[1, 2], [3, 4]]} | 3 | forcing.sampled
sampled: {time: [0, 1], force: [[1, 2], [3, 4]]} | | forcing.sampled
[[1, 2], [3, 4]] | [[1, 2]] | forcing.sampled.force
[[1, 2], [3, 4]] | [[1, 2], [1]] | forcing.sampled.force
[0, 1], force | [0, x], force | forcing.sampled.time[1]
[0, 1], force | 7, force | forcing.sampled.time
restitution: 0.7 | restitution: 1.1 | contacts[0].restitution
gap: 0.5 | gap: -.inf | contacts[0].gap
gap: 0.5 | gap: true | contacts[0].gap
gap: 0.5 | gap: 1e16 | contacts[0].gap
gap: 0.5 | gpa: 0.5 | contacts[0].gpa
gap: 0.5 | gap: {value: 0.5, deviation: 0.1} | contacts[0].gap
[0, -1] | [0, 0] | contacts[0].direction
[0, -1] | [0, {value: -1, deviation: 0.1}] | contacts[0].direction[1]
{ground: table | {ground: tale | contacts[0].motion[0].ground
[0.1, -0.2] | [0.1, 0.7] | initial_state.position
[gap.stop] | [stiffness-scale] | uncertainty.names[0]
"""


NOT_A_MODEL = ["", "- 1", MATRICES + "---\n" + MATRICES, "a: " + "[" * 500 + "]" * 500]


@pytest.mark.parametrize("text", NOT_A_MODEL)
def test_a_text_that_is_no_model_is_one_line(text: str) -> None:
    """Also two documents, and lists in lists without an end."""
    with pytest.raises(ModelError, match=r"^rig\.yaml: .*\Z"):
        parse_model(text, "rig.yaml")


@pytest.mark.parametrize(("text", "table"), [(ELEMENTS, IN_ELEMENTS), (MATRICES, IN_MATRICES)])
def test_a_mistake_is_one_line_that_names_the_file_and_the_key(text: str, table: str) -> None:
    """Of the text without the mistake a model is made."""
    assert parse_model(text, "rig.yaml").system.n == 2
    for wrong, key in mistakes(text, table):
        with pytest.raises(ModelError) as caught:
            parse_model(wrong, "rig.yaml")
        line = str(caught.value)
        assert line.startswith(f"rig.yaml: {key}: " if key else "rig.yaml: ")
        assert "\n" not in line
