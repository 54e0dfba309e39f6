"""Kinds of loads, one file each. A new kind is one file and one line in `KINDS`."""

from mbdlft.multibody.force.base import BodyWrench as BodyWrench
from mbdlft.multibody.force.base import Load as Load
from mbdlft.multibody.force.buoyancy import Buoyancy as Buoyancy
from mbdlft.multibody.force.force import Force as Force
from mbdlft.multibody.force.spring import Spring as Spring
from mbdlft.multibody.force.strut import Strut as Strut
from mbdlft.multibody.force.torque import Torque as Torque

KINDS: dict[str, type[Load]] = {cls.kind: cls for cls in (Buoyancy, Force, Spring, Strut, Torque)}
