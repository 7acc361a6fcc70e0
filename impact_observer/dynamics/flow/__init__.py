"""The flow of one linear phase: states at given instants, exact but for rounding."""
