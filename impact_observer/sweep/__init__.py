"""Sweeps: many runs of plant, sensor and observer, over laws, starts, troubles, wrong models."""
