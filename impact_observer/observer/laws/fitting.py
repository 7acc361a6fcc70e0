"""How the hypotheses of a bank have explained an event."""

from collections.abc import Sequence

from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.filter_bank import FilterBank
from impact_observer.estimation.hypotheses import Hypothesis, error_share
from impact_observer.estimation.misfit import ESTABLISHED, Fit

BRIEF = 0.1
"""Flight up to which an impact says nothing new, relative to the model's time scale."""


def fitted(
    before: Fit, change: ContactChange, corrected: Sequence[Hypothesis], bank: FilterBank
) -> Fit:
    """The fit after an event, by the hypotheses after it, the likeliest first.

    Errors of a model do not show in brief flights. So impacts that accumulate count once: their
    innovations would fill the window that is tested.
    """
    if 0 < change.flown < BRIEF * bank.filter.phases.scales.timescale:
        return before
    likeliest, errors = corrected[0], bank.errors
    return before.after(
        likeliest.innovation,
        in_error=error_share(corrected) > ESTABLISHED,
        as_reported=likeliest.is_as_reported((change.stamp, change.sequence)),
        by_clock=errors is not None and errors.is_coarse(likeliest.clock),
    )
