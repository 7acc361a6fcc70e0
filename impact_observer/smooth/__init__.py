# SPDX-License-Identifier: Apache-2.0
"""The best estimate of a recording, from the events before and after each instant."""

from impact_observer.smooth.recording import smoothed_runs
from impact_observer.smooth.smoothed_motion import SmoothedMotion

__all__ = ["SmoothedMotion", "smoothed_runs"]
