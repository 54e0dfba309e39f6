"""The archive: models and sweeps in HDF5, layout 1.1 (docs/archive-format.md). Needs h5py and numpy."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
