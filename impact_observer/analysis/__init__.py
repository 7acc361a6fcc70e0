"""What to make of states and estimates: pure functions on arrays."""

SETTLED = 1e-2
"""V over V at the start below which an estimate counts as settled, unless told otherwise."""
