"""Whether the impacts of a recording determine the state: rank, condition, directions."""
