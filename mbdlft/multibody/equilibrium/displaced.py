"""The conditions of equilibrium for displacements q of any size from the positions that a scene declares.

    0 = efforts needed at rest + stiffness q - u,      0 = gap of each loop

At q = 0 these are the conditions of equilibrium of `assemble`. For other q, the force density of a
spring follows the law of the spring, and a gap is the true distance of the two ports, with all its
components, also redundant ones. Loops need not be closed at the declared positions. Elastic bodies keep
the shape that they have at the declared positions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from mbdlft.base.description import Quantity, Values
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Freedom, Signal
from mbdlft.multibody.assembly.closure import Closure, gap_of
from mbdlft.multibody.assembly.kinematics import View
from mbdlft.multibody.assembly.newton_euler import in_motion, without_unseen
from mbdlft.multibody.assembly.resolved import Resolved, resolve
from mbdlft.multibody.assembly.tree import Link, Symbols, coordinate_owners, degrees
from mbdlft.multibody.force import Spring, Strut
from mbdlft.multibody.joint import Joint, coordinate_label
from mbdlft.multibody.scene.quantities import Place, owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import Coordinate
from mbdlft.problem.equations import physical_symbols
from mbdlft.problem.sx.constants import in_doubles, unit_vector


@dataclass(frozen=True, slots=True)
class JointCoordinate:
    """One coordinate of a joint."""

    joint: Joint
    freedom: Freedom
    signal: Signal  # its position
    is_ball: bool  # a component of a rotation vector, from the declared orientation
    is_passive: bool  # its effort is given and its position is not: then nothing holds the coordinate
    is_sprung: bool  # the joint has a stiffness for it

    @property
    def effort(self) -> Signal:
        """Name and unit of its effort."""
        return self.freedom.effort.of(self.joint.name)

    def quantity(self, key: str) -> Quantity:
        """A quantity of the coordinate, a number or an expression, as the scene gives it."""
        return self.joint.quantities()[coordinate_label(key, self.freedom)].source

    @property
    def is_imposed(self) -> bool:
        """Whether the position of this coordinate is given."""
        return bool(getattr(self.joint, "imposed", False))


@dataclass(frozen=True, slots=True, eq=False)
class Displaced:
    """The conditions of equilibrium 0 = rows(q, u, p, cosine, sine), linear in u."""

    name: str
    rows: ca.SX  # (n_r,) unbalanced efforts of coordinates that are not imposed, then gaps of the loops
    row_signals: tuple[Signal, ...]
    alignment: ca.SX  # cosines of `closure.gap_of` that are 1 where a loop is closed
    q: ca.SX  # (n,) displacements from the declared positions; a rotation vector is 2 tan(angle/2) axis
    u: ca.SX  # (n_u,) efforts of joints, magnitudes of loads, multipliers of loops
    given: ca.SX  # (n_u,) values that the scene gives, functions of q and p; zero for the others
    unknown: tuple[int, ...]  # entries of u that the scene does not give
    multipliers: tuple[int, ...]  # entries of u that are multipliers of loops
    u_signals: tuple[Signal, ...]
    p: ca.SX
    cosine: ca.SX
    sine: ca.SX
    coordinates: tuple[JointCoordinate, ...]
    declared: ca.SX  # (n,) declared positions (rad, m), functions of p; zero for rotation vectors
    lengths: Mapping[str, ca.SX]  # of displaced springs (m), of struts along their direction, by name
    arms: ca.SX  # (3, .) from port to port in bodies and joints (m); they tell the size of the scene
    parameters: tuple[Parameter, ...]  # sorted by name


def displace(scene: Scene) -> Displaced:
    """The conditions of equilibrium of a scene at displaced positions."""
    r = resolve(scene)
    links, symbols, values = r.links, r.symbols, r.values
    view = _view_at_rest(r)
    springs = [load for load in scene.loads if isinstance(load, Spring | Strut)]
    laws = {load.name: spring_law(load, view) for load in springs}
    every = Closure(tuple(range(sum(len(loop.signals()) for loop in scene.loops))), ())
    m = in_motion(r, view, every, laws)
    needed, u, listed = m.passed_as_displaced().efforts, m.u, m.efforts

    every_degree = degrees(links)
    elastic = {k for k, degree in enumerate(every_degree) if degree.kind == "elastic"}
    entries = [k for k in range(len(every_degree)) if k not in elastic]
    coordinates = _coordinates(links, values)
    unbalanced = [ca.SX(0, 1)]
    row_signals: list[Signal] = []
    efforts = [needed[owned.owner] for owned in coordinate_owners(links) if owned.kind != "elastic"]
    for k, c, effort in zip(entries, coordinates, ca.vertsplit(ca.vertcat(*efforts)), strict=True):
        if not c.is_imposed:
            quantities = values[owner_name(c.joint)]
            held = quantity_of(quantities, "stiffness", c.freedom) * symbols.q[k]
            if "rate" in quantities:  # it turns on against its damper
                held = quantities["rate"] * quantity_of(quantities, "damping", c.freedom)
            unbalanced.append(effort + held - u[k])
            row_signals.append(c.effort)
    alignment = [ca.SX(0, 1)]
    for loop in scene.loops:
        gap, cosines = gap_of(loop, view)
        unbalanced.append(gap)
        alignment.append(cosines)
        for multiplier in loop.signals():
            kind, _, label = multiplier.name.removeprefix(f"{loop.name}.").partition(".")
            row_signals.append(Signal(f"{loop.name}.gap.{label}", "m" if kind == "force" else "rad"))
    known = [ca.SX(m.base.nz[:]), ca.SX.zeros(m.z.numel())]
    (rows,) = ca.substitute([ca.vertcat(*unbalanced)], [ca.SX(m.load.nz[:]), m.z], known)
    return Displaced(
        name=scene.name,
        rows=ca.densify(in_doubles(without_unseen(scene, rows))),
        row_signals=tuple(row_signals),
        alignment=ca.densify(in_doubles(ca.vertcat(*alignment))),
        q=symbols.q[entries],
        u=u,
        given=in_doubles(ca.SX(ca.vertcat(*(0.0 if e.value is None else e.value for e in listed)))),
        unknown=tuple(k for k, e in enumerate(listed) if e.value is None and k not in elastic),
        multipliers=tuple(range(len(listed) - len(every.rows), len(listed))),
        u_signals=tuple(effort.signal for effort in listed),
        p=symbols.p,
        cosine=symbols.cosine,
        sine=symbols.sine,
        coordinates=coordinates,
        declared=in_doubles(ca.vertcat(*(_declared(scene, symbols, values, c) for c in coordinates))),
        lengths={load.name: in_doubles(_length(load, view)) for load in springs},
        arms=ca.densify(in_doubles(ca.horzcat(*view.now.arms.values(), *view.now.inboard.values()))),
        parameters=r.parameters,
    )


def _view_at_rest(r: Resolved) -> View:
    """The bodies at displaced positions of the joints, at rest, with elastic bodies not deformed."""
    at_rest = {}
    for owned, at in zip(
        coordinate_owners(r.links), r.symbols.coordinates(r.links).values(), strict=True
    ):
        zero = ca.SX(at.q.numel(), 1)
        at_rest[owned.owner] = Coordinate(zero if owned.kind == "elastic" else at.q, zero, zero)
    view = r.view(at_rest)
    view.elastic = 0.0
    return view


def in_physical(d: Displaced, expressions: Sequence[ca.SX]) -> tuple[ca.SX, list[ca.SX]]:
    """Symbols of the physical values of the parameters, and dense expressions in terms of them."""
    symbols, p, cosine, sine = physical_symbols(d.parameters)
    dense = [ca.densify(expression) for expression in expressions]
    return symbols, list(ca.substitute(dense, [d.p, d.cosine, d.sine], [p, cosine, sine]))


def _coordinates(links: tuple[Link, ...], values: Mapping[str, Values]) -> tuple[JointCoordinate, ...]:
    """Coordinates of all joints, in the order of the tree."""
    coordinates = []
    for link in links:
        joint, quantities = link.joint, values.get(link.owner, {})
        imposed = bool(getattr(joint, "imposed", False))
        for freedom in joint.freedoms:
            stiffness = ca.sparsify(ca.SX(quantity_of(quantities, "stiffness", freedom)))
            coordinates.append(
                JointCoordinate(
                    joint,
                    freedom,
                    freedom.measures[0].of(joint.name),
                    is_ball=coordinate_label("position", freedom) not in quantities,
                    is_passive=not imposed
                    and "rate" not in quantities
                    and coordinate_label("preload", freedom) in quantities,
                    is_sprung=bool(stiffness.nnz()),
                )
            )
    return tuple(coordinates)


def quantity_of(values: Values, key: str, freedom: Freedom) -> Any:
    """Value of a quantity of one coordinate; zero if the joint has none."""
    return values.get(coordinate_label(key, freedom), 0.0)


def _declared(scene: Scene, symbols: Symbols, values: Mapping[str, Values], c: JointCoordinate) -> Any:
    """Declared position (rad, m) of a coordinate, a function of p."""
    owner, label = owner_name(c.joint), coordinate_label("position", c.freedom)
    if c.is_ball:
        return ca.SX(0.0)
    if c.freedom.turns:
        return symbols.angle(scene, Place(owner, label), c.joint.quantities()[label])
    return ca.SX(values[owner][label])


def spring_law(spring: Spring | Strut, view: View) -> ca.SX | None:
    """Force density, tension over length (N/m), of a displaced spring; force of a strut.

    It is k (1 - l0/l) with the rest length l0, or k - (k - h) l_declared/l with the force density h at
    the declared positions; None if the scene gives neither of them. That of a strut is
    f0 - k (s - s_declared) with the force f0 at the declared positions.
    """
    values = view.owned(spring)
    if isinstance(spring, Strut):
        if spring.force is None:
            return None
        at_rest = view.between_at_rest(spring.parent, spring.child)
        declared = ca.dot(unit_vector(spring.direction), at_rest)
        return ca.SX(values["force"] - values["stiffness"] * (_length(spring, view) - declared))
    if spring.rest_length is None and spring.force_density is None:
        return None
    length = _length(spring, view)
    if spring.rest_length is not None:
        return ca.SX(values["stiffness"] * (1.0 - values["rest_length"] / length))
    declared = ca.norm_2(view.between_at_rest(spring.parent, spring.child))
    return ca.SX(
        values["stiffness"] - (values["stiffness"] - values["force_density"]) * declared / length
    )


def _length(spring: Spring | Strut, view: View) -> ca.SX:
    """Distance (m) of the ports of a spring when displaced; of a strut along its direction."""
    view.owned(spring)
    r = view.between(spring.parent, spring.child)
    return ca.dot(unit_vector(spring.direction), r) if isinstance(spring, Strut) else ca.norm_2(r)
