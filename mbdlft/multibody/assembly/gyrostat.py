"""Joints that turn at a steady rate: what they carry is symmetric about the axis, and has a momentum.

A body whose inertia matrix J is symmetric about an axis e through its center of mass, J e = J_e e, and
that turns about e with the rate W beside its frame, which has the rates omega and alpha, needs the torque

    d/dt [J omega + e J_e W] = J alpha + omega x J omega + omega x e h,        h = J_e W,

in the axes of the frame, in which J is constant: that of a body that does not turn, and a gyroscopic
torque (Hughes, Spacecraft Attitude Dynamics, section 3.5: the gyrostat). So the frame of such a body
does not turn, the angle is in no equation, and the linear model does not depend on time. Otherwise it
is periodic, and refused. The decisions are made in exact numbers.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from mbdlft.base.description import Values
from mbdlft.base.errors import SceneError
from mbdlft.multibody.assembly import kinematics
from mbdlft.multibody.assembly.tree import Link, PatchJoint, Symbols, all_bodies
from mbdlft.multibody.body import PointMass, RigidBody
from mbdlft.multibody.body.rigid import DIAGONAL, PRODUCTS, unseen_name
from mbdlft.multibody.joint import Cylindrical, Fixed, Prismatic, Revolute, coordinate_label
from mbdlft.multibody.joint.kinds import AxisJoint, plane
from mbdlft.multibody.joint.move import MOMENTUM, ROTOR
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import Coordinate
from mbdlft.problem.equations import exact_symbols
from mbdlft.problem.sx.constants import modulo_prime, unit_vector

_SEED = 20261123  # of the residues that stand for parameters
_PERIODIC = "The linear model would be periodic in time"


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """A body that turns steadily."""

    joint: Revolute  # the one with the rate
    axis: ca.SX  # (3,) in the axes of the body
    off: ca.SX  # (3,) its inboard port from the axis (m)
    head: str  # the body with which it is rigid, nearest to that joint


def steady_momenta(
    scene: Scene, links: tuple[Link, ...], symbols: Symbols, values: Mapping[str, Values]
) -> dict[str, Values]:
    """Momenta of the joints of what turns at a steady rate, by owner and label; it is checked."""
    still = {
        owner: Coordinate(*(ca.SX(at.q.numel(), 1) for _ in range(3)))
        for owner, at in symbols.coordinates(links).items()
    }
    find = _Finder(scene, symbols, kinematics.place(links, all_bodies(scene), values, still))
    for link in links:
        if "rate" in values[link.owner]:
            find.turn(link)
        elif link.parent.name in find.bodies and not isinstance(link.joint, PatchJoint):
            find.carry(link)
    for link in links:
        if link.child.name in find.bodies and link.joint.freedoms:
            find.weigh(link)
    find.check_loads()
    find.check_sensors()
    find.check_loops()
    return find.momenta


class _Finder:
    """The search, from the ground outward."""

    def __init__(self, scene: Scene, symbols: Symbols, at_rest: kinematics.Placed) -> None:
        self.scene, self.symbols, self.at_rest = scene, symbols, at_rest
        self.bodies: dict[str, Turning] = {}
        self.momenta: dict[str, Values] = {}

    # what turns -----------------------------------------------------------------------------

    def turn(self, link: Link) -> None:
        where, joint = f"joint {link.joint.name!r}", link.joint
        assert isinstance(joint, Revolute)
        if link.parent.name in self.bodies:
            raise SceneError(
                f"{where}: it has a rate, and stands on body {link.parent.name!r}, which joint "
                f"{self.bodies[link.parent.name].joint.name!r} turns steadily already. Give the total "
                "rate to a joint on the body that does not turn."
            )
        self._check_body(link, joint)
        self.bodies[link.child.name] = Turning(joint, joint.direction(), ca.SX(3, 1), link.child.name)

    def carry(self, link: Link) -> None:
        """A joint on a body that turns: fixed, or along and about the same axis."""
        before, joint, name = self.bodies[link.parent.name], link.joint, link.child.name
        self._check_body(link, before.joint)
        axis, off = before.axis, before.off + self.at_rest.arms[name]
        for move in self.at_rest.moves[name]:
            axis = move.in_child_axes(axis)
            off = move.in_child_axes(off + move.offset())
        if isinstance(joint, Fixed):
            self.bodies[name] = Turning(before.joint, axis, off, before.head)
            return
        if not isinstance(joint, Revolute | Prismatic | Cylindrical) or not self._vanishes(
            ca.cross(joint.direction(), axis), ca.cross(joint.direction(), off)
        ):
            raise SceneError(
                f"joint {joint.name!r}: it moves on body {link.parent.name!r}, which joint "
                f"{before.joint.name!r} turns at a steady rate, and its axis is not the same line. "
                f"{_PERIODIC}. What turns may be held by joints 'fixed', 'revolute', 'prismatic' and "
                "'cylindrical' along and about that axis; a gimbal stands before the joint with the rate."
                " If all turns with it about an axis of the ground, give the rate to the scene (spin)."
            )
        self.bodies[name] = Turning(before.joint, joint.direction(), off, name)

    def _check_body(self, link: Link, turning: Revolute) -> None:
        if not isinstance(link.child, RigidBody | PointMass):
            raise SceneError(
                f"body {link.child.name!r}: a joint turns it at a steady rate, and it is of the kind "
                f"{link.child.kind!r}: only 'rigid' and 'point_mass' bodies can be known to be symmetric "
                f"about the axis. {_PERIODIC}. A round shaft without damping inside bends "
                f"alike where it does not turn: leave the rate out of joint {turning.name!r}, and give "
                f"it to the joint of each disc on it: kind = 'revolute', axis = {list(turning.axis)}, "
                f"rate = {turning.rate!r}. Its twist is a revolute joint with stiffness about the axis."
            )

    # symmetry and momentum ------------------------------------------------------------------

    def weigh(self, link: Link) -> None:
        """Momenta of what a joint moves and of its actuator, along the axis of the joint."""
        joint, values = link.joint, self.at_rest.values[link.owner]
        assert isinstance(joint, AxisJoint)
        axis, turning = joint.direction(), self.bodies[link.child.name]
        J, first = self._inertia(link)
        self._check_symmetry(link, axis, J, first)
        rate = self.at_rest.values[f"joint {turning.joint.name!r}"]["rate"]
        # a joint along the same axis may count it the other way
        steady_axis = turning.axis
        if link.parent.name in self.bodies:
            steady_axis = self.bodies[link.parent.name].axis
            for move in self.at_rest.moves[link.child.name]:
                steady_axis = move.in_child_axes(steady_axis)
        along = float(np.sign(self.symbols.evaluate(ca.dot(axis, steady_axis))[0][0, 0]))
        about = ca.dot(axis, ca.mtimes(J, axis))
        actuator = ca.SX(0)
        for freedom in joint.freedoms:
            inertia = values.get(coordinate_label("actuator_inertia", freedom), 0.0)
            if freedom.turns and not ca.SX(inertia).is_zero():
                ratio = values.get("gear_ratio", 1.0) if "rate" in values else 1.0
                actuator = ca.SX(ratio * inertia)
        sign = 1.0 if "rate" in values else along
        self.momenta[link.owner] = {
            MOMENTUM: sign * rate * about,
            ROTOR: sign * rate * actuator if not actuator.is_zero() else 0.0,
        }

    def _inertia(self, link: Link) -> tuple[ca.SX, ca.SX]:
        """Inertia (3, 3) about the inboard port of what is rigid with a child, and the matrix (3, 3) of
        its first moment, with which it turns an angular acceleration into a force."""
        now, name, parent = self.at_rest, link.child.name, link.parent.name
        rigid = [
            other
            for other in now.links
            if isinstance(other.joint, Fixed)
            and other.parent.name in self.bodies
            and self.bodies[other.child.name].head == name
        ]
        alone = replace(
            now, links=(link, *rigid), moves={**now.moves, name: ()}, arms={**now.arms, name: ca.SX(3, 1)}
        )
        alpha = ca.SX.sym("alpha", 3)
        turned = ca.horzcat(ca.SX(3, 1), alpha, ca.SX(3, 1))
        moving = kinematics.motions(alone, ca.SX(3, 3), {parent: turned})
        needed = {**kinematics.inertial_wrenches(alone, moving), parent: ca.SX(3, 2)}
        wrench = kinematics.pass_inward(alone, moving, needed).joints[name]
        return ca.jacobian(wrench[:, 1], alpha), ca.jacobian(wrench[:, 0], alpha)

    def _check_symmetry(self, link: Link, axis: ca.SX, J: ca.SX, first: ca.SX) -> None:
        joint = link.joint
        assert isinstance(joint, AxisJoint)
        x, y = plane(joint.axis)
        tilted = [ca.dot(e, ca.mtimes(J, axis)) for e in (x, y)]
        crossed = ca.dot(x, ca.mtimes(J, y))
        moments = [ca.dot(e, ca.mtimes(J, e)) for e in (x, y)]
        asymmetries = {
            "first moment about the axis (kg m)": ca.mtimes(first, axis),
            "products of inertia with the axis (kg m^2)": ca.vertcat(*tilted),
            "product of inertia across the axis (kg m^2)": crossed,
            "difference of the moments across the axis (kg m^2)": moments[0] - moments[1],
        }
        wrong = [
            f"{what} {self._size(ca.SX(asymmetry))}"
            for what, asymmetry in asymmetries.items()
            if not self._vanishes(asymmetry)
        ]
        if wrong:
            turning = self.bodies[link.child.name].joint
            raise SceneError(
                f"joint {turning.name!r}: it turns at a steady rate, and what joint {joint.name!r} "
                f"carries is not symmetric about the axis: {'; '.join(wrong)}, where 0 is needed for all "
                f"values of the parameters. {_PERIODIC}. Make it symmetric (center of mass on the axis, "
                "equal moments across it, no products), add what balances it by fixed joints, and enter "
                "an imbalance as a load (mbdlft.imbalance)."
            )

    def _size(self, expression: ca.SX) -> str:
        """The largest value of an expression, in words."""
        unseen = [symbol for symbol in ca.symvar(expression) if ".inertia." in symbol.name()]
        if unseen:
            return f"unknown without {', '.join(sorted({symbol.name() for symbol in unseen}))}"
        return f"{max(float(np.max(np.abs(value))) for value in self.symbols.evaluate(expression)):.3g}"

    def _vanishes(self, *expressions: ca.SX) -> bool:
        """Whether expressions are zero for all values of the parameters.

        Entries of inertias that are not given are taken as those of a sphere: they are asked for where
        a motion feels them.
        """
        column = ca.SX(ca.densify(ca.vertcat(*(ca.vec(expression) for expression in expressions))))
        for body in self.scene.bodies:
            for entries, value in ((DIAGONAL, ca.SX.sym("moment")), (PRODUCTS, ca.SX(0))):
                names = {unseen_name(body.name, entry) for entry in entries}
                for symbol in [s for s in ca.symvar(column) if s.name() in names]:
                    column = ca.substitute(column, symbol, value)
        _, p, cosine, sine = exact_symbols(self.symbols.parameters)
        symbols = ca.vertcat(self.symbols.p, self.symbols.cosine, self.symbols.sine)
        at = ca.densify(ca.vertcat(p, cosine, sine))
        return not np.any(modulo_prime(ca.substitute(column, symbols, at), _SEED).residues != 0)

    # what is held by it ---------------------------------------------------------------------

    def _is_on_axis(self, body: str, port: str) -> bool:
        turning = self.bodies[body]
        return self._vanishes(
            ca.cross(turning.axis, turning.off + kinematics.port_arm(self.at_rest, body, port))
        )

    def _turning(self, *ports: str) -> Iterator[tuple[str, Turning, str, bool]]:
        """Ports at which something turns: what it is, the name of its body, whether it is on the axis."""
        for port in ports:
            body, _, name = port.partition(".")
            if body in self.bodies:
                yield port, self.bodies[body], body, self._is_on_axis(body, name or "origin")

    def check_loads(self) -> None:
        """Loads act along the axis, or are fixed to the scene and act at the axis."""
        for load in self.scene.loads:
            for port, turning, body, on_axis in self._turning(*load.ports().values()):
                turner = turning.joint.name
                where = f"load {load.name!r}: it acts on body {body!r}, which joint {turner!r}"
                if load.kind != "torque" and not on_axis:
                    raise SceneError(
                        f"{where} turns at a steady rate, at {port!r}, which is not on the axis. "
                        f"{_PERIODIC}. Move the port to the axis, or the load to a body that does "
                        "not turn."
                    )
                direction = getattr(load, "direction", None)
                turns = port == load.ports().get("parent", port)  # a strut turns with its parent
                if direction is None or getattr(load, "frame", "") == "ground" or not turns:
                    continue
                if not self._vanishes(ca.cross(turning.axis, unit_vector(direction))):
                    raise SceneError(
                        f"{where} turns at a steady rate, in a direction that turns with the body. "
                        f"{_PERIODIC}. Give a direction along the axis, or frame = 'ground'."
                    )

    def check_sensors(self) -> None:
        """Sensors are where nothing turns, or see the displacement of a point on the axis."""
        for sensor in self.scene.sensors:
            frame = getattr(sensor, "frame", "ground")
            name = getattr(sensor, "joint", "")
            inside = any(
                link.joint.name == name and link.parent.name in self.bodies for link in self.at_rest.links
            )
            inner = f"joint {name!r} " if inside else ""  # between bodies that turn
            if frame in self.bodies or inner:
                raise SceneError(
                    f"sensor {sensor.name!r}: {inner or f'frame {frame!r} '}turns at a steady rate. "
                    f"{_PERIODIC}. Measure what does not turn: another frame, or the joint with the rate."
                )
            displaced = sensor.kind in ("position", "velocity", "acceleration")
            for _, turning, body, on_axis in self._turning(getattr(sensor, "port", frame)):
                if displaced and on_axis:
                    continue
                raise SceneError(
                    f"sensor {sensor.name!r}: body {body!r} is turned at a steady rate by joint "
                    f"{turning.joint.name!r}. {_PERIODIC}. A position, velocity or acceleration of a "
                    f"port on the axis can be measured; the rate is {turning.joint.name}.rate, and other "
                    "sensors stand on the body that carries the joint."
                )

    def check_loops(self) -> None:
        """Loops hold points on the axis, and directions across it."""
        for loop in self.scene.loops:
            for port, turning, _, on_axis in self._turning(loop.parent, loop.child):
                free = loop.kind == "spherical"
                if loop.kind in ("revolute", "cylindrical") and loop.axis is not None:
                    axis = unit_vector(loop.axis)
                    if port == loop.parent:
                        axis = loop.in_parent_axes(axis, self.at_rest.values[owner_name(loop)])
                    free = self._vanishes(ca.cross(turning.axis, axis))
                if not (free and on_axis):
                    raise SceneError(
                        f"loop {loop.name!r}: {port!r} is on a body that joint {turning.joint.name!r} "
                        f"turns at a steady rate. {_PERIODIC}. A loop may hold it at a port on the axis "
                        "by the kinds 'spherical', or 'revolute' and 'cylindrical' about the axis: a "
                        "second bearing."
                    )
