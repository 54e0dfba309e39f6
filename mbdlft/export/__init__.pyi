from .exports import export_model as export_model
from .exports import lpv_grid as lpv_grid
