from .build import realize as realize
from .build import to_lft as to_lft
