from .load import ImportReport as ImportReport
from .load import load_robot as load_robot
from .load import load_urdf as load_urdf
from .robot import JointLimit as JointLimit
