"""Controllers of a fixed structure, tuned for goals at the worst values of parameters, with proofs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
