"""Benchmarks: the package and its peers, measured side by side."""
