from .grid import lpv_grid as lpv_grid
from .write import export_model as export_model
