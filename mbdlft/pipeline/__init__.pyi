from .build import to_lft as to_lft
from .realization import realize as realize
