from .archive import load as load
from .archive import model_names as model_names
from .archive import save as save
from .sweep import Sweep as Sweep
from .sweep import load_sweep as load_sweep
from .sweep import sweep_names as sweep_names
