"""Kinds of bodies. A new kind is one class and one line in `KINDS`."""

from mbdlft.multibody.body.beam import Beam as Beam
from mbdlft.multibody.body.elastic import ElasticBody as ElasticBody
from mbdlft.multibody.body.elastic import FlexibleBody as FlexibleBody
from mbdlft.multibody.body.elastic import Mode as Mode
from mbdlft.multibody.body.piezo import PiezoBeam as PiezoBeam
from mbdlft.multibody.body.piezo import PiezoPatch as PiezoPatch
from mbdlft.multibody.body.rigid import GROUND as GROUND
from mbdlft.multibody.body.rigid import Body as Body
from mbdlft.multibody.body.rigid import Ground as Ground
from mbdlft.multibody.body.rigid import Inertia as Inertia
from mbdlft.multibody.body.rigid import PointMass as PointMass
from mbdlft.multibody.body.rigid import RigidBody as RigidBody
from mbdlft.multibody.body.rigid import Shape as Shape

KINDS: dict[str, type[Body]] = {
    cls.kind: cls for cls in (Beam, FlexibleBody, Ground, PiezoBeam, PointMass, RigidBody)
}
