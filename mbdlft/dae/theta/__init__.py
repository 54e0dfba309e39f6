"""Delta-Theta forms: relations that are linear in signals, and nonlinear functions."""
