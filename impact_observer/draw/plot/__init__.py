"""What a recording holds over time: coordinates, velocities, gaps, and what became of impacts."""
