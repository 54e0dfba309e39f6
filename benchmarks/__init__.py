"""Benchmarks: each verifies its answer before it prints a time."""
