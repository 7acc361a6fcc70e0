# SPDX-License-Identifier: Apache-2.0
"""How the hypotheses of a bank have explained an event."""

from collections.abc import Sequence

from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.filter_bank import FilterBank
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis, error_share, exact_share
from impact_observer.filter.misfit import Fit
from impact_observer.filter.tuning import TUNING

_INSTANT_ROUNDING = 2e-9
"""Error of a predicted instant by the rounding of this and earlier stamps to 1 ns, s."""


def fitted(
    before: Fit,
    change: ContactChange,
    prior: GaussianState,
    corrected: Sequence[Hypothesis],
    bank: FilterBank,
) -> Fit:
    """The fit after an event, by the hypotheses after it, the likeliest first.

    Errors of a model do not show in brief flights, whatever is measured meanwhile. So impacts that
    accumulate count once: their innovations would fill the window that is tested. Stamps of a
    periodic motion are rounded periodically. So an innovation within the rounding counts as zero.

    Args:
        before: the fit before the event.
        change: the change of contacts.
        prior: the estimate before the event.
        corrected: the hypotheses after the event.
        bank: the bank of the hypotheses.
    """
    brief = TUNING.brief_flight * bank.filter.scales.timescale
    if 0 < change.flight < brief:
        return before
    likeliest, errors, innovation = corrected[0], bank.errors, corrected[0].innovation
    normalised = None if innovation is None else innovation.normalised
    if innovation is not None and change.hit:
        system = bank.filter.near(prior.x)
        speed = abs(float(system.W[:, change.hit[0]].dot(prior.x[system.n :])))
        normalised = 0.0 if abs(innovation.residual) <= _INSTANT_ROUNDING * speed else normalised
    considered = 0.0
    if innovation is not None and change.hit:
        by_considered = bank.filter.considered_deviation(change.hit[0], prior)
        considered = min(by_considered / innovation.deviation, 1.0)
    jumps = likeliest.jump_error
    return before.after(
        normalised,
        instant=change.t / bank.filter.scales.timescale,
        in_error=error_share(corrected) > TUNING.established_error,
        as_reported=likeliest.ledger.is_as_reported((change.stamp, change.sequence)),
        exact=exact_share(corrected),
        is_trusted=bank.trusts_events,
        considered=considered,
        strange_jumps=jumps is not None and jumps.is_strange,
        by_clock=errors is not None and errors.is_coarse(likeliest.clock),
    )
