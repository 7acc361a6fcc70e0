"""Estimates against the truth: what differs, by how much, in tables and pictures."""
