"""Smaller LFTs of the same value: n-D reduction, and the search that uses that deltas commute."""
