"""Robots that are described in URDF files."""

from mbdlft.scene.urdf.limits import JointLimit as JointLimit
from mbdlft.scene.urdf.load import ImportReport as ImportReport
from mbdlft.scene.urdf.load import load_urdf as load_urdf
