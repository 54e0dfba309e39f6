"""A scene in maximal coordinates, in 150 digits: each body has six, and equations of Newton and Euler.

Joints, closures, springs and struts are functions of the poses of two bodies. Some entries are
coordinates s, the others vanish:

    needed(motions) = sum (ds/dx)' E + (dphi/dx)' lambda + loads,     phi(poses) = 0
    E = gain e + tension - k (s - s0) - c ds/dt - m d2s/dt2 + sum c_j f_j

Couplings j are combinations of coordinates, e = sum c s, with a multiplier f, or f = f0 - k e - c de/dt.

All derivatives are differences. Motions follow from constraints and not from a recursion along a tree.
No program is shared with the package but the reader of expressions. Rotors
turn: small rotations of a body are exp(eta) R(t) around its motion, so that

    omega = omega0 + deta/dt + eta x omega0
    alpha = alpha0 + d2eta/dt2 + deta/dt x omega0 + eta x alpha0
"""

from collections.abc import Mapping, Sequence
from typing import Any

import flint
import numpy as np

import mbdlft
from mbdlft.base.array import Array
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.unit import parse_unit
from tests.cross.links import FREE, Coupling, Law, Link, Rotor, hinges, placed, plane_of, relation_of
from tests.cross.poses import (
    EYE,
    GROUND,
    NONE,
    Matrix,
    Motion,
    Values,
    Vector,
    array,
    cross,
    dot,
    independent,
    number,
    rotation,
    rows_of,
    skew,
    solve,
    unit,
    vector,
)
from tests.cross.touches import Touch, Wheel

_FUNCTIONS = {name: getattr(flint.arb, name) for name in ("sqrt", "sin", "cos", "atan")}


