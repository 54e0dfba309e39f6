from .description import JointLimit as JointLimit
from .load import ImportReport as ImportReport
from .load import load_robot as load_robot
from .load import load_urdf as load_urdf
