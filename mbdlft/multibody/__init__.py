"""Multibody systems: bodies, joints, loads, sensors, the scene that joins them, and its equilibrium."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
