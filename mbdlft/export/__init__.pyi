from .exports import export_model as export_model
from .grid import lpv_grid as lpv_grid
