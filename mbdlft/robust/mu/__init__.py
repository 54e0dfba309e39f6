"""Multipliers: bounds of structured singular values on intervals of frequency and parts of the box."""
