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

from mbdlft.base.description import AXES, Quantity, Values
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Freedom, Signal
from mbdlft.multibody.assembly.closure import Closure
from mbdlft.multibody.assembly.kinematics import View, pass_inward
from mbdlft.multibody.assembly.newton_euler import body_wrenches, without_unseen
from mbdlft.multibody.assembly.resolved import Resolved, resolve
from mbdlft.multibody.assembly.signals import Effort, acting, ground_motion, list_efforts
from mbdlft.multibody.assembly.tree import Link, Symbols, all_bodies, coordinate_owners, degrees
from mbdlft.multibody.force import Spring, Strut
from mbdlft.multibody.joint import Joint, coordinate_label
from mbdlft.multibody.loop import Loop
from mbdlft.multibody.scene.quantities import Place, owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import Coordinate
from mbdlft.problem.equations import physical_symbols
from mbdlft.problem.sx.constants import in_doubles, unit_vector


@dataclass(frozen=True, slots=True)
class JointCoordinate:
    """One coordinate of a joint.

    Attributes
    ----------
    joint : Joint
    freedom : names of the coordinate
    signal : name and unit of its position
    is_ball : whether it is a component of a rotation vector, from the declared orientation
    is_passive : whether its effort is given and its position is not: then nothing holds the coordinate
    is_sprung : whether the joint has a stiffness for this coordinate
    """

    joint: Joint
    freedom: Freedom
    signal: Signal
    is_ball: bool
    is_passive: bool
    is_sprung: bool

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
    """The conditions of equilibrium 0 = rows(q, u, p, cosine, sine), linear in u.

    Attributes
    ----------
    rows : SX (n_r,)
        Unbalanced efforts of the coordinates that are not imposed, then gaps of the loops.
    row_signals : Signal (n_r,)
    alignment : SX (n_a,)
        Cosines that are 1 where a loop is closed. A gap is also zero where its cosine is -1, that is
        where the loop is closed with one side turned the wrong way round.
    q : SX symbols (n,)
        Displacements from the declared positions; a rotation vector is 2 tan(angle/2) axis.
    u : SX symbols (n_u,)
        Efforts of joints, magnitudes of loads, and multipliers of loops.
    given : SX (n_u,)
        Values of the entries of u that the scene gives, functions of q and p; zero for the others.
    unknown : indices of the entries of u that the scene does not give
    multipliers : indices of the entries of u that are multipliers of loops
    u_signals : Signal (n_u,)
    p, cosine, sine : SX symbols, as in `Equations`
    coordinates : JointCoordinate (n,)
    declared : SX (n,)
        Declared positions (rad, m), functions of p; zero for rotation vectors.
    lengths : SX by name of the spring or strut
        Length at the displaced positions (m), of a strut along its direction, a function of q and p.
    arms : SX (3, number of arms)
        Vectors from port to port in bodies and joints (m); they tell the size of the scene.
    parameters : sorted by name
    """

    name: str
    rows: ca.SX
    row_signals: tuple[Signal, ...]
    alignment: ca.SX
    q: ca.SX
    u: ca.SX
    given: ca.SX
    unknown: tuple[int, ...]
    multipliers: tuple[int, ...]
    u_signals: tuple[Signal, ...]
    p: ca.SX
    cosine: ca.SX
    sine: ca.SX
    coordinates: tuple[JointCoordinate, ...]
    declared: ca.SX
    lengths: Mapping[str, ca.SX]
    arms: ca.SX
    parameters: tuple[Parameter, ...]