class Bodies:
    """Bodies, links and loads of a scene at physical values by name; coordinates may be displaced."""

    def __init__(
        self, scene: mbdlft.Scene, point: dict[str, float], displaced: Mapping[str, float] | None = None
    ) -> None:
        self.scene, self.displaced, pi = scene, displaced or {}, flint.arb.pi()
        self.values: dict[str, Any] = {"pi": pi, "deg": pi / 180}
        for name, constant in scene.constants.items():
            is_plain = not isinstance(constant, mbdlft.Constant)
            value = number(constant if is_plain else constant.value)
            self.values[name] = value if is_plain else value * _factor(constant.unit)
        for p in scene.parameters:
            self.values[p.name] = point[p.name] * _factor(p.unit)
        self.spin = NONE
        if scene.spin is not None:
            self.spin = unit(scene.spin.axis) * self.value(scene.spin.rate)
        self.gravity = self.vector(scene.gravity)
        self.fall = self.vector([0 if a == "unknown" else a for a in scene.acceleration])
        self.described = {body.name: body for body in scene.bodies}
        moving = [body for body in scene.bodies if body.kind != "ground"]
        self.index = {body.name: k for k, body in enumerate(moving)} | {"ground": -1}
        self.n = 6 * len(moving)
        self.masses = [self._mass(body) for body in moving]
        self.motions = [GROUND] * len(moving)
        self.joints = self._joints()
        self.links = self.joints + [self._loop(loop) for loop in scene.loops]
        self.links += [self._spring(load) for load in scene.loads if load.kind in ("spring", "strut")]
        self.wheels = {x.name: self._wheel(x) for x in scene.loads if x.kind in ("tire", "creep")}
        self.touches = [self._touch(contact) for contact in scene.contacts]
        self.couplings = [self._coupling(coupling) for coupling in scene.couplings]
        self._turn_steadily()

    def value(self, source: Any) -> Any:
        return number(evaluate(parse(source), self.values, number, _FUNCTIONS))

    def vector(self, sources: Sequence[Any]) -> Vector:
        return vector([self.value(source) for source in sources])

    def port(self, text: str) -> tuple[int, Vector]:
        """The body of a port, and its place in the axes of that body."""
        name, _, port = text.partition(".")
        if port in ("", "origin"):
            return self.index[name], NONE
        body = self.described[name]
        place = body.center_of_mass if port == "center_of_mass" else body.ports[port]
        return self.index[name], self.vector(place)

    def motion(self, k: int) -> Motion:
        return GROUND if k < 0 else self.motions[k]

    def frame(self, name: str) -> Array:
        """Place and turn of a body as a homogeneous matrix (4, 4)."""
        m, whole = self.motion(self.index[name]), np.eye(4)
        whole[:3] = np.hstack([array(m.turn), array(m.place)]).astype(float)
        return whole

    def _mass(self, body: Any) -> tuple[Any, Vector, Matrix]:
        """Mass, center, and inertia about it."""
        mass = self.value(body.mass)
        if body.kind == "point_mass":
            return mass, NONE, EYE * 0
        names = ("".join(sorted(a + b)) for a in "xyz" for b in "xyz")
        entries = [self.value(getattr(body.inertia, name) or 0) for name in names]
        inertia, center = flint.arb_mat(3, 3, entries), self.vector(body.center_of_mass)
        if body.inertia.about != "center_of_mass":
            d = skew(center - self.port(f"{body.name}.{body.inertia.about}")[1])
            inertia = inertia + d * d * mass
        return mass, center, inertia

    # links ------------------------------------------------------------------------------------

    def _joints(self) -> list[Link]:
        """Links of the joints in the order of the scene; places the bodies from the ground on."""
        links, waiting, known = dict[str, Link](), list(self.scene.joints), {-1}
        while waiting:
            joint = next(j for j in waiting if self.port(j.parent)[0] in known)
            waiting.remove(joint)
            (parent, rp), (child, rc) = self.port(joint.parent), self.port(joint.child)
            tilt, P = self._tilt(joint), self.motion(parent)
            sources = [joint.position] if joint.kind == "fixed" else _entries(joint, "position", 0.0)
            position = [self.value(x) for x in sources]
            names = [f"{joint.name}.{freedom.measures[0].name}" for freedom in joint.freedoms]
            moved = [number(self.displaced.get(name, 0.0)) for name in names]
            for k, x in enumerate(moved[: len(position)]):
                position[k] += x
            gap, turned = placed(joint, tilt, position)
            ball = {"spherical": 0, "free": 3}.get(joint.kind)
            if ball is not None:  # 2 tan(angle/2) along the axis
                v = vector(moved[ball:])
                turned = turned * (EYE + (skew(v) + skew(v) * skew(v) / 2) / (1 + dot(v, v) / 4))
            turn = P.turn * turned
            self.motions[child] = Motion(P.point(rp) + P.turn * gap - turn * rc, turn)
            known.add(child)
            relation = relation_of(joint, (rp, rc), tilt, tilt.transpose() * turned, position)
            laws, rotors = self._laws(joint, tilt)
            imposed = getattr(joint, "imposed", False)
            links[joint.name] = Link(joint.name, parent, child, relation, laws, imposed, ball, rotors, rc)
        return [links[joint.name] for joint in self.scene.joints]

    def _tilt(self, item: Any) -> Matrix:
        tilt = EYE
        for turn in item.orientation:
            tilt = tilt * rotation(turn.axis, self.value(turn.angle))
        return tilt

    def _laws(self, joint: Any, tilt: Matrix) -> tuple[tuple[Law, ...], tuple[Rotor, ...]]:
        inertia = [self.value(x) for x in _entries(joint, "actuator_inertia", 0.0)]
        rotors = []
        for k, axis in enumerate(hinges(joint)):
            if axis is None:
                continue
            # the second hinge of a cross turns with the child and has no coordinate beyond it
            second = joint.kind == "universal" and k == 1
            more = 0 if second else self.value(getattr(joint, "gear_ratio", 1.0))
            rotors.append(Rotor(not second, axis if second else tilt * axis, inertia[k], more, k))
            inertia[k] = self.value(getattr(joint, "reflected_inertia", 0.0))
        preload = _entries(joint, "preload", 0.0 if joint.kind == "free" else None)
        stiffness, damping = (_entries(joint, key, 0.0) for key in ("stiffness", "damping"))
        laws = []
        for k, freedom in enumerate(joint.freedoms):
            is_unknown = preload[k] is None or joint.imposed
            laws.append(
                Law(
                    f"{joint.name}.{freedom.effort.name}",
                    tuple(f"{joint.name}.{measure.name}" for measure in freedom.measures),
                    self.value(stiffness[k]),
                    self.value(damping[k]),
                    inertia[k],
                    None if is_unknown else self.value(preload[k]),
                    rate=self.value(getattr(joint, "rate", None) or 0.0),
                )
            )
        return tuple(laws), tuple(rotors)

    def _loop(self, loop: Any) -> Link:
        (parent, rp), (child, rc) = self.port(loop.parent), self.port(loop.child)
        whole = relation_of(loop, (rp, rc), self._tilt(loop), EYE, [0, 0, 0])
        return Link(loop.name, parent, child, lambda P, C: whole(P, C)[FREE[loop.kind] :])

    def _spring(self, load: Any) -> Link:
        (parent, rp), (child, rc) = self.port(load.parent), self.port(load.child)

        def length(P: Motion, C: Motion) -> Values:
            between = C.point(rc) - P.point(rp)
            if load.kind == "strut":
                return [dot(P.turn * unit(load.direction), between)]
            return [dot(between, between).sqrt()]

        (at_rest,) = length(self.motion(parent), self.motion(child))
        stiffness, preset = self.value(load.stiffness), getattr(load, load.magnitude_key)
        rest, tension = getattr(load, "rest_length", None), 0
        if rest is not None:
            preset, tension = 0.0, -stiffness * (at_rest - self.value(rest))
        law = Law(
            f"{load.name}.{load.signal.name}",
            (),
            stiffness,
            self.value(load.damping),
            0,
            None if preset is None else self.value(preset),
            1 if load.kind == "strut" else -at_rest,
            tension,
        )
        return Link(load.name, parent, child, length, (law,))

    def _wheel(self, x: Any) -> Wheel:
        quantities = {key: self.value(expected.source) for key, expected in x.quantities().items()}
        place = unit(x.normal), self.vector(self.scene.velocity), unit(x.axis)
        return Wheel(x.kind, self.port(x.child)[1], *place, quantities)

    def _touch(self, x: Any) -> Touch:
        child, at = self.port(x.port)
        fields: dict[str, Any] = {"velocity": self.vector(self.scene.velocity)}
        for key in ("axis", "heading"):
            if getattr(x, key, None) is not None:
                fields[key] = unit(getattr(x, key))
        if x.kind == "rolling":
            fields |= {"radius": self.value(x.radius), "tire": self.value(x.tire)}
            if x.axis is None:
                fields["tire"] = fields["radius"]
        return Touch(x.name, child, at, unit(x.normal), plane_of(x.normal), **fields)

    def _coupling(self, x: Any) -> Coupling:
        """A relation of coordinates, as textbooks have it for each kind."""
        links = {link.name: link for link in self.joints}
        value = self.value
        match x.kind:
            case "gear":
                terms = {x.joints[0]: 1, x.joints[1]: -value(x.ratio)}
            case "planetary":
                ratio = value(x.ratio)
                terms = {x.sun: 1, x.carrier: -1 - ratio, x.ring: ratio}
            case "differential":
                terms = {x.left: 1, x.right: 1, x.carrier: -2}
            case "belt":
                r1, r2 = map(value, x.radii)
                terms = {x.joints[0]: r1, x.joints[1]: r2 if x.crossed else -r2}
            case "rack":
                terms = {x.slider: 1, x.joint: -value(x.radius)}
            case "screw":
                terms = {x.slider: 1, x.joint: -value(x.pitch) / (2 * flint.arb.pi())}
            case "cable" | "linear":
                terms = {name: value(c) for name, c in getattr(x, x.table).items()}
            case _:
                terms = {x.joint: 1, x.leader: -value(x.multiplier)}
        combination = []
        for name, c in terms.items():
            link = links[name.partition(".")[0]]
            measures = [law.measures[0] for law in link.laws]
            combination.append((flint.arb(c), link, measures.index(name) if "." in name else 0))
        force = x.signal(self.scene.joints).name
        if x.stiffness is None:
            return Coupling(force, combination, None, 0, None)
        preset = None if x.preload is None else value(x.preload)
        return Coupling(force, combination, value(x.stiffness), value(x.damping), preset)

    def _turn_steadily(self) -> None:
        """Rates and accelerations of all bodies that have the steady rates of joints."""
        if not any(law.rate != 0 for link in self.joints for law in link.laws):
            return
        for names in (("velocity", "omega"), ("acceleration", "alpha")):
            order = 1 if names[0] == "velocity" else 2
            rows, right = list[Values](), list[Any]()
            for link in self.joints:
                P, C = self.motion(link.parent), self.motion(link.child)
                jacobian = link.jacobian(P, C)
                m = len(jacobian)
                now = link.in_time(P, C)[order * m : order * m + m]
                rates = [law.rate if order == 1 else 0 for law in link.laws]
                wanted = [*rates, *[0] * (m - len(rates))]
                rows += [self.spread(link, row) for row in jacobian]
                right += [a - b for a, b in zip(wanted, now, strict=True)]
            whole, sides = rows_of(rows, self.n), rows_of(right, 1)
            chosen = independent(whole)
            twist = solve(whole[chosen], sides[chosen])[:, 0]
            for k, motion in enumerate(self.motions):
                linear, turning = (vector(twist[6 * k + j : 6 * k + j + 3]) for j in (0, 3))
                self.motions[k] = motion._replace(**{names[0]: linear, names[1]: turning})

    def spread(self, link: Link, row: Values) -> Values:
        """A row (12,) of both bodies of a link as one of all coordinates (n,)."""
        whole = [flint.arb(0)] * self.n
        for b, part in ((link.parent, row[:6]), (link.child, row[6:])):
            if b >= 0:
                whole[6 * b : 6 * b + 6] = part
        return whole

    # what motions need, and what acts -----------------------------------------------------------

    def needed(self, k: int, m: Motion, shake: Vector = NONE) -> Values:
        """Force and torque about its origin (6,) that the motion of a body needs, less its weight."""
        mass, center, inertia = self.masses[k]
        force = m.felt(center, self.spin, self.gravity - self.fall - shake) * mass
        turning, J = m.omega + self.spin, m.turn * inertia * m.turn.transpose()
        torque = J * (m.alpha + cross(self.spin, m.omega)) + cross(turning, J * turning)
        return [*force.entries(), *(torque + cross(m.turn * center, force)).entries()]

    def rotor_needs(self, link: Link, rotor: Rotor, P: Motion, C: Motion) -> Values:
        """Effort of the coordinate and torque (3,) on the body that carries a rotor."""
        m, count = P if rotor.on_parent else C, len(link.relation(P, C))
        axis, (speed, rate) = m.turn * rotor.axis, link.in_time(P, C)[count + rotor.coordinate :: count]
        speed = dot(axis, m.omega + self.spin) + rotor.more * speed
        rate = dot(axis, m.alpha + cross(self.spin, m.omega)) + rotor.more * rate
        torque = axis * rate + cross(m.omega + self.spin, axis) * speed
        return [rotor.more * rate * rotor.inertia, *(torque * rotor.inertia).entries()]

    def pushed(self, load: Any, m: Motion) -> Values:
        """Force and torque about its origin (6,) that a load of size one exerts on a body."""
        if load.name in self.wheels:
            return self.wheels[load.name].pushed(m, 1, [0, 0, 0])
        if load.kind == "buoyancy":
            along = self.gravity * -1
        else:
            along = m.turn * unit(load.direction) if load.frame == "body" else unit(load.direction)
        if load.kind == "torque":
            return [flint.arb(0)] * 3 + along.entries()
        arm = m.turn * self.port(load.port)[1]
        return [*along.entries(), *cross(arm, along).entries()]


def _factor(unit: str) -> Any:
    pi = flint.arb.pi()
    exact = {"deg": pi / 180, "rpm": pi / 30, "%": flint.arb(1) / 100}
    return exact[unit] if unit in exact else number(parse_unit(unit).factor)


def _entries(joint: Any, key: str, default: Any) -> list[Any]:
    """One entry for each coordinate of a joint."""
    given = getattr(joint, key, None)
    if given is None or not joint.freedoms:
        return [default] * len(joint.freedoms)
    return list(given) if isinstance(given, tuple) else [given]
