"""Motions of any size, for simulation."""
