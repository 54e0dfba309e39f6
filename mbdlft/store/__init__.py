"""The archive: LFT models in HDF5, layout version 1.0 (docs/archive-format.md). Needs h5py and numpy."""

from mbdlft.store.archive import load as load
from mbdlft.store.archive import model_names as model_names
from mbdlft.store.archive import save as save
from mbdlft.store.sweep import Sweep as Sweep
from mbdlft.store.sweep import load_sweep as load_sweep
from mbdlft.store.sweep import sweep_names as sweep_names
