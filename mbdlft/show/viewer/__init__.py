"""Scenes to be looked at: one web page, with sliders for parameters and positions, and moving modes."""
