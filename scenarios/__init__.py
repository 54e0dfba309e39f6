"""Runnable scenes: TOML files, and scripts that use them."""
