"""What is proved for all parameters of a box: margins, gains, worst cases, and checks of proofs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
