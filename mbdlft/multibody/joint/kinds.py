"""The kinds of joints: two ports, an orientation, coordinates, and moves.

A joint leads from the frame p of its parent's port to the frame c of its child's port, by R_pc and r_pc
(see `mbdlft.multibody.spatial`). At zero position, and without an `orientation`, R_pc = 1 and r_pc = 0.
The coordinates of a joint are displacements from the equilibrium.

Of a prismatic and of a revolute joint,

    effort = axis . f_c + m qddot + stiffness q + damping qdot
    effort = axis . tau_c + J axis . alpha_c + J_r qddot + stiffness q + damping qdot

f_c is the force and tau_c the torque that the child needs, m the mass that the actuator moves along the
axis relative to the parent (a reflected inertia), and J the inertia of the actuator, which turns with the
child: Kassarian et al. 2023, equation (7). An actuator with a gear is a rotor that turns `gear_ratio`
times as far as the child, relative to the parent: see `Hinge`. With a high gear only the reflected
inertia J_r is felt.

A spherical joint turns about a point by a small rotation vector q (3,), with

    effort = tau_c + J vdot + stiffness q + damping v

All vectors are in the axes of the child: its relative angular velocity v, the torque tau_c that it needs,
and the inertia J of the actuators, one for each axis.
"""

import abc
from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import chain
from typing import ClassVar, Literal, Self, final

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from mbdlft.base.description import (
    AXES,
    Axis,
    Description,
    Direction,
    Expected,
    Many,
    Name,
    Quantity,
    Text,
    Values,
    Vector,
)
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Freedom, Signal
from mbdlft.exact.numbers import decimal
from mbdlft.multibody.joint.move import ROTOR, Ball, Hinge, Move, Slide, Turned, shifted, turned
from mbdlft.multibody.spatial import Coordinate
from mbdlft.problem.sx.constants import unit_vector


def turning(label: str = "", suffix: str = "", *, of: str = "angle") -> Freedom:
    """A coordinate that is an angle (rad), or a component of a small rotation vector."""
    second = "angular_acceleration" if label else "acceleration"
    effort = Signal(f"torque{suffix}", "N m")
    return Freedom(label, effort, _measures((of, "rate", second), suffix, "rad"), turns=True)


def sliding(label: str = "", suffix: str = "") -> Freedom:
    """A coordinate that is a displacement (m)."""
    names = ("position", "velocity", "acceleration")
    return Freedom(label, Signal(f"force{suffix}", "N"), _measures(names, suffix, "m"), turns=False)


def _measures(names: Sequence[str], suffix: str, unit: str) -> tuple[Signal, Signal, Signal]:
    """Signals of a displacement, its rate and its acceleration."""
    q, v, a = (f"{name}{suffix}" for name in names)
    return Signal(q, unit), Signal(v, f"{unit}/s"), Signal(a, f"{unit}/s^2")


@final
class Rotation(Description):
    """A rotation by `angle` (rad) about `axis`, whose components are in the axes before this rotation."""

    noun: ClassVar[str] = "orientation"

    axis: Axis
    angle: Quantity


def angles_of(orientation: Sequence[Rotation]) -> dict[str, Expected]:
    """The angles of rotations by label (rad)."""
    return {f"orientation.{k}": Expected(r.angle, "rad") for k, r in enumerate(orientation)}


def turns_of(orientation: Sequence[Rotation], values: Values) -> tuple[Turned, ...]:
    """The moves of rotations."""
    moves = (
        turned(unit_vector(rotation.axis), values[f"orientation.{k}"])
        for k, rotation in enumerate(orientation)
    )
    return tuple(chain.from_iterable(moves))


class Joint(Description, abc.ABC):
    """A joint; every concrete kind is final. `parent` and `child` are ``body`` or ``body.port``.

    `orientation` is a sequence of rotations from the axes of the parent's port to those of the joint.
    """

    noun: ClassVar[str] = "joint"

    kind: ClassVar[str]
    freedoms: ClassVar[tuple[Freedom, ...]]

    name: Name
    parent: Text
    child: Text
    orientation: Many[Rotation] = ()

    def own_quantities(self) -> dict[str, Expected]:
        """The quantities of this kind by label, without those of the orientation."""
        return {}

    def quantities(self) -> dict[str, Expected]:
        """All quantities by label, each as it was given and with the unit that its value must have."""
        return angles_of(self.orientation) | self.own_quantities()

    def moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        """The moves that make the joint, in their order from the parent's port to the child's.

        `values` has one SX or float per label, `at` the coordinates of the joint.
        """
        return (*turns_of(self.orientation, values), *self.own_moves(values, at))

    @abc.abstractmethod
    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        """The moves of the joint that follow its orientation."""

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        """The condition of physics that fails at one of the sampled values (samples,), or None."""
        return None