def displace(scene: Scene) -> Displaced:
    """The conditions of equilibrium of a scene at displaced positions."""
    resolved = resolve(scene)
    links, symbols, values = resolved.links, resolved.symbols, resolved.values
    view = _view_at_rest(resolved)
    springs = [load for load in scene.loads if isinstance(load, Spring | Strut)]
    laws = {load.name: spring_law(load, values[owner_name(load)], view) for load in springs}
    every = Closure(tuple(range(sum(len(loop.signals()) for loop in scene.loops))), ())
    listed = list_efforts(resolved, laws, every)
    u = ca.SX.sym("u", len(listed))
    needed = _needed_efforts(resolved, view, every, listed, u)

    moving = [degree.kind != "elastic" for degree in degrees(links)]
    entries = [k for k, moves in enumerate(moving) if moves]
    coordinates = _coordinates(links, values)
    unbalanced: list[ca.SX] = []
    row_signals: list[Signal] = []
    owned = coordinate_owners(links)
    efforts = [needed[named.owner] for named in owned if named.kind != "elastic"]
    for k, c, effort in zip(entries, coordinates, ca.vertsplit(ca.vertcat(*efforts)), strict=True):
        if not c.is_imposed:
            quantities = values[owner_name(c.joint)]
            held = quantity_of(quantities, "stiffness", c.freedom) * symbols.q[k]
            if "rate" in quantities:  # it turns on against its damper
                held = quantities["rate"] * quantity_of(quantities, "damping", c.freedom)
            unbalanced.append(effort + held - u[k])
            row_signals.append(c.effort)
    declared = [_declared(scene, symbols, values, c) for c in coordinates]
    gaps, gap_signals, alignment = _gaps(scene.loops, view)
    return Displaced(
        name=scene.name,
        rows=ca.densify(in_doubles(without_unseen(scene, ca.vertcat(ca.SX(0, 1), *unbalanced, *gaps)))),
        row_signals=(*row_signals, *gap_signals),
        alignment=ca.densify(in_doubles(ca.vertcat(ca.SX(0, 1), *alignment))),
        q=symbols.q[entries],
        u=u,
        given=in_doubles(ca.SX(ca.vertcat(*(0.0 if e.value is None else e.value for e in listed)))),
        unknown=tuple(
            k
            for k, effort in enumerate(listed)
            if effort.value is None and (k >= len(moving) or moving[k])
        ),
        multipliers=tuple(range(len(listed) - len(every.rows), len(listed))),
        u_signals=tuple(effort.signal for effort in listed),
        p=symbols.p,
        cosine=symbols.cosine,
        sine=symbols.sine,
        coordinates=coordinates,
        declared=in_doubles(ca.SX(ca.vertcat(*declared))),
        lengths={load.name: in_doubles(_length(load, view)) for load in springs},
        arms=ca.densify(in_doubles(ca.horzcat(*view.now.arms.values(), *view.now.inboard.values()))),
        parameters=resolved.parameters,
    )


def in_physical(d: Displaced, expressions: Sequence[ca.SX]) -> tuple[ca.SX, list[ca.SX]]:
    """Symbols of the physical values of the parameters, and dense expressions in terms of them."""
    symbols, p, cosine, sine = physical_symbols(d.parameters)
    dense = [ca.densify(expression) for expression in expressions]
    return symbols, list(ca.substitute(dense, [d.p, d.cosine, d.sine], [p, cosine, sine]))


def _view_at_rest(r: Resolved) -> View:
    """The bodies at displaced positions of the joints, at rest, with elastic bodies not deformed."""
    uniform = r.values[f"scene {r.scene.name!r}"]
    gravity = ca.SX(ca.vertcat(*(uniform[f"gravity.{a}"] for a in AXES)))
    at_rest = {}
    for named, at in zip(
        coordinate_owners(r.links), r.symbols.coordinates(r.links).values(), strict=True
    ):
        zero = ca.SX(at.q.numel(), 1)
        at_rest[named.owner] = Coordinate(zero if named.kind == "elastic" else at.q, zero, zero)
    view = View(r.links, all_bodies(r.scene), r.values, at_rest, ca.sparsify(gravity))
    view.elastic = 0.0
    return view


