"""The tree of a scene: every body hangs on one joint, and the ground is the root. Its symbols.

`Symbols` are those of the coordinates and of the parameters, with the quantities in terms of them.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from typing import Any, ClassVar, NamedTuple, final

import casadi as ca
import numpy as np
from pydantic import InstanceOf

from mbdlft.base.array import Array
from mbdlft.base.description import Axis, Expected, Text, Values
from mbdlft.base.errors import SceneError, check_known, unknown_name
from mbdlft.base.expression import evaluate
from mbdlft.base.parameter import Parameter
from mbdlft.base.samples import random
from mbdlft.base.unit import Freedom, Signal
from mbdlft.multibody.body import GROUND, Body, ElasticBody, Ground
from mbdlft.multibody.body.elastic import times, times_transposed
from mbdlft.multibody.force import Tire
from mbdlft.multibody.joint import Joint, Move, Turn, coordinate_label
from mbdlft.multibody.joint.move import Deformed, Slide, shifted
from mbdlft.multibody.scene.quantities import Place, angle_at, owner_name, owners, value_at
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import Coordinate
from mbdlft.problem.equations import rows_of
from mbdlft.problem.sx.constants import FUNCTIONS, cosine_sine, in_doubles, literal, pi_times, unit_vector
from mbdlft.problem.sx.tapes import evaluate_many

_POINTS = 16  # random points at which loops are checked, beside nominal
_GROUND_PORTS = ' Declare it: [bodies.ground], kind = "ground", ports.{} = [x, y, z].'


@final
class PortFrame(Body):
    """The moving frame of a port of an elastic body, a body without mass: whose name has a dot."""

    kind: ClassVar[str] = "port"

    def wrench(self, motion: ca.SX, values: Values, inboard: ca.SX, at: Coordinate) -> ca.SX:
        return ca.SX(3, 2)


@final
class PortJoint(Joint):
    """From the origin of an elastic body to the frame of one of its ports."""

    kind: ClassVar[str] = "port"
    freedoms: ClassVar[tuple[Freedom, ...]] = ()

    body: InstanceOf[ElasticBody]
    port: Text

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        """The place in the undeformed body, then the deformation; `values` are those of the body."""
        shapes = self.body.shapes(self.port, values)
        place = self.body.port_position(self.port, values)
        pulled = partial(self.body.pulled, self.port, values, at=at)
        deformed = Deformed(partial(times, shapes), partial(times_transposed, shapes), pulled, at)
        return (*shifted(place), deformed)


@final
class PatchJoint(Joint):
    """From the center of a wheel to the patch of its tire, along the axis."""

    noun: ClassVar[str] = "load"
    kind: ClassVar[str] = "patch"
    freedoms: ClassVar[tuple[Freedom, ...]] = (
        Freedom(
            "side",
            Signal("carcass_force", "N"),
            (
                Signal("deflection", "m"),
                Signal("deflection_rate", "m/s"),
                Signal("deflection_acceleration", "m/s^2"),
            ),
            turns=False,
        ),
    )

    axis: Axis

    def own_moves(self, values: Values, at: Coordinate) -> tuple[Move, ...]:
        return (Slide(unit_vector(self.axis), at),)


@dataclass(frozen=True, slots=True)
class Link:
    """One joint with the body it carries; ports by name."""

    joint: Joint
    parent: Body
    parent_port: str
    child: Body
    child_port: str
    owner: str = field(init=False)  # whose quantities the joint has
    child_owner: str = field(init=False)
    freedoms: tuple[Freedom, ...] = field(init=False)  # coordinates of the child

    def __post_init__(self) -> None:
        item = self.parent if isinstance(self.joint, PortJoint) else self.joint
        known = {"owner": owner_name(item), "child_owner": owner_name(self.child)}
        for key, value in {**known, "freedoms": self.child.freedoms()}.items():
            object.__setattr__(self, key, value)


class Owned(NamedTuple):
    """Coordinates of a joint or of an elastic body."""

    owner: str
    name: str
    freedoms: tuple[Freedom, ...]
    kind: str  # "joint", "imposed", "motion", "elastic" or, of a tire, "patch"


def coordinate_owners(links: tuple[Link, ...]) -> list[Owned]:
    """Joints and bodies from the ground outward; each body after the joint that holds it."""
    owners = []
    for link in links:
        joint = link.joint
        if not isinstance(joint, PortJoint):
            imposed = getattr(joint, "imposed", False)
            kind = "motion" if imposed == "motion" else "imposed" if imposed else "joint"
            kind = "patch" if isinstance(joint, PatchJoint) else kind
            owners.append(Owned(link.owner, joint.name, joint.freedoms, kind))
        owners.append(Owned(link.child_owner, link.child.name, link.freedoms, "elastic"))
    return owners


class Degree(NamedTuple):
    """One coordinate of a joint or of an elastic body; `kind` is that of `Owned`."""

    owner: str
    name: str
    freedom: Freedom
    kind: str

    def measure(self, order: int) -> Signal:
        """The displacement (order 0), rate (1) or acceleration (2)."""
        return self.freedom.measures[order].of(self.name)

    @property
    def effort(self) -> Signal:
        return self.freedom.effort.of(self.name)

    def label(self, key: str) -> str:
        """Label of one of its quantities, such as ``stiffness``."""
        return coordinate_label(key, self.freedom)


def degrees(links: tuple[Link, ...]) -> list[Degree]:
    """All coordinates, in the order of `coordinate_owners`."""
    return [
        Degree(owned.owner, owned.name, freedom, owned.kind)
        for owned in coordinate_owners(links)
        for freedom in owned.freedoms
    ]


def links_of(scene: Scene) -> tuple[Link, ...]:
    """Links of a scene, each after the link that carries its parent; otherwise in scene order."""
    bodies = all_bodies(scene)
    links: dict[str, Link] = {}
    for joint in scene.joints:
        parent, parent_port = find_port(bodies, f"joint {joint.name!r}", "parent", joint.parent)
        child, child_port = find_port(bodies, f"joint {joint.name!r}", "child", joint.child)
        if child.name == GROUND:
            raise SceneError(
                f"joint {joint.name!r}: the ground cannot be a child. Exchange parent and child."
            )
        if child.name in links:
            raise SceneError(
                f"body {child.name!r} has two parents: it is the child of joints "
                f"{links[child.name].joint.name!r} and {joint.name!r}. Joints make a tree: write one of "
                "them under 'loops' instead, as the closure of a loop, or exchange parent and child of "
                "the one that should lead away from the body."
            )
        if isinstance(child, PortFrame) or (isinstance(child, ElasticBody) and child_port != "origin"):
            raise SceneError(
                f"joint {joint.name!r}, child: an elastic body is held at its origin, got "
                f"{joint.child!r}. Exchange parent and child, or describe it from its other end."
            )
        links[child.name] = Link(joint, parent, parent_port, child, child_port)
    for body in scene.bodies:
        if isinstance(body, ElasticBody):
            for port in body.elastic_ports():
                frame = bodies[name := f"{body.name}.{port}"]
                joint = PortJoint(name=name, parent=body.name, child=name, body=body, port=port)
                links[name] = Link(joint, body, "origin", frame, "origin")
    _check_sensors(scene, bodies)
    for name, tire in _patches(scene).items():
        parent, port = find_port(bodies, f"load {tire.name!r}", "child", tire.child)
        slide = PatchJoint(name=tire.name, parent=tire.child, child=name, axis=tire.axis)
        links[name] = Link(slide, parent, port, bodies[name], "origin")
    return _from_the_root(scene, links)


def _check_sensors(scene: Scene, bodies: Mapping[str, Body]) -> None:
    """What sensors name exists, also of those that are no outputs."""
    joints = {joint.name for joint in scene.joints}
    for sensor in scene.sensors:
        where = f"sensor {sensor.name!r}"
        if port := getattr(sensor, "port", ""):
            find_port(bodies, where, "port", port)
        if joint := getattr(sensor, "joint", ""):
            check_known("joint", [joint], joints, f"{where}, joint")
        check_known("body", [getattr(sensor, "frame", GROUND)], bodies, f"{where}, frame")


def _patches(scene: Scene) -> dict[str, Tire]:
    """Tires with a patch that moves, by its name."""
    return {load.patch: load for load in scene.loads if isinstance(load, Tire) and load.patch}


def all_bodies(scene: Scene) -> dict[str, Body]:
    """Bodies by name, with the ground and the frames of ports of elastic bodies and of tires."""
    frames = [
        PortFrame(name=f"{body.name}.{port}")
        for body in scene.bodies
        if isinstance(body, ElasticBody)
        for port in body.elastic_ports()
    ]
    frames += [PortFrame(name=name) for name in _patches(scene)]
    return {GROUND: Ground()} | {body.name: body for body in (*scene.bodies, *frames)}


def find_port(bodies: Mapping[str, Body], owner: str, key: str, text: str) -> tuple[Body, str]:
    """Body and port that ``body`` or ``body.port`` names; `owner` and `key` say where it stands."""
    if isinstance(bodies.get(text), PortFrame):
        return bodies[text], "origin"
    name, dot, port = text.partition(".")
    check_known("body", [name], bodies, f"{owner}, {key}")
    body = bodies[name]
    if dot and port not in body.port_names():
        declared = "" if name != GROUND else _GROUND_PORTS.format(port)
        unknown = unknown_name("port", port, body.port_names())
        raise SceneError(f"{owner}, {key}: body {name!r}: {unknown}{declared}")
    return body, port if dot else "origin"


def _from_the_root(scene: Scene, links: dict[str, Link]) -> tuple[Link, ...]:
    children: defaultdict[str, list[Link]] = defaultdict(list)
    for link in links.values():
        children[link.parent.name].append(link)
    ordered: list[Link] = []
    pending = list(children[GROUND])
    while pending:
        link = pending.pop(0)
        ordered.append(link)
        pending.extend(children[link.child.name])
    reached = {link.child.name for link in ordered}
    loose = [body.name for body in scene.bodies if body.name not in reached | {GROUND}]
    if loose:
        way = [loose[0]]
        while way[-1] in links and way[-1] not in way[:-1]:
            way.append(links[way[-1]].parent.name)
        if way[-1] in way[:-1]:
            loop = way[way.index(way[-1]) :]
            raise SceneError(
                f"scene {scene.name!r}: the joints close a loop: {' -> '.join(loop)}. Joints make a "
                "tree on the ground; write one of them under 'loops' instead, as its closure."
            )
        raise SceneError(
            f"scene {scene.name!r}: not connected to the ground: {', '.join(loose)}. Add a joint "
            "with parent = 'ground' or another connected body."
        )
    if not ordered:
        raise SceneError(f"scene {scene.name!r}: there is no joint on the ground, so nothing moves.")
    return tuple(ordered)


class Symbols:
    """The symbols of one assembly."""

    def __init__(self, scene: Scene, parameters: tuple[Parameter, ...], links: tuple[Link, ...]) -> None:
        n = len(degrees(links))
        if n == 0:
            raise SceneError(f"scene {scene.name!r}: all joints are fixed, so nothing moves.")
        self.x = ca.SX.sym("x", 2 * n)
        self.xdot = ca.SX.sym("xdot", 2 * n)
        self.q, self.v, self.a = self.x[:n], self.x[n:], self.xdot[n:]
        self.p = ca.SX.sym("p", len(parameters))
        self.cosine = ca.SX.sym("cosine", len(parameters))
        self.sine = ca.SX.sym("sine", len(parameters))
        self.parameters = parameters
        self.index = {parameter.name: k for k, parameter in enumerate(parameters)}
        self.names: dict[str, Any] = {
            name: literal(value) for name, value in scene.constant_values().items()
        }
        self.names |= {"pi": pi_times(1), "deg": pi_times(Fraction(1, 180))}
        for name, k in self.index.items():
            factor = parameters[k].factor
            self.names[name] = self.p[k] if factor == 1.0 else literal(factor) * self.p[k]

    def coordinates(self, links: tuple[Link, ...]) -> dict[str, Coordinate]:
        """Slices of q, v and a by owner, in the order of `coordinate_owners`."""
        coordinates, k = {}, 0
        for named in coordinate_owners(links):
            rows = range(k, k := k + len(named.freedoms))
            coordinates[named.owner] = Coordinate(
                rows_of(self.q, rows), rows_of(self.v, rows), rows_of(self.a, rows)
            )
        return coordinates

    def quantities(self, scene: Scene) -> dict[str, Values]:
        """Values of all quantities by owner and label; an angle is a tuple of turns."""
        return {
            owner: {
                label: self._turns(scene, Place(owner, label), expected)
                if expected.unit == "rad"
                else literal(expected.source)
                if isinstance(expected.source, float)
                else value_at(Place(owner, label), expected, self.names, literal, FUNCTIONS)
                for label, expected in quantities.items()
            }
            for owner, quantities in owners(scene)
        }

    def _turns(self, scene: Scene, place: Place, expected: Expected) -> tuple[Turn, ...]:
        angle = angle_at(scene, place, expected)
        turns: list[Turn] = []
        for name, count in angle.multiples.items():
            k, sign = self.index[name], 1.0 if count > 0 else -1.0
            turns += [Turn(self.cosine[k], sign * self.sine[k])] * abs(count)
        for tangent, count in angle.arctangents.items():
            r = evaluate(tangent, self.names, literal, FUNCTIONS)
            square = r * r
            cosine = (1 - square) / (1 + square)
            sine = (1.0 if count > 0 else -1.0) * (2 * r / (1 + square))
            turns += [Turn(cosine, sine)] * (abs(count) // 2)
        if angle.constant != 0.0:
            turns.append(Turn(*cosine_sine(angle.constant)))
        return tuple(turns)

    def angle(self, scene: Scene, place: Place, expected: Expected) -> Any:
        """The angle itself (rad), a function of p."""
        angle = angle_at(scene, place, expected)
        turns = [count * self.names[name] for name, count in angle.multiples.items()]
        turns += [
            count * ca.atan(evaluate(tangent, self.names, literal, FUNCTIONS))
            for tangent, count in angle.arctangents.items()
        ]
        return sum(turns, start=ca.SX(angle.constant))

    def is_in(self, expression: ca.SX, name: str) -> bool:
        """Whether an expression depends on a parameter."""
        k = self.index[name]
        return bool(ca.depends_on(expression, ca.vertcat(self.p[k], self.cosine[k], self.sine[k])))

    def evaluate(self, expression: ca.SX, *, ends: bool = False) -> list[Array]:
        """Values of an expression of the parameters, at nominal and at random points.

        With `ends` also where all parameters are low, and where all are high.
        """
        rounded = ca.densify(in_doubles(expression))
        function = ca.Function("values", [self.p, self.cosine, self.sine], [rounded])
        points = [np.array([parameter.nominal for parameter in self.parameters])]
        if self.parameters:
            inside = random(self.parameters, _POINTS, 0)
            points += list(np.stack([inside[p.name] for p in self.parameters], axis=1))
        if ends:
            points += [np.array([getattr(p, end) for p in self.parameters]) for end in ("low", "high")]
        values = np.array(points)
        angles = np.array([parameter.factor for parameter in self.parameters]) * values
        return list(evaluate_many(function, values, np.cos(angles), np.sin(angles))[0])
