"""What a finished model says at samples: poles, zeros, norms, responses over frequency and time."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
