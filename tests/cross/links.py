"""What holds two bodies together in maximal coordinates: joints, closures, springs and struts.

Each is a function of two poses: coordinates s first, then what vanishes.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from tests.cross import poses

Relation = Callable[[poses.Motion, poses.Motion], poses.Values]


class Rotor(NamedTuple):
    """An inertia about an axis of the parent or child; it turns `more` times a coordinate beyond it."""

    on_parent: bool
    axis: poses.Vector
    inertia: Any
    more: Any
    coordinate: int


class Law(NamedTuple):
    """E = gain e + tension - k (s - s0) - c ds/dt - m d2s/dt2 of one coordinate, and its names."""

    effort: str
    measures: tuple[str, ...]
    stiffness: Any
    damping: Any
    inertia: Any
    preset: Any  # e at equilibrium; None: unknown
    gain: Any = 1
    tension: Any = 0
    rate: Any = 0


class Coupling(NamedTuple):
    """A combination of coordinates, (coefficient, link, row) each; its force, rigid without stiffness."""

    force: str
    combination: list[tuple[Any, Any, int]]
    stiffness: Any
    damping: Any
    preset: Any  # the force of one with stiffness at equilibrium; None: unknown


class Link(NamedTuple):
    """Two bodies (-1 is the ground), the relation of their poses, and laws of its coordinates."""

    name: str
    parent: int
    child: int
    relation: Relation
    laws: tuple[Law, ...] = ()
    imposed: Any = False
    ball: int | None = None  # the first of three coordinates whose effort is a torque in the child's axes
    rotors: tuple[Rotor, ...] = ()
    at: poses.Vector = poses.NONE  # port of the child

    def jacobian(self, P: poses.Motion, C: poses.Motion) -> list[poses.Values]:
        """Derivatives (rows, 12) of the relation by twists of both bodies."""
        before = self.relation(P, C)
        columns = [self.relation(P.moved(0, k), C) if self.parent >= 0 else before for k in range(6)]
        columns += [self.relation(P, C.moved(0, k)) if self.child >= 0 else before for k in range(6)]
        rows = [[(c[i] - before[i]) / poses.STEP for c in columns] for i in range(len(before))]
        if self.ball is not None:
            for i in range(3):
                torque = (C.turn * poses.AXES[i]).entries()
                rows[self.ball + i] = [0, 0, 0, *(-x for x in torque), 0, 0, 0, *torque]
        return rows

    def in_time(self, P: poses.Motion, C: poses.Motion) -> poses.Values:
        """The relation, its rates and its second derivatives, one after the other."""
        before, now, later = (self.relation(P.after(t), C.after(t)) for t in (-poses.TIME, 0, poses.TIME))
        rate = [(c - a) / (2 * poses.TIME) for a, c in zip(before, later, strict=True)]
        return [
            *now,
            *rate,
            *((a - 2 * b + c) / poses.TIME**2 for a, b, c in zip(before, now, later, strict=True)),
        ]


def hinges(joint: Any) -> list[poses.Vector | None]:
    """Axes of the coordinates whose actuator turns about an axis."""
    if joint.kind == "universal":
        return [poses.unit(joint.axis1), poses.unit(joint.axis2)]
    if joint.kind in ("revolute", "cylindrical", "planar"):
        return [*[None] * (len(joint.freedoms) - 1), poses.unit(joint.axis)]
    return []


def plane_of(axis: Sequence[float]) -> tuple[poses.Vector, poses.Vector]:
    """x and y of a plane: the axes that follow the normal, or the longest projection of an axis."""
    normal = poses.unit(axis)
    if np.count_nonzero(axis) == 1:
        x = poses.vector(np.roll(np.sign(np.abs(axis)), 1).tolist())
    else:
        best = int(np.argmin(np.abs(axis)))
        x = poses.unit((poses.AXES[best] - normal * normal[best, 0]).entries())
    return x, poses.cross(normal, x)


def placed(joint: Any, tilt: poses.Matrix, q: poses.Values) -> tuple[poses.Vector, poses.Matrix]:
    """Place (3,) and turn (3, 3) of the child's port in the axes of the parent, at equilibrium."""
    match joint.kind:
        case "revolute" | "fixed":
            return poses.NONE, tilt * poses.rotation(joint.axis, q[0])
        case "prismatic":
            return tilt * (poses.unit(joint.axis) * q[0]), tilt
        case "cylindrical":
            return tilt * (poses.unit(joint.axis) * q[0]), tilt * poses.rotation(joint.axis, q[1])
        case "universal":
            return poses.NONE, tilt * poses.rotation(joint.axis1, q[0]) * poses.rotation(
                joint.axis2, q[1]
            )
        case "planar":
            x, y = plane_of(joint.axis)
            return tilt * (x * q[0] + y * q[1]), tilt * poses.rotation(joint.axis, q[2])
        case "free":
            return poses.vector(q[:3]), tilt
    return poses.NONE, tilt


