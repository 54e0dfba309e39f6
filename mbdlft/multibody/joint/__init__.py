"""Kinds of joints. A new kind is one class and one line in `KINDS`."""

from mbdlft.multibody.joint.kinds import Cylindrical as Cylindrical
from mbdlft.multibody.joint.kinds import Fixed as Fixed
from mbdlft.multibody.joint.kinds import Free as Free
from mbdlft.multibody.joint.kinds import Joint as Joint
from mbdlft.multibody.joint.kinds import MovingJoint as MovingJoint
from mbdlft.multibody.joint.kinds import Planar as Planar
from mbdlft.multibody.joint.kinds import Prismatic as Prismatic
from mbdlft.multibody.joint.kinds import Revolute as Revolute
from mbdlft.multibody.joint.kinds import Rotation as Rotation
from mbdlft.multibody.joint.kinds import Spherical as Spherical
from mbdlft.multibody.joint.kinds import Universal as Universal
from mbdlft.multibody.joint.kinds import coordinate_label as coordinate_label
from mbdlft.multibody.joint.kinds import with_entry as with_entry
from mbdlft.multibody.joint.move import Move as Move
from mbdlft.multibody.joint.move import Turn as Turn

KINDS: dict[str, type[Joint]] = {
    cls.kind: cls for cls in (Cylindrical, Fixed, Free, Planar, Prismatic, Revolute, Spherical, Universal)
}
