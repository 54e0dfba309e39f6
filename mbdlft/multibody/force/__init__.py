"""Kinds of loads. A new kind is one class and one line in `KINDS`."""

from mbdlft.multibody.force.base import BodyWrench as BodyWrench
from mbdlft.multibody.force.base import Load as Load
from mbdlft.multibody.force.kinds import Buoyancy as Buoyancy
from mbdlft.multibody.force.kinds import Force as Force
from mbdlft.multibody.force.kinds import Spring as Spring
from mbdlft.multibody.force.kinds import Strut as Strut
from mbdlft.multibody.force.kinds import Torque as Torque

KINDS: dict[str, type[Load]] = {cls.kind: cls for cls in (Buoyancy, Force, Spring, Strut, Torque)}
