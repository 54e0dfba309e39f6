"""Joints along and about one axis: fixed, prismatic, revolute, cylindrical, planar.

Of a prismatic and of a revolute joint,

    effort = axis . f_c + m qddot + stiffness q + damping qdot
    effort = axis . tau_c + J axis . alpha_c + J_r qddot + stiffness q + damping qdot

f_c is the force and tau_c the torque that the child needs, m the mass that the actuator moves along the
axis relative to the parent (a reflected inertia), and J the inertia of the actuator, which turns with the
child: Kassarian et al. 2023, equation (7). An actuator with a gear is a rotor that turns `gear_ratio`
times as far as the child, relative to the parent: see `Hinge`. With a high gear only the reflected
inertia J_r is felt.
"""

import abc
from collections.abc import Mapping
from fractions import Fraction
from typing import ClassVar, Self, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from mbdlft.base.description import Axis, Direction, Expected, Quantity, Values
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Freedom
from mbdlft.exact.numbers import decimal
from mbdlft.multibody.joint.base import Joint, MovingJoint, sliding, turning, unit_vector
from mbdlft.multibody.joint.move import Hinge, Move, Slide, shifted, steady_hinge, turned
from mbdlft.multibody.spatial import Coordinate
from mbdlft.problem.sx import constants

Pair = tuple[Quantity, Quantity]
Triple = tuple[Quantity, Quantity, Quantity]


class AxisJoint(Joint, abc.ABC):
    """A joint about or along one axis.

    The components of `axis` are the same in the frames of both ports, as the joint turns about it or
    does not turn; they are taken after the `orientation`.
    """

    axis: Axis

    def direction(self) -> ca.SX:
        """The axis with unit length (3,); a zero component is a structural zero of the SX."""
        return unit_vector(self.axis)


@final
class Fixed(AxisJoint):
    """The child's port is clamped on the parent's port, turned by `position` (rad) about `axis`."""

    kind: ClassVar[str] = "fixed"
    freedoms: ClassVar[tuple[Freedom, ...]] = ()

    axis: Axis = (1.0, 0.0, 0.0)
    position: Quantity = 0.0

    def own_quantities(self) -> dict[str, Expected]:
        return {"position": Expected(self.position, "rad")}

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        return turned(self.direction(), values["position"])


@final
class Prismatic(AxisJoint, MovingJoint):
    """The child moves along `axis`.

    Units: `position` m, `stiffness` N/m, `damping` N s/m, `actuator_inertia` kg, `preload` N.
    """

    kind: ClassVar[str] = "prismatic"
    freedoms: ClassVar[tuple[Freedom, ...]] = (sliding(),)

    position: Quantity = 0.0
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    actuator_inertia: Quantity = 0.0
    preload: Quantity | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        axis = self.direction()
        return (
            *shifted(axis * values["position"]),
            Slide(axis, at.part(0), values["actuator_inertia"]),
        )


@final
class Revolute(AxisJoint, MovingJoint):
    """The child turns about `axis`.

    Units: `position` rad, `stiffness` N m/rad, `damping` N m s/rad, `actuator_inertia` kg m^2, `preload`
    N m. `gear_ratio` is the angle of the actuator over that of the joint. `actuator_inertia` is the
    inertia of the rotor itself, in front of the gear; the effort is the torque behind the gear.
    `reflected_inertia` (kg m^2) is felt by the joint alone, as that of a rotor behind a high gear.

    With a `rate` (rad/s) the joint turns steadily at equilibrium: what it carries must be symmetric about
    its axis, and the model has the deviation from this rate, and no angle unless an output asks for it.
    """

    kind: ClassVar[str] = "revolute"
    freedoms: ClassVar[tuple[Freedom, ...]] = (turning(),)

    position: Quantity = 0.0
    stiffness: Quantity = 0.0
    damping: Quantity = 0.0
    actuator_inertia: Quantity = 0.0
    gear_ratio: Quantity = 1.0
    reflected_inertia: Quantity = 0.0
    preload: Quantity | None = None
    rate: Quantity | None = None

    @model_validator(mode="after")
    def _turns_on(self) -> Self:
        if self.rate is None:
            return self
        for key, reason in (("position", "its angle grows on"), ("stiffness", "a spring winds up")):
            if getattr(self, key) != 0.0:
                raise SceneError(
                    f"{key}: a joint that turns at a steady rate has none, because {reason}; got "
                    f"{getattr(self, key)!r}. Leave out {key} or rate."
                )
        return self

    def own_quantities(self) -> dict[str, Expected]:
        quantities = super().own_quantities()
        if self.rate is not None:
            quantities["rate"] = Expected(self.rate, "rad/s")
        if self.gear_ratio != 1.0:  # without a gear nothing is multiplied
            quantities["gear_ratio"] = Expected(self.gear_ratio, "1")
        if self.reflected_inertia != 0.0:
            quantities["reflected_inertia"] = Expected(self.reflected_inertia, "kg m^2")
        return quantities

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        ratio = values.get("gear_ratio", np.ones(1))
        if np.min(ratio) <= 0.0 <= np.max(ratio):
            return (
                f"the gear_ratio vanishes in the range [{np.min(ratio):g}, {np.max(ratio):g}]: the "
                "actuator would not turn. A negative one turns it the other way."
            )
        return super().physical_problem(values)

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        axis = self.direction()
        return (
            *turned(axis, values["position"]),
            steady_hinge(
                Hinge(
                    axis,
                    at.part(0),
                    values["actuator_inertia"],
                    values.get("gear_ratio", 1.0),
                    reflected=values.get("reflected_inertia", 0.0),
                ),
                values,
            ),
        )


