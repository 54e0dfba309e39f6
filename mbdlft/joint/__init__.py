"""Kinds of joints, one file each. A new kind is one file and one line in `KINDS`."""

from mbdlft.joint.base import Joint as Joint
from mbdlft.joint.base import MovingJoint as MovingJoint
from mbdlft.joint.base import Rotation as Rotation
from mbdlft.joint.base import labelled as labelled
from mbdlft.joint.cylindrical import Cylindrical as Cylindrical
from mbdlft.joint.fixed import Fixed as Fixed
from mbdlft.joint.free import Free as Free
from mbdlft.joint.move import Move as Move
from mbdlft.joint.move import Turn as Turn
from mbdlft.joint.planar import Planar as Planar
from mbdlft.joint.prismatic import Prismatic as Prismatic
from mbdlft.joint.revolute import Revolute as Revolute
from mbdlft.joint.spherical import Spherical as Spherical
from mbdlft.joint.universal import Universal as Universal

KINDS: dict[str, type[Joint]] = {
    cls.kind: cls
    for cls in (Cylindrical, Fixed, Free, Planar, Prismatic, Revolute, Spherical, Universal)
}