class MovingJoint(Joint, abc.ABC):
    """A joint with coordinates.

    A kind declares `position`, `stiffness`, `damping`, `actuator_inertia` and `preload`: each is a
    quantity if the kind has one coordinate, and a tuple of quantities, one for each coordinate, if it
    has several. `preload` is the effort at equilibrium; where it is left out, the trim solves for it.
    The model has the effort of a joint as input; for an `imposed` joint, its acceleration, and the motion
    has states. With `imposed` = ``motion``, position, rate and acceleration are three inputs, and the
    motion has no state.
    """

    imposed: bool | Literal["motion"] = False

    @model_validator(mode="after")
    def _imposed_has_no_preload(self) -> Self:
        preload = getattr(self, "preload", None)
        if self.imposed and preload is not None and any(entry != 0 for entry in _entries(preload)):
            raise SceneError(
                f"an imposed joint takes the effort that its acceleration needs, so it has no preload, "
                f"got {preload!r}. Leave out preload or imposed."
            )
        return self

    def own_quantities(self) -> dict[str, Expected]:
        quantities: dict[str, Expected] = {}
        for key, (turn, slide) in _UNITS.items():
            sources = getattr(self, key, None)
            if sources is None or (key == "preload" and self.imposed):
                continue
            for freedom, value in zip(self.freedoms, _entries(sources), strict=False):
                unit = turn if freedom.turns else slide
                quantities[coordinate_label(key, freedom)] = Expected(value, unit)
        return quantities


_UNITS = {
    "position": ("rad", "m"),
    "stiffness": ("N m/rad", "N/m"),
    "damping": ("N m s/rad", "N s/m"),
    "actuator_inertia": ("kg m^2", "kg"),
    "preload": ("N m", "N"),
}


def _entries(sources: Quantity | tuple[Quantity, ...]) -> tuple[Quantity, ...]:
    """The quantities of each coordinate."""
    return sources if isinstance(sources, tuple) else (sources,)


def coordinate_label(key: str, freedom: Freedom) -> str:
    """Label of a quantity of one coordinate: ``stiffness``, or ``stiffness.x``."""
    return f"{key}.{freedom.label}" if freedom.label else key


def with_entry(joint: Joint, key: str, freedom: Freedom, value: Quantity) -> Joint:
    """The joint with a new value of one quantity of one coordinate."""
    if len(joint.freedoms) == 1:
        return joint.model_copy(update={key: value})
    entries = list(getattr(joint, key))
    entries[joint.freedoms.index(freedom)] = value
    return joint.model_copy(update={key: tuple(entries)})


def _hinge(axis: ca.SX, at: Coordinate, values: Values, label: str = "") -> tuple[Move, ...]:
    """The moves of a coordinate that turns about `axis` (3,): its position, then the displacement."""
    return (
        *turned(axis, values[f"position{label}"]),
        Hinge(
            axis,
            at,
            values[f"actuator_inertia{label}"],
            values.get("gear_ratio", 1.0),
            momentum=values.get(ROTOR, 0.0),
            steady=ROTOR in values,
            reflected=values.get("reflected_inertia", 0.0),
        ),
    )


def _slide(axis: ca.SX, at: Coordinate, values: Values, label: str = "") -> tuple[Move, ...]:
    """The moves of a coordinate along `axis` (3,): its position, then the displacement."""
    return (
        *shifted(axis * values[f"position{label}"]),
        Slide(axis, at, values[f"actuator_inertia{label}"]),
    )


Pair = tuple[Quantity, Quantity]
Triple = tuple[Quantity, Quantity, Quantity]
Six = tuple[Quantity, Quantity, Quantity, Quantity, Quantity, Quantity]
_NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


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
        return _slide(self.direction(), at, values)


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
        return None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        return _hinge(self.direction(), at, values)


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
            *_slide(axis, at.part(0), values, ".position"),
            *_hinge(axis, at.part(1), values, ".angle"),
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
    freedoms: ClassVar[tuple[Freedom, ...]] = (sliding("x", ".x"), sliding("y", ".y"), turning("angle"))

    axis: Axis = (0.0, 0.0, 1.0)
    position: Triple = (0.0, 0.0, 0.0)
    stiffness: Triple = (0.0, 0.0, 0.0)
    damping: Triple = (0.0, 0.0, 0.0)
    actuator_inertia: Triple = (0.0, 0.0, 0.0)
    preload: Triple | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        x, y = plane(self.axis)
        return (
            *_slide(ca.sparsify(x), at.part(0), values, ".x"),
            *_slide(ca.sparsify(y), at.part(1), values, ".y"),
            *_hinge(self.direction(), at.part(2), values, ".angle"),
        )


