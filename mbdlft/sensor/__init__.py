"""Kinds of sensors. A new kind is one class and one line in `KINDS`."""

from mbdlft.sensor.base import Sensor as Sensor
from mbdlft.sensor.base import Small as Small
from mbdlft.sensor.inertial import Accelerometer as Accelerometer
from mbdlft.sensor.inertial import Gyro as Gyro
from mbdlft.sensor.port import Acceleration as Acceleration
from mbdlft.sensor.port import AngularAcceleration as AngularAcceleration
from mbdlft.sensor.port import AngularRate as AngularRate
from mbdlft.sensor.port import Position as Position
from mbdlft.sensor.port import SmallRotation as SmallRotation
from mbdlft.sensor.port import Velocity as Velocity
from mbdlft.sensor.whole import CenterOfMass as CenterOfMass
from mbdlft.sensor.whole import Momentum as Momentum
from mbdlft.sensor.wrench import JointWrench as JointWrench

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
