"""The flow of one linear phase: states at given instants, in closed form."""
