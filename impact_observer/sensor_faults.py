# SPDX-License-Identifier: Apache-2.0
"""What can be wrong with sensors: one table for commands, nodes and sweeps."""

from impact_observer.options import Option

SENSOR_FAULTS = (
    Option("delay", 0.0, "constant delay of detection, stamp and message", "s", 0.0, 10.0),
    Option("jitter", 0.0, "standard deviation of the stamps", "s", 0.0, 1.0),
    Option("quantisation", 0.0, "stamps are rounded to a multiple of this", "s", 0.0, 1.0),
    Option(
        "dead_time", 0.0, "time after a detection in which nothing is detected", "s", 0.0, 10.0
    ),
    Option(
        "missed",
        0.0,
        "probability that an impact is not detected, be it IMPACT or CLOSE",
        "",
        0.0,
        1.0,
    ),
    Option("spurious", 0.0, "rate of false positives, of any contact", "1/s", 0.0, 1e4),
    Option("mislabelled", 0.0, "probability that another contact is named", "", 0.0, 1.0),
    Option("clock_offset", 0.0, "how far the sensor's clock is ahead", "s", -3600.0, 3600.0),
    Option(
        "clock_drift",
        0.0,
        "relative rate error of the sensor's clock",
        "s/s",
        -0.1,
        0.1,
        metavar="R",
    ),
    Option("threshold", 0.0, "approach speed below which nothing is detected", "m/s", 0.0, 1e6),
    Option("impacts_only", False, "CLOSE is reported as IMPACT, OPEN never"),
    Option("transport", 0.0, "mean of an exponential transport time of events", "s", 0.0, 10.0),
)
"""In the order of the fields of ``plant.SensorModel``; the defaults are an ideal sensor."""

MEASUREMENT_FAULTS = (
    Option("measurement_rate", 100.0, "samples of each sensor", "Hz", 0.001, 1e5),
    Option(
        "measurement_noise",
        -1.0,
        "standard deviation of samples, in their unit; -1: as declared",
        "",
        -1.0,
        1e9,
    ),
    Option("measurement_dropouts", 0.0, "probability that a sample is lost", "", 0.0, 1.0),
    Option(
        "measurement_quantisation",
        0.0,
        "samples are rounded to a multiple of this",
        "",
        0.0,
        1e9,
    ),
    Option("measurement_transport", 0.0, "mean of an exponential transport time", "s", 0.0, 10.0),
)
"""Of sensors beside the impacts, in the order of the fields of ``io.SampleFaults``."""
