from .load import load_robot as load_robot
from .load import load_urdf as load_urdf
from .report import ImportReport as ImportReport
from .report import JointLimit as JointLimit
