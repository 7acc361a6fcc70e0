# SPDX-License-Identifier: Apache-2.0
"""The tuned numbers of minimum-variance: priors, gates, windows and limits of its hypotheses.

Numbers of the arithmetic, such as roundings, stand in the modules that use them. Where a number
has no source and no measurement beside it, it was chosen by hand; ``./dev bench`` with
``accuracy`` and ``honesty`` shows what a change does.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Tuning:
    """The tuned numbers, in the order of their use; names that begin with ``log`` are logarithms.

    Deviations are standard deviations. The time scale of a model is the inverse of its fastest
    rate.
    """

    # Priors
    clock_errors: tuple[float, ...] = (0.0, 1e-7, *(10 ** (k / 4 - 6) for k in range(17)))
    """Deviations of a stamp, s: one hypothesis each where none is declared. From 1 us to 10 ms
    there are four in a decade. A drill with jitter between those of a coarser grid was warned of
    at 189 of 360 events.
    """
    log_clock_change: float = math.log(0.01)
    """Prior probability, at each event, of each other deviation of the stamps."""
    clock_steps: tuple[int, ...] = (-4, -1, 1, 4)
    """Places in ``clock_errors`` to which that may change: the next ones, and a decade away."""
    spurious_rate: float = 0.1
    """Rate of false alarms of a contact, were all events false alarms, in the fastest rate: a
    Poisson process.
    """
    log_restart: float = math.log(2.5e-3)
    """Prior probability that the covariance is too small, or the whole estimate wrong."""
    log_error_change: float = math.log(0.01)
    """Prior probability, at each event, that an error of the model begins, ends or becomes of the
    other kind. The limit of the odds in docs/theory/filter.md is computed with this number.
    """
    restitution_deviation: float = 0.1
    """Prior deviation of a restitution that is estimated, where none is declared."""
    parameter_deviation: float = 0.05
    """The same of any other parameter, relative to its size."""

    undeclared_error: float = 1e-5
    """Least deviation that is published, over the motion, where a model file declares no number
    exact: a relative 1e-6 of stiffness, mass, damping, amplitude, gaps and restitutions makes
    errors of up to ten times that. See docs/theory/filter.md.
    """

    # Branching
    surprise: float = 3.0
    """Gate of the innovation, in deviations: beyond it a wider covariance is tried too."""
    widening: float = 3.0
    """Factor of the innovation by which a covariance is widened then."""
    large_widening: float = 100.0
    """A second such factor, which is tried beside it at events."""
    widest_deviation: float = 10.0
    """Deviation that a widened one stays below, relative to the motion so far. What no event shows
    would grow at each widening.
    """
    unlimited_deviation: float = 0.3
    """Deviation that needs no limit, relative to the widest."""
    impossible_speed: float = 100.0
    """Speed of a contact, or its deviation, above which a hypothesis is dropped, relative to the
    fastest that the motion so far allows. Where stamps are wrong by more than the model's time
    scale, terms of second order in their errors multiply the covariance at each event.
    """
    log_leading: float = -3.0
    """Probability, relative to the largest: only hypotheses above it branch into other clocks,
    wider covariances and errors of the model.
    """

    # Weighing
    slow_impact: float = 1e-4
    """Speed of an impact below which it is less likely in proportion, relative to the fastest that
    the energy of the motion allows. Free masses with a fifth of the impacts missed were lost
    without it: at rest in a corner of its stops an estimate has gaps of zero, which fit any event.
    """
    log_least_disorder: float = -50.0
    """Least probability of two stamps in a wrong order: no hypothesis becomes impossible by it."""

    log_unreported_row: float = math.log(0.01)
    """Prior probability that a CLOSE is the first edge of a row of bounces that the sensor does
    not report.
    """
    neglected_flight: float = 1e-3
    """Longest flight that a plant, or a user who simulates one, may neglect before a rest,
    relative to the time scale.
    """
    log_least_rest: float = -50.0
    """Least probability that a contact rests after a fast hit: restitution may be other."""

    # Pruning
    most_hypotheses: int = 64
    """Hypotheses that are kept, besides restarts; twice as many before an event."""
    least_hypotheses: int = 8
    """The same of a large state."""
    hypothesis_numbers: int = 1024
    """Numbers in the states of all hypotheses that are kept, for models between these two."""
    negligible: float = 1e-4
    """Probability of the least likely hypotheses after an event, together, that are dropped. With
    it a filter that has locked on has one hypothesis.
    """
    log_unlikely: float = -16.0
    """Probability, relative to the largest, below which no hypothesis is kept before an event. The
    event may yet explain negative gaps, so it is far below ``negligible``.
    """
    log_forlorn: float = -40.0
    """The same of hypotheses with an exact model, as their odds are the test of a misfit."""
    scan: int = 3
    """Decisions, times the coordinates, in which two hypotheses must differ (N-scan pruning). A
    state is known after about 2n + 1 events.
    """
    near: float = 3.0
    """Deviations up to which two states count as the same."""
    most_notes: int = 32
    """Decisions that a hypothesis keeps, at least, of whole events; older ones are not revised."""
    unpublished: float = 1e-3
    """Probability up to which the least likely hypotheses are not published. The variance of a
    whole mixture would be that of its rarest members.
    """
    unpublished_error: float = 0.05
    """The same of hypotheses that differ from the likeliest by an error of the model. Such errors
    are tried at many events, and would spoil the consistency for exact models.
    """
    disagreeing: float = 0.05
    """Most probability of hypotheses that do not count in the test of ``synchronized``: the flag
    may be wrong as often. One wild account of an echo ended the flag for three impacts.
    """

    # Missed impacts
    possible_depth: float = 0.5
    """Depth of a dip below zero, in deviations, from which on it may be a missed impact."""
    confident_depth: float = 3.0
    """The same of a dip that is not over; from there on the published estimate jumps."""
    late: float = 4.0
    """Deviations of a stamp up to which a predicted impact before an event may be the event."""
    dead: float = 0.5
    """Probability of the dead time from which on a missed switch counts as one in it."""
    log_silent: float = math.log(1e-6)
    """Logarithm of the probability of so many missed impacts in a row, below which the sensor is
    dead or the plant has stopped.
    """
    silent_prior: float = 10.0
    """Impacts that the declared probability of a missed impact is worth."""
    silent_share: float = 0.5
    """Probability that the plant has stopped and not the sensor, once impacts are silent."""
    most_missed: int = 256
    """Missed switches that one hypothesis, or the published estimate, may insert before the next
    event.
    """
    most_flights: int = 256
    """Flights of all hypotheses after which none inserts any: a silence may last for hours."""
    first_reach: float = 100.0
    """Time in which penetrations are searched first, in time scales: in a longer silence they soon
    make a hypothesis impossible.
    """

    # Settling
    unresolved_flight: float = 4.0
    """Longest flight that the clock does not resolve, in deviations of a stamp. Bounces that were
    measured one by one left V/V0 at 3e-9 instead of 1e-11 on drills that come to rest.
    """
    longest_flight: float = 100.0
    """Longest flight before such a one, in deviations of a stamp: bounces grow shorter."""
    unknown_flight: float = 40.0
    """Deviation of a flight, in those of a stamp, above which its mean says nothing. Without it
    contacts that never rest were closed, with NEES up to 3e5 for each number of the state.
    """
    least_loss: float = 0.05
    """Least share of its speed that a bounce loses, where the rest after all bounces is
    predicted.
    """
    far_bounce: float = 6.0
    """Deviations from the predicted rest up to which a hit may be one of the bounces."""
    resting_flight: float = 1e-2
    """Longest flight after a missed impact that counts as rest, where its height is within the
    deviation of the gap, relative to the time scale.
    """

    # Error of the model
    jump_errors: tuple[float, ...] = (0.05, 0.3, 1.0)
    """Sizes of errors of a robot's velocity jumps, over the jump. The first is explained."""
    jump_counts: tuple[float, ...] = (8.0, 1.0, 1.0)
    """Hits with these errors that are supposed before the first hit."""
    jump_window: float = 0.05
    """Time after a hit in which samples tell the size, s."""
    unexplained_jumps: float = 0.3
    """Share of the hits with larger errors beyond which the model does not explain the jumps."""
    jump_hits: int = 6
    """Least number of hits of which that is a share."""
    unexplained: float = 2.0
    """Gate of the innovation, in deviations: beyond it the model may have begun to err."""
    coarse_clock: float = 10.0
    """Deviation of a stamp, relative to the least, beyond which it may hide such an error."""
    brief_flight: float = 0.1
    """Flight up to which an impact says nothing new of the model, relative to the time scale.
    Impacts that accumulate would fill the windows of the tests.
    """
    forgetting: float = 0.95
    """Weight of earlier events in the level of an error, at each event (Sage and Husa, 1969)."""
    least_information: float = 1.0
    """Information about the logarithm of a variance that a new level counts as having."""
    clipping: float = 3.0
    """Deviations beyond which an innovation counts as this, in levels of errors, in the test of a
    misfit: an outlier is none of them (Huber, 1964).
    """
    largest_restitution_error: float = 0.1
    """Most that the deviation of a restitution may be."""
    largest_acceleration_error: float = 0.1
    """Most that white accelerations may be, relative to those of the motion over a time scale."""
    first_events: int = 12
    """Events from the start in which the state is not known: errors of a model are no sign yet. In
    3 of 1297 runs of exact models the state was found by way of one.
    """
    exact_events: int = 24
    """Events in a row without an error of the model, after which it counts as exact again."""

    # Misfit
    contradiction: float = 8.0
    """Innovation of an event that is applied, in standard deviations, which contradicts what is
    declared of sensor and model: no normal variable is as far off (1e-15).
    """
    window: int = 32
    """Latest innovations and events that are tested."""
    fewest: int = 12
    """Fewest innovations or events that are tested."""
    lags: int = 4
    """Lags of the portmanteau test (Ljung and Box, 1978)."""
    largest_statistic: float = 48.0
    """Statistic of the test above which the model does not explain the impacts. An alarm began in
    0.025 of 100 000 simulated innovations of exact models (docs/theory/filter.md).
    """
    doubted_statistic: float = 24.0
    """The same, above which parameters are estimated too. Exact models seldom get there."""
    doubtful_statistic: float = 16.0
    """The same, above which errors of the clock are no good explanation."""
    repeated: tuple[float, ...] = (0.3, 0.1, 0.03)
    """Steps between innovations that repeat, over their size."""
    fewest_repeated: int = 5
    """Fewest such steps that are tested."""
    largest_repetition: float = 12.0
    """Log odds of innovations that repeat to white ones, above which the model does not explain
    the impacts. White ones pass it with a probability of at most 6e-6 (docs/theory/filter.md).
    """
    doubted_repetition: float = 3.0
    """The same, above which nothing is synchronized: of simulated white ones 0.1 % are."""
    harmonic_windows: tuple[int, ...] = (12, 16, 24, 32)
    """Numbers of latest innovations in which a harmonic is sought."""
    highest_frequency: float = 3.0
    """Highest angular frequency of such a harmonic, over the fastest rate of the model."""
    doubted_periodicity: float = 6.0
    """Log odds of a harmonic, above which parameters are estimated too and nothing is
    synchronized.
    """
    established_error: float = 0.8
    """Probability of an error of the model from which on an event counts as one with an error."""
    doubted_events: int = 6
    """Such events in a row from which on parameters are estimated too."""
    established_events: int = 12
    """Such events in a row by which an error is established. In three of 849 runs of exact models
    up to 23 such events came in a row, so alone they do not warn.
    """
    doubted_explained: float = 0.5
    """Share of the latest ``fewest`` events that the model explains as reported, without an error,
    below which parameters are estimated too.
    """
    largest_evidence: float = 12.0
    """Log odds of an error of the model to none, above which the model is refuted. By Doob's
    inequality exact models pass it in 100 000 events with a probability of at most 0.12
    (docs/theory/filter.md).
    """
    doubted_evidence: float = 4.0
    """The same, above which parameters are estimated too."""
    evidence_step: float = 3.0
    """Most by which one event may raise these log odds: one outlier is no misfit."""
    fewest_excused: int = 16
    """Events from which on those that need an excuse are counted: a false alarm, a missed
    detection, a restart.
    """
    least_explained: float = 0.375
    """Least share of the window that an exact model explains as reported. Where the plant rests
    and the sensor does not, 11 to 21 false alarms raise the warning.
    """
    mostly_explained: float = 0.8
    """Least share of the window that the right parameters explain."""

    # Second account and fallback
    recent: int = 5
    """Latest impacts at which the account with other parameters is compared."""
    compared: int = 16
    """Latest impacts at which filter and geometric replica are compared."""
    nearer: float = 0.9
    """Most that the residuals of another estimate may be, over the filter's, to be published."""
    clearly_nearer: float = 0.5
    """Most that those of the account may be to refute the model."""
    significant_change: float = 5.0
    """Change of all parameters together, in deviations, that refutes the model then."""
    notable_change: float = 3.0
    """The same where an error of the model is established and the account is ``nearer``."""
    least_considered: float = 0.1
    """Part of an innovation's deviation by considered parameters, above which the event is no
    evidence of an error of the model: such innovations are correlated.
    """
    considered_deviations: float = 3.0
    """Errors of considered parameters, in deviations, that explain innovations of one sign."""

    # Samples
    open_speed: float = 4.0
    """Largest speed of an open contact of a robot since the sample before, over that now."""
    rejected_samples: int = 3
    """Samples of a sensor rejected in a row from which on the covariance is doubted."""


TUNING = Tuning()
"""The numbers in use."""
