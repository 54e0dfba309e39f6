"""Kinds of bodies, one file each. A new kind is one file and one line in `KINDS`."""

from mbdlft.body.base import GROUND as GROUND
from mbdlft.body.base import Body as Body
from mbdlft.body.beam import Beam as Beam
from mbdlft.body.elastic import ElasticBody as ElasticBody
from mbdlft.body.flexible import FlexibleBody as FlexibleBody
from mbdlft.body.flexible import Mode as Mode
from mbdlft.body.ground import Ground as Ground
from mbdlft.body.piezo import PiezoBeam as PiezoBeam
from mbdlft.body.piezo import PiezoPatch as PiezoPatch
from mbdlft.body.point_mass import PointMass as PointMass
from mbdlft.body.rigid import Inertia as Inertia
from mbdlft.body.rigid import RigidBody as RigidBody

KINDS: dict[str, type[Body]] = {
    cls.kind: cls for cls in (Beam, FlexibleBody, Ground, PiezoBeam, PointMass, RigidBody)
}
