from .build import exact_lower_bound as exact_lower_bound
from .build import realize as realize
from .build import to_lft as to_lft
