from .exports import export_model as export_model
from .exports import lpv_grid as lpv_grid
from .python import casadi_function as casadi_function
from .python import dataset as dataset
from .python import frequency_data as frequency_data
