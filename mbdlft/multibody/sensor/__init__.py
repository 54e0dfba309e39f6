"""Kinds of sensors. A new kind is one class and one line in `KINDS`."""

from mbdlft.multibody.sensor.base import Sensor as Sensor
from mbdlft.multibody.sensor.base import Small as Small
from mbdlft.multibody.sensor.kinds import Acceleration as Acceleration
from mbdlft.multibody.sensor.kinds import Accelerometer as Accelerometer
from mbdlft.multibody.sensor.kinds import AngularAcceleration as AngularAcceleration
from mbdlft.multibody.sensor.kinds import AngularRate as AngularRate
from mbdlft.multibody.sensor.kinds import CenterOfMass as CenterOfMass
from mbdlft.multibody.sensor.kinds import Gyro as Gyro
from mbdlft.multibody.sensor.kinds import JointWrench as JointWrench
from mbdlft.multibody.sensor.kinds import Momentum as Momentum
from mbdlft.multibody.sensor.kinds import Position as Position
from mbdlft.multibody.sensor.kinds import SmallRotation as SmallRotation
from mbdlft.multibody.sensor.kinds import Velocity as Velocity

KINDS: dict[str, type[Sensor]] = {
    cls.kind: cls
    for cls in (
        Acceleration,
        Accelerometer,
        AngularAcceleration,
        AngularRate,
        CenterOfMass,
        Gyro,
        JointWrench,
        Momentum,
        Position,
        SmallRotation,
        Velocity,
    )
}
