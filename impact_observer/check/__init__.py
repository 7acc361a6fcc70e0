"""Whether an observer can use a bag, and what is wrong with it."""
