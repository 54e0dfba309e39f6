"""The conditions of equilibrium for displacements q of any size from the declared positions, and of fits.

    0 = efforts needed at rest + stiffness q - u,      0 = gap of each loop and rigid coupling

At q = 0 these are the conditions of equilibrium of `assemble`. For other q, the force density of a
spring follows the law of the spring, and a gap is the true distance of the two ports, with all its
components, also redundant ones. Loops need not be closed at the declared positions. Elastic bodies keep
the shape that they have at the declared positions.

A fit has f(t, p) = 0 with as many unknowns as equations: the unknown position of a joint is theta0 + 2
atan(t), or x0 + 2 t, where theta0 and x0 are the position at the nominal equilibrium. The angle a =
atan(t) of a joint with a stiffness, and the force density h of a spring of length l and rest length l0,
are unknowns too, with the equations

    0 = sin(a) - t cos(a),     0 = h l - (k l - k l0)

So f has only sines, cosines and square roots. Unknown efforts, in which it is linear, are eliminated.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import qr

from mbdlft.base.array import Array
from mbdlft.base.description import Quantity, Values
from mbdlft.base.errors import NotRationalError, TrimError
from mbdlft.base.expression import evaluate, parse
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import Freedom, Signal
from mbdlft.multibody.assembly.closure import every_constraint, gap_of
from mbdlft.multibody.assembly.coupled import position_of, relations, rigid
from mbdlft.multibody.assembly.kinematics import View
from mbdlft.multibody.assembly.newton_euler import in_motion, without_unseen
from mbdlft.multibody.assembly.resolved import Resolved, couplings, resolve
from mbdlft.multibody.assembly.tree import Link, coordinate_owners, degrees
from mbdlft.multibody.force import Guided, Spring
from mbdlft.multibody.joint import Joint, coordinate_label
from mbdlft.multibody.scene.quantities import owner_name
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
    relations: ca.SX  # (m, n) coefficients of all couplings by the coordinates
    arms: ca.SX  # (3, .) from port to port in bodies and joints (m); they tell the size of the scene
    parameters: tuple[Parameter, ...]  # sorted by name


def displace(scene: Scene) -> Displaced:
    """The conditions of equilibrium of a scene at displaced positions."""
    r = resolve(scene)
    links, symbols, values = r.links, r.symbols, r.values
    view = _view_at_rest(r)
    springs = [load for load in scene.loads if isinstance(load, Spring | Guided)]
    laws = {load.name: spring_law(load, view) for load in springs}
    every = every_constraint(scene)
    m = in_motion(r, view, every, laws)
    needed, u, listed = m.passed_as_displaced().efforts, m.u, m.efforts
    elastic = {k for k, degree in enumerate(degrees(links)) if degree.kind == "elastic"}
    entries = [k for k in range(symbols.q.numel()) if k not in elastic]
    coordinates = _coordinates(links, values)
    coupled = couplings(r, view, every, u, m.z, [effort.signal.name for effort in listed]).efforts
    unbalanced, row_signals = [ca.SX(0, 1)], list[Signal]()
    efforts = [needed[owned.owner] for owned in coordinate_owners(links) if owned.kind != "elastic"]
    for k, c, effort in zip(entries, coordinates, ca.vertsplit(ca.vertcat(*efforts)), strict=True):
        if not c.is_imposed:
            quantities = values[owner_name(c.joint)]
            held = quantity_of(quantities, "stiffness", c.freedom) * symbols.q[k]
            if "rate" in quantities:  # it turns on against its damper
                held = quantities["rate"] * quantity_of(quantities, "damping", c.freedom)
            unbalanced.append(effort + held - u[k] - coupled[k])
            row_signals.append(c.effort)
    gaps, alignment, gap_signals = gaps_of(scene, view, symbols.q)
    known = [ca.SX(m.base.nz[:]), ca.SX.zeros(m.z.numel())]
    (rows,) = ca.substitute([ca.vertcat(*unbalanced, gaps)], [ca.SX(m.load.nz[:]), m.z], known)
    return Displaced(
        name=scene.name,
        rows=ca.densify(in_doubles(without_unseen(scene, rows))),
        row_signals=(*row_signals, *gap_signals),
        alignment=ca.densify(in_doubles(alignment)),
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
        declared=in_doubles(
            ca.vertcat(*(position_of(scene, c.joint, c.freedom, symbols, values) for c in coordinates))
        ),
        lengths={load.name: in_doubles(_length(load, view)) for load in springs},
        relations=ca.densify(in_doubles(relations(scene, scene.couplings, view)[:, entries])),
        arms=ca.densify(in_doubles(ca.horzcat(*view.now.arms.values(), *view.now.inboard.values()))),
        parameters=r.parameters,
    )


def gaps_of(scene: Scene, view: View, q: ca.SX) -> tuple[ca.SX, ca.SX, list[Signal]]:
    """Gaps of loops and rigid couplings, cosines that are 1 where loops are closed, names of the gaps."""
    gaps, alignment, signals = [ca.SX(0, 1)], [ca.SX(0, 1)], list[Signal]()
    for loop in scene.loops:
        gap, cosines = gap_of(loop, view)
        gaps.append(gap)
        alignment.append(cosines)
        for multiplier in loop.signals():
            kind, _, label = multiplier.name.removeprefix(f"{loop.name}.").partition(".")
            signals.append(Signal(f"{loop.name}.gap.{label}", "m" if kind == "force" else "rad"))
    signals += [Signal(f"{c.name}.gap", c.measured_in(scene.joints)) for c in rigid(scene)]
    coupled = ca.mtimes(relations(scene, rigid(scene), view), q)
    return ca.vertcat(*gaps, coupled), ca.vertcat(*alignment), signals


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
        for freedom in joint.freedoms:
            stiffness = ca.sparsify(ca.SX(quantity_of(quantities, "stiffness", freedom)))
            coordinates.append(
                JointCoordinate(
                    joint,
                    freedom,
                    freedom.measures[0].of(joint.name),
                    is_ball=coordinate_label("position", freedom) not in quantities,
                    is_passive=not getattr(joint, "imposed", False)
                    and "rate" not in quantities
                    and coordinate_label("preload", freedom) in quantities,
                    is_sprung=bool(stiffness.nnz()),
                )
            )
    return tuple(coordinates)


def quantity_of(values: Values, key: str, freedom: Freedom) -> Any:
    """Value of a quantity of one coordinate; zero if the joint has none."""
    return values.get(coordinate_label(key, freedom), 0.0)


def spring_law(spring: Spring | Guided, view: View) -> ca.SX | None:
    """Force density, tension over length (N/m), of a displaced spring; force of a strut.

    It is k (1 - l0/l) with the rest length l0, or k - (k - h) l_declared/l with the force density h at
    the declared positions; None if the scene gives neither of them. That of a strut is
    f0 - k (s - s_declared) with the force f0 at the declared positions.
    """
    values = view.owned(spring)
    if isinstance(spring, Guided):
        if spring.force is None:
            return None
        at_rest = view.between_at_rest(spring.parent, spring.child)
        declared = ca.dot(unit_vector(spring.line), at_rest)
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


def _length(spring: Spring | Guided, view: View) -> ca.SX:
    """Distance (m) of the ports of a spring when displaced; of a strut along its direction."""
    view.owned(spring)
    r = view.between(spring.parent, spring.child)
    return ca.dot(unit_vector(spring.line), r) if isinstance(spring, Guided) else ca.norm_2(r)


_RANK = 1e-9  # a pivot below this part of the largest is zero: other efforts do the same
_MET = 1e-7  # largest value of an equation at the nominal equilibrium, over its size

Entries = list[ca.SX]


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """The conditions f(t, p) = 0 of equilibrium.

    The unknowns t (n_t,) are tangents of coordinates, then angles of joints with a stiffness, then force
    densities.
    """

    residual: ca.Function  # (t, p) -> f (n_t,); p in SI units
    names: tuple[str, ...]  # of the parameters in p
    start: Array  # (n_t,) the root at nominal
    tangents: tuple[int, ...]  # indices of the coordinates whose tangents are unknowns
    angles: tuple[int, ...]  # and of those whose angles are
    springs: Mapping[str, float]  # nominal force density (N/m) by name; the unknown is relative to it


def fit_conditions(
    scene: Scene,
    before: Displaced,
    after: Displaced,
    tangents: Mapping[int, str],
    nominal: Mapping[int, float],
) -> Conditions:
    """The conditions for the coordinates whose positions in `after` have the parameters `tangents`.

    `before` is the scene as the user declares it, `after` that in which the new positions are declared;
    `tangents` are names of the new parameters, `nominal` positions (rad, m), by index of the coordinate.
    """
    s = _Symbols(scene, tangents)
    rows, trimmed = s.at(after, [after.rows, after.given])
    u = ca.SX(trimmed)
    halves = _sprung_joints(s, before, after, nominal, u)
    ropes = _ropes(s, before, after, u)
    laws = ca.vertcat(
        ca.SX(0, 1),
        *(ca.sin(half) - s.tangents[k] * ca.cos(half) for k, half in halves.items()),
        *(rope.law for rope in ropes),
    )
    t = ca.vertcat(s.all_tangents, *halves.values(), *(rope.density for rope in ropes))
    start = [0.0] * (len(tangents) + len(halves)) + [rope.nominal for rope in ropes]
    w = ca.SX.sym("w", len(after.unknown))
    if after.unknown:
        u[list(after.unknown)] = w
    arguments = ca.vertcat(t, *s.parameters.values())
    numbers = _numbers(arguments, np.array([*start, *s.nominal.values()]))
    remaining = _eliminated(ca.vertsplit(ca.substitute(rows, after.u, u)), w, numbers)
    f = ca.vertcat(_independent(scene, remaining, laws, t, len(tangents), numbers), laws)
    slopes = np.max(np.abs(numbers(ca.jacobian(f, t))), axis=1)
    f = f / ca.DM(np.where(slopes > 0, slopes, 1.0))
    met = float(np.max(np.abs(numbers(f))))
    if not met <= _MET:
        raise TrimError(
            f"scene {scene.name!r}: the nominal equilibrium does not meet the equations without the "
            f"unknown efforts, by {met:.1e}."
        )
    residual, names = _of_used_parameters(s, f, t)
    return Conditions(
        residual,
        names,
        np.array(start),
        tuple(tangents),
        tuple(halves),
        {rope.name: rope.size for rope in ropes},
    )


class _Rope(NamedTuple):
    """A spring whose force density, or a strut whose force, is size * density, with its law."""

    name: str
    size: float
    density: ca.SX  # the unknown
    law: ca.SX
    nominal: float  # value of the unknown


def _sprung_joints(
    s: "_Symbols", before: Displaced, after: Displaced, nominal: Mapping[int, float], u: ca.SX
) -> dict[int, ca.SX]:
    """Put efforts of joint stiffnesses into u (n_u,); return symbols of half of the angles, by index."""
    index = {signal.name: k for k, signal in enumerate(after.u_signals)}
    (declared,) = s.at(before, [before.declared])
    halves: dict[int, ca.SX] = {}
    for k, tangent in s.tangents.items():
        c = before.coordinates[k]
        if not c.is_sprung:
            continue
        if ca.symvar(declared[k]):
            raise TrimError(
                f"scene {before.name!r}: the spring of {c.joint.name!r} is relaxed at a position that "
                "depends on parameters. Give it a number, and the rest as preload."
            )
        half = tangent
        if c.freedom.turns:
            half = halves[k] = ca.SX.sym("half")
        q = nominal[k] + 2.0 * half - declared[k]
        effort = index[c.effort.name]
        u[effort] -= s.value(c.quantity("stiffness")) * q
    return halves


def _ropes(s: "_Symbols", before: Displaced, after: Displaced, u: ca.SX) -> list[_Rope]:
    """Put new symbols into u (n_u,) for the force densities of springs that depend on the positions."""
    index = {signal.name: k for k, signal in enumerate(after.u_signals)}
    ropes: list[_Rope] = []
    for load in s.scene.loads:
        if not isinstance(load, Spring | Guided):
            continue
        row = index[f"{load.name}.{load.signal.name}"]
        (length,) = s.at(after, [after.lengths[load.name]])
        if row in after.unknown or not ca.depends_on(length, s.all_tangents):
            continue
        (declared,) = s.at(before, [before.lengths[load.name]])
        k = s.value(load.stiffness)
        size = abs(s.at_nominal(k)) or 1.0
        if isinstance(load, Guided):  # its force takes the place of a density
            force = s.value(load.force or 0.0) - k * (length - declared)
            unknown = ca.SX.sym("force")
            law, nominal = unknown - force / size, s.at_nominal(force / size)
        else:
            h = s.value(load.force_density or 0.0)
            fixed = load.rest_length is not None
            slack = k * s.value(load.rest_length or 0.0) if fixed else (k - h) * declared
            unknown = ca.SX.sym("density")
            law = unknown * length - (k * length - slack) / size
            nominal = s.at_nominal((k - slack / length) / size)
        u[row] = size * unknown
        ropes.append(_Rope(load.name, size, unknown, law, nominal))
    return ropes


def _of_used_parameters(s: "_Symbols", f: ca.SX, t: ca.SX) -> tuple[ca.Function, tuple[str, ...]]:
    """f as a function of t and the parameters that it depends on, and their names."""
    used = [name for name, p in s.parameters.items() if ca.depends_on(f, p)]
    turned = [p.name for p in s.scene.parameters if p.is_angle and p.name in used]
    if turned:
        raise NotRationalError(
            f"scene {s.scene.name!r}: the equilibrium depends on the angle {turned[0]!r}; a fit is a "
            "function of parameters that are not angles. Make its tangent a parameter t, with the "
            "angle 2*atan(t), or let the trim solve for an effort."
        )
    others = [name for name in s.parameters if name not in used]
    f = ca.substitute(
        f,
        ca.vertcat(ca.SX(0, 1), *(s.parameters[name] for name in others)),
        ca.SX(ca.DM([s.nominal[name] for name in others])),
    )
    p = ca.vertcat(ca.SX(0, 1), *(s.parameters[name] for name in used))
    return ca.Function("equilibrium", [t, p], [ca.densify(f)]), tuple(used)


class _Symbols:
    """Symbols of parameters in SI units and of tangents, and expressions in terms of them."""

    def __init__(self, scene: Scene, tangents: Mapping[int, str]) -> None:
        self.scene = scene
        self.tangents = {k: ca.SX.sym(name) for k, name in tangents.items()}
        self.all_tangents = ca.vertcat(*self.tangents.values())
        self.parameters = {p.name: ca.SX.sym(p.name) for p in scene.parameters}
        self.factors = {p.name: p.factor for p in scene.parameters}
        self.nominal = {p.name: p.nominal * self.factors[p.name] for p in scene.parameters}
        self.physical = {name: p / self.factors[name] for name, p in self.parameters.items()}
        self.physical |= {name: self.tangents[k] for k, name in tangents.items()}

    def at(self, d: Displaced, expressions: Sequence[ca.SX]) -> Entries:
        """Expressions of a displaced scene at its declared positions, in terms of these symbols."""
        inner, dense = in_physical(d, expressions)
        values = ca.vertcat(ca.SX(0, 1), *(self.physical[p.name] for p in d.parameters))
        return list(ca.substitute(dense, [inner, d.q], [values, ca.SX.zeros(d.q.numel())]))

    def value(self, source: Quantity) -> ca.SX:
        """Value of a quantity that is not an angle, in SI units."""
        return ca.SX(evaluate(parse(source), {**self.scene.constant_values(), **self.parameters}))

    def at_nominal(self, expression: ca.SX) -> float:
        """Value of an expression at the nominal equilibrium."""
        arguments = ca.vertcat(self.all_tangents, *self.parameters.values())
        point = [*[0.0] * len(self.tangents), *self.nominal.values()]
        return float(ca.Function("nominal", [arguments], [expression])(point))


def _numbers(arguments: ca.SX, point: Array) -> Callable[[ca.SX], Array]:
    """A function that evaluates expressions of `arguments` (n,) at `point` (n,)."""

    def evaluated(expression: ca.SX) -> Array:
        function = ca.Function("numbers", [arguments], [ca.densify(expression)])
        return np.asarray(function(point).full())

    return evaluated


def _eliminated(rows: Sequence[ca.SX], w: ca.SX, numbers: Callable[[ca.SX], Array]) -> Entries:
    """The rows (m,) after Gaussian elimination of w (n_w,), in which they are linear.

    Efforts that are in one row only are eliminated first: they make no other row longer.
    """
    slopes = ca.sparsify(ca.jacobian(ca.vertcat(*rows), w))
    zero = ca.SX.zeros(w.numel())
    b = [ca.substitute(row, w, zero) for row in rows]
    A: list[list[Any]] = [[slopes[i, j] for j in range(w.numel())] for i in range(len(rows))]
    values = numbers(slopes)
    remaining, columns = list(range(len(rows))), list(range(w.numel()))
    largest = float(np.max(np.abs(values), initial=0.0))
    while columns and remaining:
        sizes = np.abs(values[np.ix_(remaining, columns)])
        alone = [
            k
            for k, j in enumerate(columns)
            if sum(A[i][j].nnz() > 0 for i in remaining) == 1 and np.max(sizes[:, k]) > _RANK * largest
        ]
        if alone:
            sizes = np.where(np.isin(np.arange(len(columns)), alone), sizes, 0.0)
        if np.max(sizes) <= _RANK * largest:
            break  # the other efforts are combinations of eliminated ones: loads of redundant closures
        i, j = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        r, c = remaining.pop(int(i)), columns.pop(int(j))
        for k in remaining:
            if A[k][c].nnz() == 0:
                continue
            factor, number = A[k][c] / A[r][c], values[k, c] / values[r, c]
            b[k] = b[k] - factor * b[r]
            for m in columns:
                A[k][m] = ca.sparsify(A[k][m] - factor * A[r][m])
            values[k] = values[k] - number * values[r]
    return [b[k] for k in remaining]


def _independent(
    scene: Scene, rows: Entries, laws: ca.SX, t: ca.SX, count: int, numbers: Callable[[ca.SX], Array]
) -> ca.SX:
    """The `count` rows that determine the tangents best; `laws` (.,) determines the other unknowns."""
    slopes = numbers(ca.jacobian(ca.vertcat(ca.SX(0, 1), *rows), t))
    inner = numbers(ca.jacobian(laws, t))
    if inner.size:
        follow = np.linalg.solve(inner[:, count:], inner[:, :count])
        slopes = slopes[:, :count] - slopes[:, count:] @ follow
    size = np.max(np.abs(slopes), axis=1, initial=0.0, keepdims=True)
    scaled = slopes / np.where(size > _RANK * np.max(size, initial=0.0), size, np.inf)
    rank = 0
    if len(rows):
        _, triangle, order = qr(scaled.T, mode="economic", pivoting=True)
        steps = np.abs(np.diag(triangle))
        rank = int(np.sum(steps > _RANK * np.max(steps, initial=0.0))) if steps[0] > 0 else 0
    if rank < count:
        raise TrimError(
            f"scene {scene.name!r}: the nominal equilibrium is a fold or a bifurcation, or {count} "
            f"unknown positions have {rank} equations that depend on them. Give other joints a preload, "
            "or loads a magnitude."
        )
    return ca.vertcat(*(rows[int(k)] for k in sorted(order[:count])))
