from .limits import JointLimit as JointLimit
from .load import ImportReport as ImportReport
from .load import load_urdf as load_urdf
