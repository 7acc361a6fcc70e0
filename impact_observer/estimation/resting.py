"""Contacts that come to rest: their gaps and speeds are measured to be zero."""

import numpy as np
from scipy import linalg

from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.members import Members
from impact_observer.estimation.saltation import Measured
from impact_observer.estimation.square_root import correction
from impact_observer.events import Contacts
from impact_observer.states import Vector


def rested(
    members: Members, state: GaussianState, new: Contacts, leftover: Vector
) -> GaussianState:
    """``state`` corrected by ``g = 0`` and ``gamma = 0`` on its closed contacts.

    Only contacts that are ``new``, closed just now, are measured; a plant may neglect their
    ``leftover`` speeds, shape (len(new),), m/s.
    """
    if not state.closed:
        return state
    member, size, p = members.at(state.theta), state.x.size, state.parameters
    # A contact that comes to rest may have bounced unreported before, so its speed is no
    # measurement where its restitution is estimated.
    certain = ~members.estimates_restitution(new)
    slow = tuple(i for i, each in zip(new, certain.tolist(), strict=True) if each)
    gaps, speeds = member.gaps(new), Measured.speeds(member.system, slow)
    c = np.vstack([gaps.c, speeds.c])
    value = np.concatenate([gaps.value(state.x), speeds.value(state.x)])
    sizes = members.given.moving.phases.scales.sizes(state.x)
    floor = [*gaps.rounding(sizes), *np.hypot(speeds.rounding(sizes), leftover[certain])]
    H = np.hstack([c, np.zeros((len(c), state.root.shape[0] - size))])
    H[: len(new), size : size + p] = members.gap_sensitivity(new)
    update = correction(state.root, H, np.empty((len(c), 0)), floor)
    change = -update.change(value)
    if p:
        theta = state.theta + change[size : size + p]
        change += members.bound_correction(theta, update.root, slice(size, size + p))
    corrected = state._replace(
        x=state.x + change[:size],
        constants=state.constants + change[size:],
        root=update.root,
        differences=state.differences - update.change(H.dot(state.differences)),
    )
    return _projected(members, corrected)


def _projected(members: Members, state: GaussianState) -> GaussianState:
    """``state``, nearly at rest on its closed contacts, projected onto ``g = 0, gamma = 0``.

    The projection is that by which the plant itself comes to rest.
    """
    closed, n, member = state.closed, state.x.size // 2, members.at(state.theta)
    W, projection = member.system.W[:, list(closed)].T, member.projection
    x, Z = member.moving.phases.stopped(state.x, closed, projection), projection.jump(closed)
    still = member.moving.phase(closed).inverse @ member.system.M
    sensitivity = np.zeros((2 * n, state.parameters))
    sensitivity[:n] = -Z @ members.gap_sensitivity(closed)
    map_ = linalg.block_diag(np.eye(n) - Z @ W, still)
    return state.propagated(x, map_, sensitivity)