def _needed_efforts(
    r: Resolved, view: View, closure: Closure, listed: Sequence[Effort], u: ca.SX
) -> Mapping[str, ca.SX]:
    """Efforts by owner (a joint or an elastic body) that hold the bodies at rest under u (n_u,)."""
    uniform = r.values[f"scene {r.scene.name!r}"]
    base = ca.SX(ca.vertcat(*(uniform[f"acceleration.{a}"] for a in AXES))) - view.gravity
    ground = ground_motion(r.scene, uniform, ca.sparsify(base), listed, u)
    none = ca.SX(len(closure.rows), 1)
    inertial, loads = body_wrenches(r, view, ground, acting(r, view, closure, u, none))
    wrenches = {name: inertial[name] + loads[name] for name in inertial}
    return pass_inward(view.now, view.motions, wrenches).efforts


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
        return 0.0
    if c.freedom.turns:
        return symbols.angle(scene, Place(owner, label), c.joint.quantities()[label])
    return values[owner][label]


def spring_law(spring: Spring | Strut, values: Values, view: View) -> ca.SX | None:
    """Force density, tension over length (N/m), of a displaced spring; force of a strut.

    It is k (1 - l0/l) with the rest length l0, or k - (k - h) l_declared/l with the force density h at
    the declared positions; None if the scene gives neither of them. That of a strut is
    f0 - k (s - s_declared) with the force f0 at the declared positions.
    """
    view.owner = owner_name(spring)
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
    view.owner = owner_name(spring)
    if isinstance(spring, Strut):
        along = unit_vector(spring.direction)
        return ca.SX(ca.dot(along, view.between(spring.parent, spring.child)))
    return ca.norm_2(view.between(spring.parent, spring.child))


def _gaps(loops: Sequence[Loop], view: View) -> tuple[list[ca.SX], list[Signal], list[ca.SX]]:
    """Gaps of the loops, one for each multiplier, their signals, and the cosines that must be 1.

    The gap of a loop with one axis is the part of the child's axis across that of the parent; that of one
    that allows no rotation is sin(angle) times the axis of the rotation from the child to the closure.
    """
    gaps: list[ca.SX] = []
    signals: list[Signal] = []
    alignment: list[ca.SX] = []
    for loop in loops:
        view.owner = owner_name(loop)
        values = view.now.values.get(view.owner, {})
        parent, child = view.find(loop.parent)[0], view.find(loop.child)[0]

        def seen(vectors: ca.SX, child: str = child, parent: str = parent) -> ca.SX:
            return ca.horzcat(*(view.across_now(v, child, parent) for v in ca.horzsplit(vectors)))

        apart = view.between(loop.parent, loop.child)
        gaps.append(ca.mtimes(loop.held(), loop.in_own_axes(apart, values)))
        same = loop.same()
        turned = loop.in_own_axes(seen(same), values) if same.shape[1] else same
        if loop.axis1 is not None and loop.axis2 is not None:
            first, second = unit_vector(loop.axis1), unit_vector(loop.axis2)
            cosine = ca.dot(first, loop.in_own_axes(seen(second), values))
            gaps.append(cosine - ca.dot(first, second))
        elif same.shape[1] == 1:
            gaps.append(ca.mtimes(loop.turned_rows(ca.SX(3, 1)), turned))
            alignment.append(ca.dot(same, turned))
        elif same.shape[1] == 3:
            twice_sine = [turned[i, j] - turned[j, i] for i, j in ((2, 1), (0, 2), (1, 0))]
            gaps.append(0.5 * ca.vertcat(*twice_sine))
            alignment.append(0.5 * (ca.trace(turned) - 1.0))
        for multiplier in loop.signals():
            kind, _, label = multiplier.name.removeprefix(f"{loop.name}.").partition(".")
            signals.append(Signal(f"{loop.name}.gap.{label}", "m" if kind == "force" else "rad"))
    return gaps, signals, alignment
