# SPDX-License-Identifier: Apache-2.0
"""Sweeps: many runs of plant, sensor and observer over laws, seeds, sensor faults and models."""