# coordinates of the relation of a closure: what it leaves free
FREE = {"revolute": 1, "prismatic": 1, "cylindrical": 2, "universal": 2, "spherical": 3, "fixed": 0}


def relation_of(
    item: Any,
    ports: tuple[poses.Vector, poses.Vector],
    tilt: poses.Matrix,
    at_rest: poses.Matrix,
    q: poses.Values,
) -> Relation:
    """The relation of a joint or closure whose child is turned by `at_rest`, at the position q."""
    kind, back, unturned = item.kind, tilt.transpose(), at_rest.transpose()
    axis = poses.NONE if getattr(item, "axis", None) is None else poses.unit(item.axis)
    one = poses.cross(axis, poses.AXES[int(np.argmin([abs(float(x)) for x in axis.entries()]))])
    across = (one, poses.cross(axis, one))
    x, y = plane_of(item.axis) if kind == "planar" else (poses.NONE, poses.NONE)
    first = second = poses.NONE
    before = after = poses.EYE
    if kind == "universal":
        first, second = poses.unit(item.axis1), poses.unit(item.axis2)
        before, after = poses.rotation(item.axis1, -q[0]), poses.rotation(item.axis2, -q[1])
    g = poses.dot(first, second)

    def relation(P: poses.Motion, C: poses.Motion) -> poses.Values:
        gap = P.turn.transpose() * (C.point(ports[1]) - P.point(ports[0]))
        turned = back * P.turn.transpose() * C.turn
        sine = poses.sine_axis(unturned * turned)
        if kind == "free":
            return [*(gap - poses.vector(q[:3])).entries(), *sine.entries()]
        gap = back * gap
        if kind == "spherical":
            return [*sine.entries(), *gap.entries()]
        if kind == "fixed":
            return [*gap.entries(), *sine.entries()]
        if kind == "universal":
            small = poses.sine_axis(before * turned * after)
            a, b = poses.dot(first, small), poses.dot(second, small)
            angles = [(a - g * b) / (1 - g * g), (b - g * a) / (1 - g * g)]
            return [*angles, *gap.entries(), poses.dot(first, turned * second) - g]
        size, along = poses.dot(axis, sine), [poses.dot(a, gap) for a in across]
        angle, parallel = size + size * size * size / 6, [poses.dot(a, turned * axis) for a in across]
        if kind == "revolute":
            return [angle, *gap.entries(), *parallel]
        if kind == "prismatic":
            return [poses.dot(axis, gap) - q[0], *along, *sine.entries()]
        if kind == "cylindrical":
            return [poses.dot(axis, gap) - q[0], angle, *along, *parallel]
        return [
            poses.dot(x, gap) - q[0],
            poses.dot(y, gap) - q[1],
            angle,
            poses.dot(axis, gap),
            *parallel,
        ]

    return relation
