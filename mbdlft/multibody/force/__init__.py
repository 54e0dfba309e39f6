"""Kinds of loads. A new kind is one class and one line in `KINDS`."""

from mbdlft.multibody.force.guided import Creep as Creep
from mbdlft.multibody.force.guided import Guided as Guided
from mbdlft.multibody.force.guided import Strut as Strut
from mbdlft.multibody.force.guided import Support as Support
from mbdlft.multibody.force.guided import Tire as Tire
from mbdlft.multibody.force.guided import Wheel as Wheel
from mbdlft.multibody.force.kinds import BodyWrench as BodyWrench
from mbdlft.multibody.force.kinds import Buoyancy as Buoyancy
from mbdlft.multibody.force.kinds import DirectedLoad as DirectedLoad
from mbdlft.multibody.force.kinds import Force as Force
from mbdlft.multibody.force.kinds import Load as Load
from mbdlft.multibody.force.kinds import Spring as Spring
from mbdlft.multibody.force.kinds import SpringLoad as SpringLoad
from mbdlft.multibody.force.kinds import Torque as Torque

KINDS: dict[str, type[Load]] = {
    cls.kind: cls for cls in (Buoyancy, Creep, Force, Spring, Strut, Support, Tire, Torque)
}
