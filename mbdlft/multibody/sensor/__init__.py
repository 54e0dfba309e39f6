"""Kinds of sensors. A new kind is one class and one line in `KINDS`."""

from mbdlft.multibody.sensor.base import Sensor as Sensor
from mbdlft.multibody.sensor.base import Small as Small
from mbdlft.multibody.sensor.inertial import Accelerometer as Accelerometer
from mbdlft.multibody.sensor.inertial import Gyro as Gyro
from mbdlft.multibody.sensor.port import Acceleration as Acceleration
from mbdlft.multibody.sensor.port import AngularAcceleration as AngularAcceleration
from mbdlft.multibody.sensor.port import AngularRate as AngularRate
from mbdlft.multibody.sensor.port import Position as Position
from mbdlft.multibody.sensor.port import SmallRotation as SmallRotation
from mbdlft.multibody.sensor.port import Velocity as Velocity
from mbdlft.multibody.sensor.whole import CenterOfMass as CenterOfMass
from mbdlft.multibody.sensor.whole import Momentum as Momentum
from mbdlft.multibody.sensor.wrench import JointWrench as JointWrench

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
