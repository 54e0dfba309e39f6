"""Kinds of joints, one file each. A new kind is one file and one line in `KINDS`."""

from mbdlft.joint.base import Coordinate as Coordinate
from mbdlft.joint.base import Joint as Joint
from mbdlft.joint.base import Turn as Turn
from mbdlft.joint.fixed import Fixed as Fixed
from mbdlft.joint.prismatic import Prismatic as Prismatic
from mbdlft.joint.revolute import Revolute as Revolute

KINDS: dict[str, type[Joint]] = {cls.kind: cls for cls in (Fixed, Prismatic, Revolute)}
