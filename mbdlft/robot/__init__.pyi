from .limits import JointLimit as JointLimit
from .load import load_robot as load_robot
from .report import ImportReport as ImportReport
