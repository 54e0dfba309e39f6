"""Kinds of joints. A new kind is one class and one line in `KINDS`."""

from mbdlft.multibody.joint.base import Joint as Joint
from mbdlft.multibody.joint.base import MovingJoint as MovingJoint
from mbdlft.multibody.joint.base import Rotation as Rotation
from mbdlft.multibody.joint.base import coordinate_label as coordinate_label
from mbdlft.multibody.joint.move import Move as Move
from mbdlft.multibody.joint.move import Turn as Turn
from mbdlft.multibody.joint.one_axis import Cylindrical as Cylindrical
from mbdlft.multibody.joint.one_axis import Fixed as Fixed
from mbdlft.multibody.joint.one_axis import Planar as Planar
from mbdlft.multibody.joint.one_axis import Prismatic as Prismatic
from mbdlft.multibody.joint.one_axis import Revolute as Revolute
from mbdlft.multibody.joint.several_axes import Free as Free
from mbdlft.multibody.joint.several_axes import Spherical as Spherical
from mbdlft.multibody.joint.several_axes import Universal as Universal

KINDS: dict[str, type[Joint]] = {
    cls.kind: cls
    for cls in (Cylindrical, Fixed, Free, Planar, Prismatic, Revolute, Spherical, Universal)
}
