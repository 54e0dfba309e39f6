"""Actuators as linear blocks and as pieces of scenes, and two-ports of bodies."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
