"""What to make of states and estimates: pure functions on arrays."""
