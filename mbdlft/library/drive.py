"""A solar array drive: motor, gear and the elastic shaft behind it, as pieces of a scene."""

from collections.abc import Sequence
from typing import NamedTuple

from mbdlft.multibody.body import Inertia, RigidBody
from mbdlft.multibody.joint import Revolute, Rotation


class ArrayDrive(NamedTuple):
    """Pieces of a scene: one body without mass, and the joints before and behind it."""

    body: RigidBody
    motor: Revolute
    shaft: Revolute


def array_drive(
    name: str,
    parent: str,
    child: str,
    axis: Sequence[float],
    *,
    rotor_inertia: float | str,
    gear_ratio: float | str,
    stiffness: float | str,
    damping: float | str = 0.0,
    friction: float | str = 0.0,
    position: float | str = 0.0,
    orientation: tuple[Rotation, ...] = (),
) -> ArrayDrive:
    """A motor on `parent`, a gear without backlash, and a shaft with stiffness that carries `child`.

    With q the angle behind the gear and e the twist of the shaft,

        J n (alpha_parent + n qddot) = torque of the motor behind the gear + k e + d edot - c qdot

    Parameters
    ----------
    name : str
        Of the joint of the motor; its effort ``NAME.torque`` (N m) acts behind the gear and is n times
        that of the motor itself. The shaft is ``NAME_shaft``, the body between them ``NAME_gear``.
    parent, child : str
        Ports, ``body`` or ``body.port``.
    axis : three numbers
    rotor_inertia : number or expression, J of the rotor about the axis (kg m^2)
    gear_ratio : number or expression, n: turns of the rotor for one of the array
    stiffness, damping : numbers or expressions, k (N m/rad) and d (N m s/rad) of the shaft and the gear
    friction : number or expression, viscous, c (N m s/rad) behind the gear
    position : number or expression (rad), of the array; it may be an `Angle`
    orientation : rotations before the joint, as of any joint

    Returns
    -------
    ArrayDrive
        `body`, `motor`, `shaft`: for the bodies and joints of a `Scene`.

    Raises
    ------
    SceneError
        As of the joints.
    """
    between = f"{name}_gear"
    return ArrayDrive(
        body=RigidBody(name=between, mass=0.0, inertia=Inertia(xx=0.0, yy=0.0, zz=0.0)),
        motor=Revolute(
            name=name,
            parent=parent,
            child=between,
            axis=axis,
            orientation=orientation,
            position=position,
            damping=friction,
            actuator_inertia=rotor_inertia,
            gear_ratio=gear_ratio,
        ),
        shaft=Revolute(
            name=f"{name}_shaft",
            parent=between,
            child=child,
            axis=axis,
            stiffness=stiffness,
            damping=damping,
        ),
    )
