"""Moving drawings of plant and estimates: positions, shapes, films."""
