"""Side by side: what the package does against what the same costs elsewhere."""
