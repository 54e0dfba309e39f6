from .build import exact_lower_bound as exact_lower_bound
from .build import realize as realize
from .build import to_lft as to_lft
from .build_dae import delta_theta as delta_theta
from .build_dae import linearize_dae as linearize_dae
