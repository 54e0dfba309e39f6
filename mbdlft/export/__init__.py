"""Finished models for other tools: MATLAB and Octave, C, FMI, Julia, Python's libraries, grids."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
