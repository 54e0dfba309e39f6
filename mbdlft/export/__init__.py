"""Finished models for other tools: MATLAB and Octave, C, Julia, and matrices on a grid."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
