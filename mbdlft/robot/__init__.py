"""The front end for robots: scenes from URDF, SDF and MJCF files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
