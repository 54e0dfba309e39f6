"""The LFT: a matrix that is rational in named deltas, its algebra, and its values. numpy only."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