def plane(normal: Direction) -> tuple[ca.SX, ca.SX]:
    """Two unit vectors x and y (3,) across `normal`; x, y and the normal are right-handed."""
    n = [decimal(entry) for entry in normal]
    along = [k for k in range(3) if n[k]]
    if len(along) == 1:
        x = ca.SX.eye(3)[:, (along[0] + 1) % 3]
    else:
        k = min(range(3), key=lambda k: abs(n[k]))
        square = sum((entry * entry for entry in n), Fraction(0))
        x = unit_vector([(square if j == k else 0) - n[k] * n[j] for j in range(3)])
    return x, ca.sparsify(ca.cross(unit_vector(normal), x))


@final
class Universal(MovingJoint):
    """The child turns about `axis1`, and about `axis2`, which the first rotation turns.

    Each quantity is a pair: the first entry is for `axis1`, the second for `axis2`.
    """

    kind: ClassVar[str] = "universal"
    freedoms: ClassVar[tuple[Freedom, ...]] = (turning("1", ".1"), turning("2", ".2"))

    axis1: Axis = (1.0, 0.0, 0.0)
    axis2: Axis = (0.0, 1.0, 0.0)
    position: Pair = (0.0, 0.0)
    stiffness: Pair = (0.0, 0.0)
    damping: Pair = (0.0, 0.0)
    actuator_inertia: Pair = (0.0, 0.0)
    preload: Pair | None = None

    @model_validator(mode="after")
    def _axes_are_two(self) -> Self:
        if not np.any(np.cross(self.axis1, self.axis2)):
            raise SceneError(
                f"axis1 {list(self.axis1)} and axis2 {list(self.axis2)} are parallel, which is "
                "one rotation. Give two directions, or use a revolute joint."
            )
        return self

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        return (
            *_hinge(unit_vector(self.axis1), at.part(0), values, ".1"),
            *_hinge(unit_vector(self.axis2), at.part(1), values, ".2"),
        )


@final
class Spherical(MovingJoint):
    """The child turns about the point where the ports meet; `orientation` is that of the equilibrium.

    Each quantity has three entries, for the axes x, y and z of the child.
    """

    kind: ClassVar[str] = "spherical"
    freedoms: ClassVar[tuple[Freedom, ...]] = tuple(
        turning(axis, f".{axis}", of="rotation") for axis in AXES
    )

    stiffness: Triple = (0.0, 0.0, 0.0)
    damping: Triple = (0.0, 0.0, 0.0)
    actuator_inertia: Triple = (0.0, 0.0, 0.0)
    preload: Triple | None = None

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        inertia = ca.SX(ca.vertcat(*(values[f"actuator_inertia.{axis}"] for axis in AXES)))
        return (Ball(at, inertia),)


@final
class Free(MovingJoint):
    """The child moves freely: three translations, then a rotation by a small rotation vector.

    The translations (m) are along the axes of the parent's port; the components of the rotation vector
    (rad) are in the axes of the child. `position` (m) and `orientation` are those of the equilibrium.
    Each other quantity has six entries: x, y, z of the translation, then x, y, z of the rotation. Nothing
    holds a free body, so its `preload` is zero unless it is given.
    """

    kind: ClassVar[str] = "free"
    freedoms: ClassVar[tuple[Freedom, ...]] = (
        *(sliding(axis, f".{axis}") for axis in AXES),
        *(turning(f"r{axis}", f".{axis}", of="rotation") for axis in AXES),
    )

    position: Vector = (0.0, 0.0, 0.0)
    stiffness: Six = _NONE
    damping: Six = _NONE
    preload: Six = _NONE

    def moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        """The moves of the joint; the translations, in the axes of the parent's port, come first."""
        place = ca.SX(ca.vertcat(*(values[f"position.{axis}"] for axis in AXES)))
        slides = (Slide(ca.SX.eye(3)[:, k], at.part(k)) for k in range(3))
        turned = Joint.moves(self, values, at)
        return (*shifted(place), *slides, *turned)

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        return (Ball(at.part(slice(3, 6)), ca.SX.zeros(3)),)
