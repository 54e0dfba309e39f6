"""Systems: LFTs with named channels and parameters, and what is done with them. numpy only."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
