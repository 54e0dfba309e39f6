"""From a scene or a matrix to a certified model: extraction, reduction, bound, search and check."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
