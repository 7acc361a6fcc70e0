# SPDX-License-Identifier: Apache-2.0
"""Makes an observer of a system from options as users write them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.model import Model, System
from impact_observer.model.contact_sensors import ContactErrors
from impact_observer.model.live_signals import connected
from impact_observer.model.measurement import Measurement
from impact_observer.model.model_file import ModelSource, model_of
from impact_observer.model.robot_description import RobotDescription
from impact_observer.observer.encoder_start import EncoderStart
from impact_observer.observer.laws import Law, law_named
from impact_observer.observer.observer import Observer
from impact_observer.observer.uncertainty import Uncertainty, deviation_of
from impact_observer.observer.unknown_parameters import UnknownParameters
from impact_observer.options import Options
from impact_observer.robots.robot import Robot, connected_robot, observed
from impact_observer.robots.robot_family import RobotFamily
from impact_observer.states import Vector

_UNDECLARED_ERROR = 1e-5
"""Least deviation that is published, over the motion, where a model file declares no number
exact: a relative 1e-6 of stiffness, mass, damping, amplitude, gaps and restitutions makes
errors of up to ten times that. See docs/theory/filter.md.
"""


def make_observer(
    model: ModelSource,
    options: Options | None = None,
    *,
    law: type[Law] | None = None,
    measurements: Sequence[Measurement] = (),
    unknowns: UnknownParameters | None = None,
) -> Observer:
    """An observer of a ``model``, or of that in a file, that has received no event yet.

    Of a model with elements their parameters can be estimated one by one, and parameters with
    deviations are considered. Where its file declares no number exact, published deviations
    contain small errors of all numbers; a ``System`` is exact. Of a model that was fitted they
    contain what the fit left.

    Args:
        model: the model, its system, or the path of its file.
        options: None for the defaults.
        law: takes the place of that of the ``options``.
        measurements: what is measured beside the impacts.
        unknowns: take the place of those that options and model name.

    Raises:
        UsageError: there is no model, or an option cannot be used; the line names the option.
        ModelError: the model file is wrong.
    """
    options = options or Options()
    if not isinstance(options, Options):
        raise UsageError(f"make_observer: {options!r} found; expected Options(), by default None")
    is_exact = isinstance(model, System)
    model = model_of(model, "make_observer")
    law = law or law_named(options.law)
    system: System | Robot
    if model.robot is not None:
        _check_robot_options(model.robot, law, options, measurements)
        system, live = connected_robot(observed(model))
        unknowns = _considered_parameters(system, model) if law.has_covariance else None
        undeclared = 0.0
    else:
        system, live = connected(model.system)
        unknowns = unknowns or _unknown_parameters(system, options, model)
        undeclared = 0.0 if is_exact or model.has_exact_numbers else _UNDECLARED_ERROR
    contacts = None
    if model.sensors and law.has_covariance:
        contacts = ContactErrors.of(model.sensors, system.contact_names, options.missed)
    encoders = None
    if system.has_encoders and options.initial_state == Options.initial_state:
        encoders = EncoderStart(cast(Robot, system), measurements)
    declared = declared_by(options, system, encoders)
    declared = replace(
        declared, unknowns=unknowns, undeclared=undeclared, contacts=contacts, shift=model.shift
    )
    return Observer(
        system,
        law(cast(System, system), declared),
        *initial_state(options.initial_state, system),
        epoch=options.epoch,
        history=options.history,
        ensemble=options.ensemble,
        live=live,
        measurements=measurements,
        encoders=encoders,
    )


def _check_robot_options(
    robot: RobotDescription,
    law: type[Law],
    options: Options,
    measurements: Sequence[Measurement],
) -> None:
    """Raise UsageError if a ``robot`` cannot be observed so."""
    name = robot.name
    law.check_kind(Robot, name)
    if options.estimate_parameters:
        raise UsageError(
            f"estimate_parameters: {options.estimate_parameters[0]} found; expected none, as"
            f" parameters of the robot {name} are considered by their deviations in the model"
        )
    if options.model_error > 0:
        raise UsageError(
            f"model_error: {options.model_error:g} found; expected torque_deviation in the model"
            f" of the robot {name} instead"
        )
    if not any(each.position or each.gap for each in measurements):
        raise UsageError(
            f"measurements: none of positions of the robot {name}, whose motion does not follow"
            " from impact times alone; expected its encoders, --measurements FILE"
        )
    encoded = {each.encoded[0] for each in measurements if each.encoded}
    for joint in robot.joints:
        if joint not in encoded and not law.has_covariance:
            raise UsageError(
                f"law {law.name}: no encoder of the joint {joint!r} found; expected one of every"
                " joint in measurements"
            )


def _considered_parameters(robot: Robot, model: Model) -> UnknownParameters | None:
    """The parameters of a ``robot`` with deviations in its ``model``; None without one."""
    if (known := model.uncertainty) is None:
        return None
    deviations = known.deviation_by_name
    family = RobotFamily.named(robot, [name for name, each in deviations.items() if each])
    if not family.size:
        return None
    scale = np.array([deviations[name] for name in family.names])
    covariance = known.correlation(family.names) * np.outer(scale, scale)
    return UnknownParameters(family, covariance, (True,) * family.size)


def declared_by(
    options: Options, system: System | Robot, encoders: EncoderStart | None = None
) -> Uncertainty:
    """The uncertainty that ``options`` declare.

    That of the initial state is that of the ``encoders``, where a robot starts at them. A robot
    has white torques instead of white accelerations.

    Raises:
        UsageError: the deviations do not suit the ``system``.
    """
    if encoders is None:
        deviation = deviation_of(options.initial_deviation, system)
    else:
        deviation = encoders.deviation(options)
    error = None if options.model_error < 0 else options.model_error
    return Uncertainty(
        deviation=deviation,
        clock_error=None if options.clock_error < 0 else options.clock_error,
        clock_offset_error=options.clock_offset_error,
        model_error=0.0 if system.has_encoders else error,
        missed=options.missed,
        spurious=options.spurious,
        mislabelled=options.mislabelled,
        dead_time=options.dead_time,
    )


def _unknown_parameters(
    system: System, options: Options, model: Model
) -> UnknownParameters | None:
    """The parameters that ``options`` name, or that the ``model`` declares to be uncertain."""
    wanted = options.estimate_parameters
    unknowns = UnknownParameters.named(system, wanted, model.elements, model.uncertainty)
    if law_named(options.law).learns:
        return unknowns if unknowns.family.size else None
    if wanted:
        raise UsageError(
            f"estimate_parameters: the law {options.law} estimates none; expected"
            " minimum-variance, or leave them out"
        )
    return None


def initial_state(text: str, system: System | Robot) -> tuple[Vector, Vector]:
    """Read ``q1,..,qn,u1,..,un``, ``random:SEED`` or ``zero``.

    ``random:SEED`` is ``numpy.random.default_rng(SEED).normal(size=2n)``, q then u, in SI units
    whatever the size of the rig.

    Returns:
        Position and velocity, shape (n,) each.

    Raises:
        UsageError: the text is no state; the line has the value found and the value expected.
    """
    n = system.n
    kind, _, seed = text.strip().partition(":")
    if kind == "zero" and not seed:
        x = np.zeros(2 * n)
    elif kind == "random":
        if not (seed.isascii() and seed.isdigit()):
            raise UsageError(f"initial state {text!r}: expected random:SEED, SEED a whole number")
        x = np.random.default_rng(int(seed)).normal(size=2 * n)
    else:
        order = "q1,..,qn,u1,..,un"
        try:
            x = np.array([float(part) for part in text.split(",")])
        except ValueError:
            raise UsageError(
                f"initial state {text!r}: expected zero, random:SEED or {2 * n} numbers {order}"
            ) from None
        if x.size != 2 * n:
            raise UsageError(
                f"initial state {text!r}: {x.size} numbers, expected {2 * n}: {order}"
            )
    return system.checked_state(x[:n], x[n:])


def options_of_laws(options: Options, laws: Sequence[str]) -> list[Options]:
    """The options for each law; if some law estimates parameters, the others get none.

    Raises:
        UsageError: a law is not installed.
    """
    learns = [law_named(law).learns for law in laws]
    plain = replace(options, estimate_parameters=())
    return [
        replace(options if each or not any(learns) else plain, law=law)
        for law, each in zip(laws, learns, strict=True)
    ]
