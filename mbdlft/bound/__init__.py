"""Proofs: lower bounds on repetitions, and upper bounds on the size of an LFT."""
