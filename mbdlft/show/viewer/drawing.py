"""What is drawn of a scene: items of a tree, with shapes whose points and directions come from a tape.

An item has a `group`, a `name`, a `kind`, the `lines` that the file says of it, and `shapes`. A shape has
a `type`, the numbers of its vectors and a `layer`, which a page can hide.

Bodies have the shapes of the scene, or rigid ones a solid with their mass and inertia at nominal.
A box of the sides a, b, c has J_x = m (b^2 + c^2) / 12, so a^2 = 6 (J_y + J_z - J_x) / m; a cylinder of
the radius r and the length h along z has J_z = m r^2 / 2 and J_x = J_y = m (3 r^2 + h^2) / 12.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import AXES, Expected, Values
from mbdlft.base.errors import SceneError, check_known
from mbdlft.multibody.body import GROUND, Beam, Body, ElasticBody, RigidBody
from mbdlft.multibody.body import Shape as BodyShape
from mbdlft.multibody.body.beam_elements import values_at
from mbdlft.multibody.body.elastic import times
from mbdlft.multibody.body.rigid import DIAGONAL
from mbdlft.multibody.contact import Contact, KnifeEdge, Rolling
from mbdlft.multibody.force import DirectedLoad, Guided, Load, Spring, Strut, Wheel
from mbdlft.multibody.joint import Joint
from mbdlft.multibody.joint.kinds import plane
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.sensor import Sensor
from mbdlft.multibody.spatial import column
from mbdlft.problem.sx.constants import unit_vector
from mbdlft.robot.robot import between
from mbdlft.show.viewer.looks import extent_of, placed
from mbdlft.show.viewer.poses import Poses, load_wrenches

T = TypeVar("T")
Shape = dict[str, Any]
Item = dict[str, Any]
_NOTHING = 1e-12  # of a wrench: a force or torque that no load of this kind has
# of shapes of these groups; others have a layer each
_LAYERS = {"world": "ground", "loops": "joints", "contacts": "bodies", "couplings": "joints"}
_POINTS = 24  # of a beam, at least, for polynomials over the whole of it
_ROW = {"axial": 0, "bending_y": 1, "bending_z": 2}  # of the displacement that each deformation makes


def center_line(beam: Beam, values: Values, q: ca.SX) -> list[ca.SX]:
    """Points (3,) of a deformed beam from the origin to the tip, in the axes of the body (m).

    They are its nodes, or as many as its modes need; q (n,) are its coordinates.
    """
    finer = 1 if beam.modes is None else -(-_POINTS // beam.elements)
    count = beam.elements * finer
    points = [ca.SX(3, 1)]
    for node in range(1, count + 1):
        moved = np.zeros((3, len(beam.freedoms())))
        for name, d, columns in beam.blocks():
            if name in _ROW:
                fine = d._replace(elements=count, breaks=tuple(finer * k for k in d.breaks))
                moved[_ROW[name], columns] = values_at(fine, "displacement", node)
        along = ca.vertcat(ca.SX(node / count * values["length"]), ca.SX(2, 1))
        points.append(along + ca.mtimes(ca.SX(moved), q))
    return points


@dataclass(slots=True)
class Drawing:
    """Items in the making, at `nominal` values (n_p,); shapes have the numbers of `vectors` (3,)."""

    poses: Poses
    nominal: Array
    vectors: list[ca.SX] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)

    def vector(self, expression: ca.SX) -> int:
        """The number of a point or direction (3,)."""
        self.vectors.append(expression)
        return len(self.vectors) - 1

    def frame(self, body: str) -> list[int]:
        """The numbers of the origin of a body and of its axes."""
        frame = self.poses.frames[body]
        return [self.vector(frame.r), *(self.vector(frame.R[:, k]) for k in range(3))]

    def add(self, group: str, name: str, kind: str, lines: list[str], shapes: Iterable[Shape]) -> None:
        """Add an item; its shapes are in the layer of its group, unless they say another one."""
        made = [{"layer": _LAYERS.get(group, group)} | shape for shape in shapes]
        self.items.append({"group": group, "name": name, "kind": kind, "lines": lines, "shapes": made})

    def first_coordinate(self, owner: str) -> int:
        """The place of the first coordinate of a joint or body; that of its effort in u, too."""
        k = 0
        for owned in self.poses.owned:
            if owned.owner == owner:
                return k
            k += len(owned.freedoms)
        return k

    def numbers(self, expression: ca.SX) -> Array:
        """Values of an expression at nominal and at equilibrium, as a vector."""
        function = self.poses.as_function(ca.vec(expression), "nominal")
        return np.asarray(function(self.nominal, 0.0)).ravel()

    def function(self) -> ca.Function:
        """All vectors (3 n,) by (physical values, q)."""
        return self.poses.as_function(ca.vertcat(*self.vectors), "vectors")


def draw(poses: Poses, nominal: Array) -> Drawing:
    """The drawing of a scene; `nominal` (n_p,) are the values of its parameters."""
    drawing = Drawing(poses, nominal)
    scene = poses.scene
    _draw_world(drawing)
    for body in scene.bodies:
        if body.name != GROUND:
            _draw_body(drawing, body)
    for joint in scene.joints:
        _draw_joint(drawing, joint)
    count = sum(len(owned.freedoms) for owned in poses.owned)
    for k, load in enumerate(scene.loads):
        _draw_load(drawing, load, count + k)
    for sensor in scene.sensors:
        _draw_sensor(drawing, sensor)
    for loop in scene.loops:
        _draw_loop(drawing, loop)
    for contact in scene.contacts:
        _draw_contact(drawing, contact)
    for coupling in scene.couplings:
        terms = " and ".join(term.coordinate for term in coupling.terms())
        lines = [f"couples {terms}", *said(coupling.quantities(scene.joints))]
        coupled = [joint for joint, _ in coupling.freedoms(scene.joints)]
        points = [drawing.vector(poses.joints[joint.name].child) for joint in coupled]
        drawing.add(
            "couplings", coupling.name, coupling.kind, lines, [{"type": "line", "points": points}]
        )
    if not np.isfinite(drawing.numbers(ca.horzcat(*drawing.vectors))).all():
        raise SceneError(
            f"scene {scene.name!r}: a position is not finite at nominal, so there is nothing to draw. "
            "Lengths or angles are too large."
        )
    masses = [s for item in drawing.items for s in item["shapes"] if s["type"] == "mass"]
    for shape in masses:
        largest = max(other["mass"] for other in masses)
        shape["share"] = float((shape["mass"] / largest) ** (1.0 / 3.0))
    return drawing


def said(quantities: dict[str, Expected]) -> list[str]:
    """Lines such as ``mass = m1 kg`` of what a file says."""
    return [
        f"{label} = {expected.source}" + ("" if expected.unit == "1" else f" {expected.unit}")
        for label, expected in quantities.items()
    ]


def _draw_world(d: Drawing) -> None:
    """The axes of the ground, gravity, acceleration and spin of the frame."""
    scene, origin = d.poses.scene, d.vector(ca.SX(3, 1))
    values = d.poses.values[f"scene {scene.name!r}"]
    frame = {"type": "frame", "at": d.frame(GROUND), "big": True}
    shapes = [frame, *_ports(d, d.poses.view.now.bodies[GROUND])]
    d.add("world", GROUND, "ground", ["axes of the scene"], shapes)
    for key in ("gravity", "acceleration"):
        components = getattr(scene, key)
        if any(component != 0 for component in components):
            vector = column(values[f"{key}.{axis}"] for axis in AXES)
            line = f"{key} = [{', '.join(map(str, components))}] m/s^2"
            arrow = {"type": "arrow", "at": origin, "along": d.vector(vector)}
            # nothing to draw of what the trim solves for
            d.add("world", key, key, [line], [arrow] if vector.nnz() else [])
    if scene.spin:
        line = f"rate = {scene.spin.rate} rad/s"
        axis = d.vector(unit_vector(scene.spin.axis))
        d.add("world", "spin", "spin", [line], [{"type": "turn", "at": origin, "along": axis}])


def _ports(d: Drawing, body: Body) -> list[Shape]:
    """The declared ports of a body."""
    names = [port for port in body.port_names() if port not in ("origin", "center_of_mass")]
    d.poses.view.owner = owner_name(body)
    return [
        {"type": "port", "at": d.vector(d.poses.port(f"{body.name}.{port}")), "label": port,
         "layer": "ports"}
        for port in names
    ]  # fmt: skip


def _draw_body(d: Drawing, body: Body) -> None:
    """A body: sticks between its points, its axes, ports and center of mass."""
    poses, values = d.poses, d.poses.values.get(owner_name(body), {})
    frame, now = poses.frames[body.name], poses.view.now
    shapes: list[Shape] = []
    if isinstance(body, ElasticBody):
        q = now.elastic[body.name].q
        if isinstance(body, Beam):
            points = [d.vector(frame.at(point)) for point in center_line(body, values, q)]
            shapes.append({"type": "curve", "points": points})
        else:
            shapes += [
                {"type": "stick", "points": [d.vector(frame.r), d.vector(r)], "elastic": True}
                for r in _ends(d, body)
            ]
    else:
        shapes += _sticks(d, body)
    shapes.append({"type": "frame", "at": d.frame(body.name), "layer": "frames"})
    shapes += _ports(d, body)
    center = _center_of_mass(d, body)
    if center is not None:
        mass = float(d.numbers(ca.SX(body.total_mass(values)))[0])
        if 0.0 < mass < math.inf:
            at = d.vector(center)
            shapes.append({"type": "mass", "at": at, "mass": mass, "layer": "centers of mass"})
    d.add("bodies", body.name, body.kind, said(body.quantities()), shapes)


def _ends(d: Drawing, body: ElasticBody) -> list[ca.SX]:
    """Points of an elastic body that move with its deformation: its ports, else its center of mass."""
    names = [f"{body.name}.{port}" for port in body.elastic_ports()]
    center = None if names else _center_of_mass(d, body)
    return [d.poses.frames[name].r for name in names] + ([] if center is None else [center])


def _center_of_mass(d: Drawing, body: Body) -> ca.SX | None:
    """Where the center of mass of a body is; None without mass at nominal.

    The participation factors of translations are the mass times what the coordinates do to it.
    """
    poses, values = d.poses, d.poses.values.get(owner_name(body), {})
    if isinstance(body, RigidBody):
        poses.view.owner = owner_name(body)
        return poses.port(f"{body.name}.center_of_mass")
    inboard, mass = poses.inboard[body.name], ca.SX(body.total_mass(values))
    if not d.numbers(mass)[0] > 0.0:
        return None
    moment = body.first_moment(values, poses.view.now.inboard[body.name])
    if isinstance(body, ElasticBody):
        q = poses.view.now.elastic[body.name].q
        moment = moment + times(body.elastic(values).participation, q)[:3]
    return inboard.at(moment / mass)


def _sticks(d: Drawing, body: Body) -> list[Shape]:
    """Sticks from the port at which a rigid body is held to its other ports and its center of mass."""
    poses = d.poses
    start = poses.inboard[body.name].r
    poses.view.owner = owner_name(body)
    ends = [poses.port(f"{body.name}.{port}") for port in body.port_names() if port != "origin"]
    ends.append(poses.frames[body.name].r)
    sticks: list[Shape] = [
        {"type": "stick", "points": [d.vector(start), d.vector(end)]}
        for end in ends
        if np.max(np.abs(d.numbers(end - start))) > 0.0
    ]
    return sticks or [{"type": "dot", "at": d.vector(start)}]


def _draw_joint(d: Drawing, joint: Joint) -> None:
    """A joint: an arrow along each axis, with a bent one where it turns."""
    pose = d.poses.joints[joint.name]
    at = d.vector(pose.parent), d.vector(pose.child)
    shapes: list[Shape] = [{"type": "joint", "at": at[0], "kind": joint.kind}]
    if np.max(np.abs(d.numbers(pose.child - pose.parent))) > 0.0 or joint.kind != "fixed":
        shapes.append({"type": "line", "points": list(at)})
    first = d.first_coordinate(owner_name(joint))
    for k, moving in enumerate(pose.axes):
        kind = "turn" if moving.turns else "slide"
        arrow: Shape = {"at": at[1 if moving.turns else 0], "along": d.vector(moving.axis)}
        shapes.append({"type": kind, **arrow})
        if not getattr(joint, "imposed", False):
            effort = {"type": "effort", "effort": first + k, "turns": moving.turns}
            shapes.append({**effort, **arrow, "layer": "equilibrium"})
    lines = [f"{joint.parent} to {joint.child}", *_axis_lines(joint), *said(joint.quantities())]
    if getattr(joint, "rate", None) is not None:
        lines.append("turns at this rate at equilibrium")
    if imposed := getattr(joint, "imposed", False):
        lines.append(f"its {'motion' if imposed == 'motion' else 'acceleration'} is an input")
    d.add("joints", joint.name, joint.kind, lines, shapes)


def _axis_lines(joint: Joint) -> list[str]:
    """The axes as the file gives them."""
    axes = {key: getattr(joint, key, None) for key in ("axis", "axis1", "axis2")}
    return [
        f"{key} = [{', '.join(f'{float(entry):g}' for entry in axis)}]"
        for key, axis in axes.items()
        if axis is not None
    ]


def _draw_load(d: Drawing, load: Load, effort: int) -> None:
    """A load: arrows of its force and torque at a magnitude of one, and the coil of a spring.

    `effort` is the place of its magnitude among the entries of u.
    """
    wrenches = load_wrenches(d.poses, load)
    shapes: list[Shape] = []
    if isinstance(load, Wheel):
        radius = d.poses.values[owner_name(load)]["radius"]
        shapes.append(_rim(d, load.child, load.axis, radius))
    elif isinstance(load, Spring | Strut):
        points = [d.vector(point) for point, _, _ in wrenches]
        shapes.append({"type": "spring", "points": points})
    for point, force, torque in wrenches:
        vectors = {"force": force, "torque": torque}
        sizes = {kind: float(np.max(np.abs(d.numbers(v)))) for kind, v in vectors.items()}
        for kind, vector in vectors.items():
            if sizes[kind] > _NOTHING * max(sizes.values()):
                at, along = d.vector(point), d.vector(vector)
                shapes.append({"type": kind, "at": at, "along": along, "effort": effort})
    port = ", ".join(f"{key} {port}" for key, port in load.ports().items())
    lines = [port, *said(load.quantities())]
    if isinstance(load, DirectedLoad | Guided):
        entries = load.direction if isinstance(load, DirectedLoad) else load.line
        direction = ", ".join(f"{float(entry):g}" for entry in entries)
        of = load.frame if isinstance(load, DirectedLoad) else load.parent
        lines.insert(1, f"direction = [{direction}] of {of}")
    d.add("loads", load.name, load.kind, lines, shapes)


def _draw_sensor(d: Drawing, sensor: Sensor) -> None:
    """A sensor: its place, and the axes of its components."""
    port, frame = getattr(sensor, "port", None), getattr(sensor, "frame", None)
    joint = getattr(sensor, "joint", None)
    view = d.poses.view
    view.owner = f"sensor {sensor.name!r}"
    at, axes = ca.SX(3, 1), ca.SX.eye(3)
    lines = [", ".join(signal.name for signal in sensor.signals())]
    if port is not None:
        at = d.poses.port(port)
        body = frame if frame is not None else view.find(port)[0]
        axes = _known(d, "frame", body, d.poses.frames).R
        lines.append(f"port {port}, axes of {body}")
    elif joint is not None:
        at = _known(d, "joint", joint, d.poses.joints).child
        axes = d.poses.frames[view.joints[joint]].R
        lines.append(f"joint {joint}")
    numbers = [d.vector(at), *(d.vector(axes[:, k]) for k in range(3))]
    d.add("sensors", sensor.name, sensor.kind, lines, [{"type": "sensor", "at": numbers}])


def _known(d: Drawing, key: str, name: str, among: Mapping[str, T]) -> T:
    """What is called so, or a SceneError."""
    check_known("body" if key == "frame" else key, [name], among, f"{d.poses.view.owner}, {key}")
    return among[name]


def _draw_loop(d: Drawing, loop: Loop) -> None:
    """The closure of a loop: the place where its ports meet, and its axis."""
    poses = d.poses
    poses.view.owner = f"loop {loop.name!r}"
    points = [d.vector(poses.port(port)) for port in (loop.parent, loop.child)]
    shapes: list[Shape] = [
        {"type": "joint", "at": points[0], "kind": loop.kind},
        {"type": "line", "points": points},
    ]
    values = poses.values.get(poses.view.owner, {})
    axes = ((loop.axis, loop.parent), (loop.axis1, loop.parent), (loop.axis2, loop.child))
    for axis, port in axes:
        if axis is not None:
            unit = unit_vector(axis)
            unit = unit if port == loop.child else loop.in_parent_axes(unit, values)
            along = d.vector(ca.mtimes(poses.frames[poses.view.find(port)[0]].R, unit))
            kind = "arrow" if loop.kind == "prismatic" else "turn"
            shapes.append({"type": kind, "at": points[0], "along": along})
    d.add("loops", loop.name, loop.kind, [f"{loop.parent} to {loop.child}"], shapes)


def _rim(d: Drawing, port: str, axis: Sequence[float], radius: Any) -> Shape:
    """The rim of a wheel about an axis of its body."""
    center, R = d.poses.port(port), d.poses.frames[port.partition(".")[0]].R
    x, y = (radius * ca.mtimes(R, side) for side in plane(axis))
    turns = np.linspace(0.0, 2.0 * math.pi, _POINTS + 1)
    return {
        "type": "curve",
        "points": [d.vector(center + math.cos(t) * x + math.sin(t) * y) for t in turns],
    }


def _draw_contact(d: Drawing, contact: Contact) -> None:
    """The rim of a wheel, three circles of a ball; the line along which a knife edge moves."""
    poses = d.poses
    poses.view.owner = owner_name(contact)
    values = poses.values[poses.view.owner]
    if isinstance(contact, Rolling):
        axes = [contact.axis] if contact.axis is not None else np.eye(3).tolist()
        shapes = [_rim(d, contact.port, axis, values["radius"]) for axis in axes]
    elif isinstance(contact, KnifeEdge):
        R = poses.frames[contact.port.partition(".")[0]].R
        along = d.vector(ca.mtimes(R, unit_vector(contact.heading)))
        shapes = [{"type": "slide", "at": d.vector(poses.port(contact.port)), "along": along}]
    lines = [f"{contact.port} on the ground", *said(contact.quantities())]
    d.add("contacts", contact.name, contact.kind, lines, shapes)


_UP = np.array([0.0, 0.0, 1.0])
_SAME = 1e-9  # of the largest moment: two that are equal as far as numbers of a file say
_FLAT = 1e-9  # of the largest side, squared: a plate has no thickness, up to rounding
_ENTRY = (("xx", "xy", "xz"), ("xy", "yy", "yz"), ("xz", "yz", "zz"))


def add_solids(drawing: Drawing) -> None:
    """Add the shape of each body: its own, or the solid of its mass and inertia if there is one."""
    items = {item["name"]: item for item in drawing.items if item["group"] in ("bodies", "world")}
    for body in drawing.poses.scene.bodies:
        geometry = None
        if body.shape is not None:
            geometry = _given(body.shape)
        elif isinstance(body, RigidBody) and set(DIAGONAL) <= set(body.inertia.given()):
            geometry = _solid(drawing, body)
        if geometry is not None:
            at = drawing.frame(body.name)
            shape = {"type": "mesh", "at": at, "geometry": geometry, "layer": "solids"}
            items[body.name]["shapes"].append(shape)


def _given(shape: BodyShape) -> dict[str, Any]:
    """The geometry of a shape of the scene, as pages draw it."""
    solid = {kind: getattr(shape, kind) for kind in ("box", "cylinder", "sphere")}
    sizes = {
        kind: list(size) if isinstance(size, tuple) else size
        for kind, size in solid.items()
        if size is not None
    }
    place = placed(between(_UP, np.array(shape.axis, dtype=float)), np.array(shape.at, dtype=float))
    return {**sizes, "place": place.ravel().tolist(), "extent": extent_of(sizes, place)}


def solid_of(mass: float, inertia: Array) -> tuple[dict[str, Any], Array] | None:
    """Sizes (m) by kind, and the axes (3, 3) as columns, of a solid with this mass and inertia (3, 3).

    The inertia is about the center of mass (kg m^2). None where no solid has it.
    """
    if not (mass > 0.0 and np.isfinite(inertia).all()):
        return None
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    for k in (0, 2):  # the axis of a cylinder: the moments about the other two are equal
        i, j = (k + 1) % 3, (k + 2) % 3
        radius = 2.0 * moments[k] / mass
        length = 12.0 * moments[i] / mass - 3.0 * radius
        equal = abs(moments[i] - moments[j]) <= _SAME * moments[2] < abs(moments[0] - moments[2])
        if equal and radius > 0.0 and length >= -_FLAT * radius:
            turned = axes[:, [i, j, k]]
            return {"cylinder": [float(radius**0.5), float(max(length, _FLAT * radius) ** 0.5)]}, turned
    squares = 6.0 * (np.sum(moments) - 2.0 * moments) / mass
    if np.min(squares) < -_FLAT * np.max(squares):
        return None
    sides = np.sqrt(np.maximum(squares, _FLAT**2 * np.max(squares)))
    return ({"box": [float(side) for side in sides]}, axes) if np.max(sides) > 0.0 else None


def _solid(drawing: Drawing, body: RigidBody) -> dict[str, Any] | None:
    """The geometry of the solid of a body, as pages draw it."""
    values = drawing.poses.values[owner_name(body)]
    entries = [values.get(f"inertia.{name}", 0.0) for row in _ENTRY for name in row]
    center, about = (body.port_position(port, values) for port in ("center_of_mass", body.inertia.about))
    stacked = ca.vertcat(*(ca.SX(entry) for entry in entries), values["mass"], center, about)
    numbers = drawing.numbers(stacked)
    inertia, mass, r, p = numbers[:9].reshape(3, 3), float(numbers[9]), numbers[10:13], numbers[13:]
    d = r - p
    solid = solid_of(mass, inertia - mass * ((d @ d) * np.eye(3) - np.outer(d, d)))
    if solid is None:
        return None
    sizes, axes = solid
    place = placed(axes, r)
    return {**sizes, "place": place.ravel().tolist(), "extent": extent_of(sizes, place)}
