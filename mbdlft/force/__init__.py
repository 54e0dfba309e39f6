"""Kinds of loads, one file each. A new kind is one file and one line in `KINDS`."""

from mbdlft.force.base import BodyWrench as BodyWrench
from mbdlft.force.base import Load as Load
from mbdlft.force.buoyancy import Buoyancy as Buoyancy
from mbdlft.force.force import Force as Force
from mbdlft.force.spring import Spring as Spring
from mbdlft.force.torque import Torque as Torque

KINDS: dict[str, type[Load]] = {cls.kind: cls for cls in (Buoyancy, Force, Spring, Torque)}
