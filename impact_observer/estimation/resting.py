"""What is known of contacts that come to rest: their gaps are closed, and they have no speed."""

import numpy as np
from scipy import linalg

from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.members import Members
from impact_observer.estimation.saltation import Measured
from impact_observer.estimation.square_root import correction
from impact_observer.events import Contacts
from impact_observer.states import Vector


def rested(members: Members, known: GaussianState, new: Contacts, left: Vector) -> GaussianState:
    """``g = 0`` and ``gamma = 0`` on closed contacts; those that are ``new`` tell it.

    Args:
        members: the family of what moves.
        known: when they close.
        new: contacts that were not closed before.
        left: speeds that a plant may leave out before these rest, shape (len(new),), m/s.
    """
    if not known.closed:
        return known
    member, size, p = members.at(known.theta), known.x.size, known.parameters
    # What comes to rest may have bounced before, unheard: that it rests says nothing of how well.
    sure = ~members.bounces(new)
    tells = tuple(i for i, each in zip(new, sure.tolist(), strict=True) if each)
    gaps, speeds = member.gaps(new), Measured.speeds(member.system, tells)
    c = np.vstack([gaps.c, speeds.c])
    value = np.concatenate([gaps.value(known.x), speeds.value(known.x)])
    sizes = members.given.moving.phases.scales.sizes(known.x)
    floor = [*gaps.rounding(sizes), *np.hypot(speeds.rounding(sizes), left[sure])]
    H = np.hstack([c, np.zeros((len(c), known.root.shape[0] - size))])
    H[: len(new), size : size + p] = members.gap_rows(new)
    learnt = correction(known.root, H, np.empty((len(c), 0)), floor)
    change = -learnt.change(value)
    if p:
        theta = known.theta + change[size : size + p]
        change += members.inward(theta, learnt.root, slice(size, size + p))
    told = known._replace(
        x=known.x + change[:size],
        slow=known.slow + change[size:],
        root=learnt.root,
        differences=known.differences - learnt.change(H.dot(known.differences)),
    )
    return _stopped(members, told)


def _stopped(members: Members, known: GaussianState) -> GaussianState:
    """What is known, where it is as good as exact that closed contacts rest.

    What is left goes by the way the plant itself comes to rest.
    """
    closed, n, member = known.closed, known.x.size // 2, members.at(known.theta)
    W, projection = member.system.W[:, list(closed)].T, member.projection
    x, Z = member.moving.phases.stopped(known.x, closed, projection), projection.jump(closed)
    still = member.moving.phase(closed).inverse @ member.system.M
    turn = np.zeros((2 * n, known.parameters))
    turn[:n] = -Z @ members.gap_rows(closed)
    return known.carried(x, linalg.block_diag(np.eye(n) - Z @ W, still), turn)
