"""Scenes to be looked at: one web page, with sliders for parameters and positions, and moving modes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
