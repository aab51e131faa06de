"""Sweeps, stability maps and comparisons over many runs."""
