# SPDX-License-Identifier: Apache-2.0
"""What a recording holds over time: coordinates, velocities, gaps, and what became of impacts."""
