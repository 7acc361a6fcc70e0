# SPDX-License-Identifier: Apache-2.0
"""Contacts that come to rest: their gaps and speeds are measured to be zero."""

from typing import NamedTuple

import numpy as np

from impact_observer.events import Contacts
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.members import Members
from impact_observer.filter.saltation import RestProjection
from impact_observer.filter.square_root import correction
from impact_observer.states import Matrix, Vector


class RestMeasurement(NamedTuple):
    """Gaps and speeds of contacts that come to rest, measured to be zero.

    Attributes:
        H: their derivatives by (q, u, constants), shape (k, 2n + c).
        value: of the state, shape (k,).
        floor: standard deviation of the rounding of each.
    """

    H: Matrix
    value: Vector
    floor: list[float]


def rested(
    members: Members, state: GaussianState, new: Contacts, leftover: Vector
) -> GaussianState:
    """``state`` corrected by ``g = 0`` and ``gamma = 0`` on its closed contacts.

    Only contacts that are ``new``, closed just now, are measured; a plant may neglect their
    ``leftover`` speeds, shape (len(new),), m/s.
    """
    if not state.closed:
        return state
    size, p = state.x.size, state.parameters
    H, value, floor = rest_measurement(members, state, new, leftover)
    nothing, considered = np.empty((len(H), 0)), members.considered_rows(size)
    update = correction(state.root, H, nothing, floor, considered)
    z = np.concatenate([state.x, state.constants]) - update.change(value)
    if p and np.isfinite(z).all() and np.isfinite(update.root).all():
        z = members.parameters.bounded(z, update.root, size)
    corrected = state._replace(
        x=z[:size],
        constants=z[size:],
        root=update.root,
        differences=state.differences - update.change(H.dot(state.differences)),
    )
    return corrected.propagated(*rest_projection(members, corrected))


def rest_measurement(
    members: Members, state: GaussianState, new: Contacts, leftover: Vector
) -> RestMeasurement:
    """What is measured where contacts are ``new`` at rest; see ``rested``."""
    member, size, p = members.at(state.theta), state.x.size, state.parameters
    # A contact that comes to rest may have bounced unreported before, so its speed is no
    # measurement where its restitution is estimated.
    certain = ~members.estimates_restitution(new)
    slow = tuple(i for i, each in zip(new, certain.tolist(), strict=True) if each)
    gaps, speeds = member.gaps(new, state.x), member.speeds(slow, state.x)
    c = np.vstack([gaps.c, speeds.c])
    value = np.concatenate([gaps.value(state.x), speeds.value(state.x)])
    sizes = members.given.moving.scales.sizes(state.x)
    floor = [*gaps.rounding(sizes), *np.hypot(speeds.rounding(sizes), leftover[certain])]
    H = np.hstack([c, np.zeros((len(c), len(state.root) - size))])
    H[: len(new), size : size + p] = members.gap_sensitivity(new)
    return RestMeasurement(H, value, floor)


def rest_projection(members: Members, state: GaussianState) -> RestProjection:
    """``state``, nearly at rest on its closed contacts, projected; see ``Member.stopped``."""
    sensitivity = members.gap_sensitivity(state.closed)
    return members.at(state.theta).stopped(state.x, state.closed, sensitivity)
