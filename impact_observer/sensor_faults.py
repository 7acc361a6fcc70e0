# SPDX-License-Identifier: Apache-2.0
"""Simulated sensors: one table for commands, nodes and sweeps."""

from impact_observer.options import Option

SENSOR_FAULTS = (
    Option("delay", 0.0, "constant delay of stamps and messages", "s", 0.0, 10.0),
    Option("jitter", 0.0, "standard deviation of the stamps", "s", 0.0, 1.0),
    Option("quantisation", 0.0, "multiple to which stamps are rounded", "s", 0.0, 1.0),
    Option("dead_time", 0.0, "time after a detection without another one", "s", 0.0, 10.0),
    Option(
        "missed",
        0.0,
        "probability of a missed detection, of IMPACT or CLOSE",
        "",
        0.0,
        1.0,
    ),
    Option("spurious", 0.0, "false positives a second (a rate), of any contact", "1/s", 0.0, 1e4),
    Option("mislabelled", 0.0, "probability that an event names another contact", "", 0.0, 1.0),
    Option(
        "clock_offset", 0.0, "time by which the clock of the sensor is ahead", "s", -3600.0, 3600.0
    ),
    Option(
        "clock_drift",
        0.0,
        "relative error of the rate of the sensor's clock",
        "s/s",
        -0.1,
        0.1,
        metavar="R",
    ),
    Option("threshold", 0.0, "approach speed below which a hit is not detected", "m/s", 0.0, 1e6),
    Option("impacts_only", False, "report CLOSE as IMPACT, and OPEN never"),
    Option("transport", 0.0, "mean of an exponential transport time of events", "s", 0.0, 10.0),
)
"""The fields of ``plant.SensorModel`` in their order; the defaults are an ideal sensor."""

USUAL_RATE = 100.0
"""Of each sensor beside the impacts, Hz."""
MEASUREMENT_RATE = Option("measurement_rate", USUAL_RATE, "rate of each sensor", "Hz", 0.001, 1e5)
