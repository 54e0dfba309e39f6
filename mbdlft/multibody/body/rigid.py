"""The base class of all bodies, and those that do not deform: rigid bodies, point masses, the ground.

Of a rigid body, the Newton-Euler equations about the point where its inertia is given are

    force     = m (a_P + alpha x d + omega x (omega x d)),    d = r_PC
    torque_P  = J_P alpha + omega x J_P omega + m d x a_P

P is the point about which the inertia is given, C the center of mass (by default P = C and d = 0), and
r_PC (3,) the vector from P to C. Equation (3) of Kassarian et al. 2023, with its matrix tau_BP written
out: so no product m d d is formed if P = C.
"""

import abc
from collections.abc import Mapping
from typing import ClassVar, Self, final

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
    Number,
    Quantity,
    Values,
    Vector,
    vector_quantities,
)
from mbdlft.base.errors import SceneError, check_known
from mbdlft.base.unit import Freedom, Signal
from mbdlft.multibody.spatial import Coordinate, column, move_motion, move_wrench, traced

_KINDS = ("box", "cylinder", "sphere")


@final
class Shape(Description):
    """A box, a cylinder or a sphere in the axes of a body, for pictures only: no mass follows from it.

    A `box` has three sides, a `cylinder` its radius and length, a `sphere` its radius (m). The middle is
    `at` (3,), from the origin of the body (m); `axis` (3,) is that of the cylinder, or the third one of
    the box, z by default.
    """

    noun: ClassVar[str] = "shape"

    box: Direction | None = None
    cylinder: Many[Number] | None = None
    sphere: Number | None = None
    at: Direction = (0.0, 0.0, 0.0)
    axis: Axis = (0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _is_one_of_positive_size(self) -> Self:
        kinds_given = [kind for kind in _KINDS if getattr(self, kind) is not None]
        if len(kinds_given) != 1:
            raise SceneError(
                f"expected one of {', '.join(_KINDS)}, got {' and '.join(kinds_given) or 'none'}. Write, "
                "for example, shape = { box = [1.0, 0.5, 0.2] }."
            )
        size = getattr(self, kinds_given[0])
        if kinds_given == ["cylinder"] and len(size) != 2:
            raise SceneError(f"cylinder: expected a radius and a length (m), got {list(size)}.")
        if min(size if isinstance(size, tuple) else (size,)) <= 0.0:
            raise SceneError(f"{kinds_given[0]}: expected sizes above zero (m), got {size}.")
        return self


GROUND = "ground"


class Body(Description, abc.ABC):
    """A body; every concrete kind is final.

    `ports` are the positions of named points from the origin of the body, in its axes (m); `shape` is
    what pictures show of it. The equations of a body are about one of its ports, the inboard port, where
    the joint that leads to the body ends.
    """

    noun: ClassVar[str] = "body"

    kind: ClassVar[str]
    name: Name
    ports: dict[Name, Vector] = {}
    shape: Shape | None = None

    @model_validator(mode="after")
    def _names_are_free(self) -> Self:
        built_in = set(self.port_names()) - set(self.ports)
        for port in self.ports:
            if port in built_in or self.port_names().count(port) > 1:
                raise SceneError(f"every body has the port {port!r} already; use another name.")
            if "." in port:
                raise SceneError(f"the name of the port {port!r} has a dot.")
        if (self.name == GROUND) != (self.kind == GROUND):
            raise SceneError(
                f"{GROUND!r} is the name of the ground and of nothing else; got the name {self.name!r} "
                f"with the kind {self.kind!r}."
            )
        return self

    def own_quantities(self) -> dict[str, Expected]:
        """The quantities of this kind by label, without the positions of the ports."""
        return {}

    def quantities(self) -> dict[str, Expected]:
        """All quantities by label, each as it was given and with the unit that its value must have."""
        quantities = self.own_quantities()
        for port, position in self.ports.items():
            quantities |= vector_quantities(f"ports.{port}", position, "m")
        return quantities

    def port_names(self) -> tuple[str, ...]:
        """Ports that a joint can name: the origin and the declared ones."""
        return ("origin", *self.ports)

    def port_label(self, port: str) -> str | None:
        """Label of the position of a port among the quantities; None for the origin."""
        return None if port == "origin" else f"ports.{port}"

    def port_position(self, port: str, values: Values) -> ca.SX:
        """Position (3,) of a port from the origin, in the axes of the undeformed body (m)."""
        label = self.port_label(port)
        if label is None:
            return ca.SX(3, 1)
        return column([values[f"{label}.{axis}"] for axis in AXES])

    def freedoms(self) -> tuple[Freedom, ...]:
        """Names of the coordinates of an elastic body; a rigid body has no coordinates."""
        return ()

    @abc.abstractmethod
    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        """Wrench (3, 2) about the inboard port that the motion (3, 3) of this port needs.

        `values` has one SX or float per label; `inboard` (3,) is the position of the inboard port from
        the origin (m); `at` has the coordinates of an elastic body. All vectors are in the axes of the
        body.
        """

    def efforts(self, motion: ca.SX, values: Values, at: Coordinate) -> ca.SX:
        """Generalized forces (n,) that a motion (3, 3) needs on the coordinates of an elastic body."""
        return ca.SX(0, 1)

    def inputs(self) -> tuple[Signal, ...]:
        """Inputs of the body itself, such as a voltage; zero at equilibrium."""
        return ()

    def outputs(self) -> tuple[Signal, ...]:
        """Outputs of the body itself, such as a charge."""
        return ()

    def driven(self, values: Values, inputs: ca.SX) -> ca.SX:
        """Generalized forces (n,) on the coordinates of an elastic body by its inputs."""
        return ca.SX(len(self.freedoms()), 1)

    def measure(self, values: Values, inputs: ca.SX, at: Coordinate) -> ca.SX:
        """Outputs (m,) for the inputs and coordinates of the body."""
        return ca.SX(0, 1)

    def total_mass(self, values: Values) -> ca.SX:
        """Mass of the body (kg)."""
        return ca.SX(values.get("mass", 0.0))

    def first_moment(self, values: Values, inboard: ca.SX) -> ca.SX:
        """First moment of mass (3,) of the undeformed body about the inboard port (kg m).

        The first moment m c appears in the torque m c x a that an acceleration a needs; accelerations
        along x and y give all three components.
        """
        zero = ca.SX(len(self.freedoms()), 1)
        x, y = (
            self.wrench(
                ca.horzcat(ca.SX(3, 2), ca.SX.eye(3)[:, k]), values, inboard, Coordinate(zero, zero, zero)
            )
            for k in range(2)
        )
        return ca.vertcat(y[2, 1], -x[2, 1], x[1, 1])

    def unseen(self, entry: str) -> tuple[str, ...]:
        """Quantities to be given where a motion feels an entry of the inertia that is not known."""
        return (f"inertia.{entry}",)

    def physical_problem(self, values: Mapping[str, NDArray[np.float64]]) -> str | None:
        """The condition of physics that fails at one of the sampled values (samples,), or None."""
        return None


DIAGONAL = ("xx", "yy", "zz")
PRODUCTS = ("xy", "xz", "yz")
_ENTRY = (("xx", "xy", "xz"), ("xy", "yy", "yz"), ("xz", "yz", "zz"))


@final
class Inertia(Description):
    """Entries of the inertia matrix (kg m^2) about a point, in the body frame.

    The products are the entries of the matrix: ``xy`` is minus the integral of x y dm. They are zero
    when all of xx, yy and zz are given without them. An entry on which no motion of the scene depends may
    be left out. `about` is ``center_of_mass``, ``origin`` or a port. An `unchecked` inertia may be one
    that no physical body has: some files of robots have such inertias, and the equations accept them.
    """

    noun: ClassVar[str] = "inertia"

    xx: Quantity | None = None
    yy: Quantity | None = None
    zz: Quantity | None = None
    xy: Quantity | None = None
    xz: Quantity | None = None
    yz: Quantity | None = None
    about: str = "center_of_mass"
    unchecked: bool = False

    def given(self) -> dict[str, Quantity]:
        """Entries that have a value, by name."""
        entries: dict[str, Quantity] = {
            name: value for name in (*DIAGONAL, *PRODUCTS) if (value := getattr(self, name)) is not None
        }
        if all(name in entries for name in DIAGONAL):
            entries = {**dict.fromkeys(PRODUCTS, 0.0), **entries}
        return entries


@final
class RigidBody(Body):
    """Mass (kg), center of mass (m, from the origin of the body frame) and inertia (kg m^2)."""

    kind: ClassVar[str] = "rigid"
    mass: Quantity
    center_of_mass: Vector = (0.0, 0.0, 0.0)
    inertia: Inertia = Inertia()

    @model_validator(mode="after")
    def _point_of_the_inertia_exists(self) -> Self:
        check_known("port", [self.inertia.about], self.port_names(), "inertia.about")
        return self

    def own_quantities(self) -> dict[str, Expected]:
        return {
            "mass": Expected(self.mass, "kg"),
            **vector_quantities("center_of_mass", self.center_of_mass, "m"),
            **{
                f"inertia.{name}": Expected(value, "kg m^2")
                for name, value in self.inertia.given().items()
            },
        }

    def port_names(self) -> tuple[str, ...]:
        return ("origin", "center_of_mass", *self.ports)

    def port_label(self, port: str) -> str | None:
        return port if port == "center_of_mass" else super().port_label(port)

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        """Wrench (3, 2) of the Newton-Euler equations about P, moved to the inboard port."""
        entries = {
            name: values.get(f"inertia.{name}", ca.SX.sym(unseen_name(self.name, name)))
            for name in (*DIAGONAL, *PRODUCTS)
        }
        inertia = ca.reshape(column([entries[name] for row in _ENTRY for name in row]), 3, 3)
        center = self.port_position("center_of_mass", values)
        point = self.port_position(self.inertia.about, values)
        return newton_euler(motion, values["mass"], point - inboard, center - point, inertia)

    def first_moment(self, values: Values, inboard: ca.SX) -> ca.SX:
        return ca.SX((self.port_position("center_of_mass", values) - inboard) * values["mass"])


@final
class PointMass(Body):
    """A mass (kg) at the origin of the body frame."""

    kind: ClassVar[str] = "point_mass"
    mass: Quantity

    def own_quantities(self) -> dict[str, Expected]:
        return {"mass": Expected(self.mass, "kg")}

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        """Wrench (3, 2) of Newton's law, force = m a at the origin, moved to the inboard port."""
        acceleration = move_motion(motion, -inboard)[:, 2]
        return move_wrench(ca.horzcat(values["mass"] * acceleration, ca.SX(3, 1)), -inboard)


@final
class Ground(Body):
    """The ground; a scene describes it only to give it ports, from the origin of the scene frame (m)."""

    kind: ClassVar[str] = GROUND
    name: Name = GROUND

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        """Zero: the ground does not move, so it needs no wrench."""
        return ca.SX(3, 2)


@traced
def newton_euler(motion: ca.SX, mass: ca.SX, r: ca.SX, d: ca.SX, inertia: ca.SX) -> ca.SX:
    """Wrench (3, 2) about the inboard port B that its motion (3, 3) needs.

    r = r_BP and d = r_PC are vectors (3,) between B, the point P of the inertia (3, 3) and the center of
    mass C, all in the axes of the body.
    """
    omega, alpha, acceleration = ca.horzsplit(move_motion(motion, r))
    force = mass * (acceleration + ca.cross(alpha, d) + ca.cross(omega, ca.cross(omega, d)))
    torque = (
        ca.mtimes(inertia, alpha)
        + ca.cross(omega, ca.mtimes(inertia, omega))
        + ca.cross(d, mass * acceleration)
    )
    return move_wrench(ca.horzcat(force, torque), r)


def unseen_name(body: str, entry: str) -> str:
    """Name of the symbol of an inertia entry that is not given."""
    return f"{body}.inertia.{entry}"