@final
class Cylindrical(AxisJoint, MovingJoint):
    """The child moves along `axis` (m) and then turns about it (rad).

    Each quantity is a pair: the first entry is for the translation, the second for the rotation.
    """

    kind: ClassVar[str] = "cylindrical"
    freedoms: ClassVar[tuple[Freedom, ...]] = (sliding("position"), turning("angle"))

    position: Pair = (0.0, 0.0)
    stiffness: Pair = (0.0, 0.0)
    damping: Pair = (0.0, 0.0)
    actuator_inertia: Pair = (0.0, 0.0)
    preload: Pair | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        axis = self.direction()
        return (
            *shifted(axis * values["position.position"]),
            Slide(axis, at.part(0), values["actuator_inertia.position"]),
            *turned(axis, values["position.angle"]),
            steady_hinge(Hinge(axis, at.part(1), values["actuator_inertia.angle"]), values),
        )


@final
class Planar(AxisJoint, MovingJoint):
    """The child moves in the plane with the normal `axis`.

    It moves along the directions x and y of the plane (m), then turns about the normal (rad). x, y and
    the normal are right-handed. If the normal is a coordinate axis, x and y are the two coordinate axes
    that follow it (y and z for the normal x). Otherwise x is the direction of the plane nearest to a
    coordinate axis; if two are equally near, it is the one for the first coordinate axis.
    """

    kind: ClassVar[str] = "planar"
    freedoms: ClassVar[tuple[Freedom, ...]] = (
        sliding("x", ".x"),
        sliding("y", ".y"),
        turning("angle"),
    )

    axis: Axis = (0.0, 0.0, 1.0)
    position: Triple = (0.0, 0.0, 0.0)
    stiffness: Triple = (0.0, 0.0, 0.0)
    damping: Triple = (0.0, 0.0, 0.0)
    actuator_inertia: Triple = (0.0, 0.0, 0.0)
    preload: Triple | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        moves: tuple[Move, ...] = ()
        for k, (label, direction) in enumerate(zip("xy", plane(self.axis), strict=True)):
            axis = ca.sparsify(direction)
            moves += shifted(axis * values[f"position.{label}"])
            moves += (Slide(axis, at.part(k), values[f"actuator_inertia.{label}"]),)
        normal = self.direction()
        moves += turned(normal, values["position.angle"])
        return (*moves, Hinge(normal, at.part(2), values["actuator_inertia.angle"]))


def plane(normal: Direction) -> tuple[ca.SX, ca.SX]:
    """Two unit vectors x and y (3,) across `normal`; x, y and the normal are right-handed."""
    n = [decimal(entry) for entry in normal]
    along = [k for k in range(3) if n[k]]
    if len(along) == 1:
        x = ca.SX.eye(3)[:, (along[0] + 1) % 3]
    else:
        k = min(range(3), key=lambda k: abs(n[k]))
        square = sum((entry * entry for entry in n), Fraction(0))
        x = constants.unit_vector([(square if j == k else 0) - n[k] * n[j] for j in range(3)])
    return x, ca.sparsify(ca.cross(unit_vector(normal), x))
