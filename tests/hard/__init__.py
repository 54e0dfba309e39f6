"""Cases that are hard for floating point, against 50 digits."""
