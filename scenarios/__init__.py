"""Scenes that can be run: TOML files, and scripts that use them."""
