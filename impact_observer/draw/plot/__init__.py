# SPDX-License-Identifier: Apache-2.0
"""Plots of a recording over time: coordinates, velocities, gaps, and verdicts on impacts."""
