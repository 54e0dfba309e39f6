"""From a scene to its equations: the recursive Newton-Euler residual of the tree.

That its mass matrix is regular at every value of the parameters is proved as follows.
Let the joints of a tree of rigid bodies have the rates v, not all zero. Of the joints with rates that
are not zero take one that is nearest to the ground. Its parent is at rest, so its child, and what is
fixed to it, move as the joint alone moves them, with the energy v_j' H_j v_j / 2; the energy of no body
is negative. If H_j > 0 for every joint, the energy v'M v / 2 is positive, and M is regular. H_j depends
on what is declared at one joint and a few bodies only, so intervals show that its pivots are positive,
with the range cut where they have to.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.description import AXES, Values
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Signal
from mbdlft.exact.interval import FUNCTIONS, Interval, decimal, find_zero
from mbdlft.multibody.assembly import kinematics
from mbdlft.multibody.assembly import resolved as resolution
from mbdlft.multibody.assembly.closure import Closure, close_loops, constraint
from mbdlft.multibody.assembly.coupled import check_couplings
from mbdlft.multibody.assembly.touching import check_contacts, check_wheel
from mbdlft.multibody.assembly.tree import Link, PortJoint, Symbols, coordinate_owners, degrees
from mbdlft.multibody.assembly.weights import Products, Weights, gains_by_products
from mbdlft.multibody.body import ElasticBody
from mbdlft.multibody.body.rigid import DIAGONAL, PRODUCTS, unseen_name
from mbdlft.multibody.force import BodyWrench, Spring, Wheel
from mbdlft.multibody.joint.kinds import AxisJoint
from mbdlft.multibody.joint.move import MOMENTUM, turning_along
from mbdlft.multibody.scene.checks import LABELS, check_fit
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import Coordinate, column
from mbdlft.problem.equations import Equations, rounded, rows_of
from mbdlft.problem.relations import LinearModel, constraint_relations
from mbdlft.problem.sx.constants import in_doubles, is_constant
from mbdlft.problem.sx.tapes import arithmetic, fold

_RULES = arithmetic(decimal, FUNCTIONS)
_PRODUCTS = tuple(f"inertia.{name}" for name in PRODUCTS)
_MATRIX = tuple(f"inertia.{k}" for k in ("xx", "xy", "xz", "xy", "yy", "yz", "xz", "yz", "zz"))
_SEEN = 1e-13  # a sensitivity of the equations of order one below which an entry is not seen


@dataclass(frozen=True, eq=False)
class Assembly:
    """A resolved scene in motion, before wrenches are passed inward; and the equations made of it."""

    resolved: resolution.Resolved
    view: kinematics.View
    closure: Closure  # rows of the loops that are kept
    efforts: tuple[resolution.Effort, ...]  # entries of u
    u: ca.SX
    z: ca.SX
    base: ca.SX  # (3,) acceleration of the frame less gravity
    load: ca.SX  # (3,) symbols for it, where it is not zero
    field: ca.SX  # (3,) the same with the components that are unknown
    inertial: Mapping[str, ca.SX]  # wrenches (3, 2) that the motions of the bodies need
    loads: Mapping[str, ca.SX]  # those of the loads, with the other sign

    @property
    def _has_weights(self) -> bool:
        """Whether the equilibrium is one under a uniform load, in a tree that does not spin."""
        scene = self.resolved.scene
        return self.field.nnz() > 0 and not (scene.spin or scene.loops or scene.touches)

    @cached_property
    def _passed(self) -> kinematics.Passed:
        """Inward pass of the inertial wrenches and the loads."""
        now, moving = self.view.now, self.view.motions
        if self._has_weights:
            return Weights(now, self.field).passed(moving, self.inertial, self.loads)
        return self.passed_as_displaced()

    def passed_as_displaced(self) -> kinematics.Passed:
        """The same for displacements of any size."""
        total = {name: self.inertial[name] + self.loads[name] for name in self.inertial}
        return kinematics.pass_inward(self.view.now, self.view.motions, total)

    @cached_property
    def exact(self) -> Equations:
        """The equations with constants that are not rounded, as in `sx.constants`."""
        return _equations(self, self._passed)

    @cached_property
    def equations(self) -> Equations:
        """The same in doubles."""
        return rounded(self.exact)

    def second_order(self) -> Equations | None:
        """The exact equations in the other order of products of `weights`; None if that gains nothing."""
        now, moving = self.view.now, self.view.motions
        if not (self._has_weights and gains_by_products(now)):
            return None
        efforts = Products(now, self.field).passed(moving, self.inertial, self.loads).efforts
        return _equations(self, self._passed._replace(efforts=efforts))

    def constraints(self) -> tuple[LinearModel, LinearModel] | None:
        """What has to be regular for the constraints of closed loops to be independent; see `Problem`."""
        n, closure = self.exact.degrees_of_freedom, self.closure
        first = 2 * n + closure.holonomic  # their rates stand behind dynamics and displacements
        rows = range(first, first + len(closure.rows))
        return constraint_relations(self.exact, rows, [n + k for k in closure.rates])

    def is_regular(self) -> bool:
        """Whether accelerations are proved to be determined at every value; False: it was not proved."""
        symbols, now = self.resolved.symbols, self.view.now
        if self.closure.rows or any(isinstance(b, ElasticBody) for b in now.bodies.values()):
            return False
        owners = (owner for link in now.links for owner in (link.child_owner, link.owner))
        if not all(_has_energy(now.values.get(owner, {}), symbols) for owner in owners):
            return False
        coordinates = {
            owner: Coordinate(zero := ca.SX(at.q.numel(), 1), zero, at.a)
            for owner, at in self.view.coordinates.items()
        }
        at_rest = kinematics.place(now.links, now.bodies, now.values, coordinates)
        for link in at_rest.links:
            if link.joint.freedoms and not getattr(link.joint, "imposed", False):
                efforts = in_doubles(_efforts_alone(at_rest, link))
                mass = ca.jacobian(efforts, coordinates[link.owner].a)
                if not _keeps_positive(_pivots(mass), symbols):
                    return False
        return True


@arguments_checked
def assemble(scene: Scene) -> Equations:
    """Equations of motion of a scene: x = [displacements, rates] of the joints, u = efforts and loads.

    residual = [qdot - v ; RNEA(q, v, vdot) + springs + dampers - efforts - loads ; closures], the
    recursive Newton-Euler algorithm (Featherstone, section 5.3) outward for motions and inward for
    wrenches, with the acceleration and the spin of the frame given to the ground.
    """
    return assembly(scene).equations


def assembly(scene: Scene) -> Assembly:
    """As `assemble`, with all that the equations are made of."""
    resolved = resolution.resolve(scene)
    bodies = (body for body in scene.bodies if isinstance(body, ElasticBody))
    elastic = [body.name for body in bodies if not body.can_spin]
    if scene.spin and elastic:
        raise SceneError(
            f"scene {scene.name!r}: the frame spins and body {elastic[0]!r} is elastic. Centrifugal "
            "loads change its stiffness, which is known for a 'beam' without torsion, shear and rotary "
            "inertia only: modal data do not say it. Use such beams, or rigid bodies and springs."
        )
    r = resolution.in_plane(resolved)
    view = r.view()
    check_couplings(r.scene, view, r.symbols)
    if r.scene.touches:
        check_contacts(r.scene, view, r.symbols.evaluate)
    for wheel in (load for load in r.scene.loads if isinstance(load, Wheel)):
        check_wheel(wheel, r.scene, view, partial(r.symbols.evaluate, ends=True))
    closure = close_loops(r.scene, view, r.symbols)
    resolution.check_springs(r.scene, view, r.symbols.evaluate)
    springs = [load for load in r.scene.loads if isinstance(load, Spring)]
    return in_motion(r, view, closure, {s.name: resolution.force_density(s, view) for s in springs})


def in_motion(
    r: resolution.Resolved, view: kinematics.View, closure: Closure, laws: Mapping[str, Any]
) -> Assembly:
    """The bodies of a view in motion; `laws` are magnitudes of springs by name (None: unknown)."""
    scene, uniform = r.scene, r.values[f"scene {r.scene.name!r}"]
    base = column(uniform[f"acceleration.{a}"] - uniform[f"gravity.{a}"] for a in AXES)
    load = ca.SX.sym("load", base.sparsity())
    efforts = resolution.list_efforts(r, laws, closure)
    u = ca.SX.sym("u", len(efforts))
    z = ca.SX.sym("multiplier", len(closure.rows))
    ground, field = resolution.ground_motion(scene, uniform, load, efforts, u)
    inertial, loads = body_wrenches(r, view, ground, resolution.acting(r, view, closure, u, z))
    return Assembly(r, view, closure, tuple(efforts), u, z, base, load, field, inertial, loads)


def _body_momenta(links: Sequence[Link], values: Mapping[str, Values]) -> dict[str, ca.SX]:
    """Momenta (3,) of bodies by name (N m s), with all that is rigid with them."""
    return {
        link.child.name: link.joint.direction() * values[link.owner][MOMENTUM]
        for link in links
        if MOMENTUM in values[link.owner] and isinstance(link.joint, AxisJoint)
    }


def body_wrenches(
    r: resolution.Resolved, view: kinematics.View, ground: ca.SX, loads: Sequence[BodyWrench]
) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
    """Wrenches (3, 2) by body that the motions need, and those of loads with the other sign.

    The motions, for a motion (3, 3) of the `ground`, and the momenta become those of the view.
    """
    view.momenta = _body_momenta(r.links, r.values)
    view.motions = kinematics.motions(view.now, ground)
    inertial = kinematics.inertial_wrenches(view.now, view.motions)
    for name, momentum in view.momenta.items():
        inertial[name] += turning_along(view.motions.bodies[name], momentum)
    against = {name: ca.SX(3, 2) for name in inertial}
    for load in loads:
        if load.body in against:
            against[load.body] -= load.wrench
    return inertial, against


def _equations(m: Assembly, passed: kinematics.Passed) -> Equations:
    r, view, symbols = m.resolved, m.view, m.resolved.symbols
    scene, links = r.scene, r.links
    view.passed = passed
    names = [effort.signal.name for effort in m.efforts]
    channels = resolution.body_channels(r, view, m.u, names)
    coupled = resolution.couplings(r, view, m.closure, m.u, m.z, names)
    efforts, deflections = resolution.static_deflections(r, m.closure, m.u)
    unbalanced = dynamics(r, view, efforts, coupled.efforts) - channels.forces
    n = symbols.q.numel()
    held = _constraints(m, deflections)
    moved = resolution.moved_coordinates(links, names)
    held += [symbols.x[c.coordinate + k * n] - m.u[c.inputs[k]] for c in moved for k in range(2)]
    residual = ca.vertcat(symbols.xdot[:n] - symbols.x[n:], unbalanced, *held)
    forces = (coupled.forces, coupled.signals), *resolution.more_forces(r, view, m.closure, m.u, m.z)
    measured, y_signals, default = resolution.measures(r, view, channels, *forces)
    both = without_unseen(scene, ca.vertcat(residual, measured))
    carried, carried_by = _carried(links, view)
    every = degrees(links)
    coordinate_signals = [degree.measure(order) for order in range(2) for degree in every]
    effort_signals = [effort.signal for effort in m.efforts]
    check_fit(scene, [*coordinate_signals[:n], *effort_signals])
    imposed = {c.coordinate for c in moved}
    followers = {*m.closure.dependent, *imposed} | {n + k for k in (*m.closure.rates, *imposed)}
    states = tuple(k for k in range(2 * n) if k not in followers)
    cyclic = range(n) if scene.rolling else resolution.steady_angles(links)
    trimmed = [0.0 if effort.value is None else effort.value for effort in m.efforts]
    return Equations(
        name=scene.name,
        residual=both[: residual.numel()],
        output=both[residual.numel() :],
        xdot=symbols.xdot,
        x=symbols.x,
        z=m.z,
        u=m.u,
        load=ca.SX(m.load.nz[:]),
        p=symbols.p,
        cosine=symbols.cosine,
        sine=symbols.sine,
        load_value=ca.SX(m.base.nz[:]),
        given=ca.SX(ca.vertcat(*trimmed)),
        unknown=tuple(k for k, effort in enumerate(m.efforts) if effort.value is None),
        inputs=tuple(k for k, effort in enumerate(m.efforts) if effort.is_input),
        states=states,
        x_signals=tuple(coordinate_signals[k] for k in states),
        u_signals=tuple(effort_signals),
        y_signals=y_signals,
        equilibrium_signals=tuple(degree.effort for degree in every),
        default_inputs=tuple(k for k, effort in enumerate(m.efforts) if effort.is_default),
        default_outputs=default,
        ignorable=tuple(states.index(k) for k in cyclic if k in states),
        moved=moved,
        carried=carried,
        carried_by=carried_by,
        parameters=r.parameters,
        x_bounds=_bounds(scene, coordinate_signals[:n]),
        u_bounds=_bounds(scene, effort_signals),
    )


def _constraints(m: Assembly, deflections: ca.SX) -> list[ca.SX]:
    """The kept constraints of displacements, of rates and of accelerations."""
    scene, view, q, kept = m.resolved.scene, m.view, m.resolved.symbols.q, m.closure.rows
    held = [rows_of(constraint(scene, view, 0), kept[: m.closure.holonomic])]
    held += [rows_of(constraint(scene, view, order), kept) for order in (1, 2)]
    if m.closure.yielding:
        held[0] = ca.substitute(held[0], q, q + deflections)
    return held


def _bounds(scene: Scene, signals: Sequence[Signal]) -> tuple[float, ...]:
    """Bounds of the fit of the scene by signal, zero where it has none."""
    bounds = scene.fit.bounds if scene.fit else {}
    return tuple(float(bounds.get(signal.name, 0.0)) for signal in signals)


def dynamics(
    r: resolution.Resolved, view: kinematics.View, acting_efforts: ca.SX, of_couplings: ca.SX
) -> ca.SX:
    """Efforts needed minus those that act (n,); of an imposed joint, the acceleration minus the input."""
    needed = ca.vertcat(*(view.passed.efforts[owned.owner] for owned in coordinate_owners(r.links)))
    rows: list[ca.SX] = []
    for row, degree in enumerate(degrees(r.links)):
        if degree.kind in ("imposed", "motion"):
            rows.append(r.symbols.a[row] - acting_efforts[row])
            continue
        effort, quantities = needed[row], r.values.get(degree.owner, {})
        if degree.kind in ("joint", "patch"):
            effort += quantities.get(degree.label("stiffness"), 0.0) * r.symbols.q[row]
            rate = r.symbols.v[row] + quantities.get("rate", 0.0)
            effort += quantities.get(degree.label("damping"), 0.0) * rate
        rows.append(effort - acting_efforts[row] - of_couplings[row])
    return ca.vertcat(*rows)


def _carried(links: tuple[Link, ...], view: kinematics.View) -> tuple[ca.SX, tuple[str, ...]]:
    """Loads through the ports of elastic bodies whose effect on these is neither known nor neglected."""
    wrenches: list[ca.SX] = []
    names: list[str] = []
    for link in links:
        body = link.parent if isinstance(link.joint, PortJoint) else link.child
        if isinstance(body, ElasticBody) and body.prestress is None:
            rows = list(body.unknown_loads())
            wrenches.append(rows_of(ca.vec(view.passed.joints[link.child.name]), rows))
            names += [body.name] * len(rows)
    return ca.vertcat(ca.SX(0, 1), *wrenches), tuple(names)


def without_unseen(scene: Scene, relations: ca.SX) -> ca.SX:
    """The relations without placeholders of inertia entries; an error if the motion sees one."""
    owners_of = {
        unseen_name(body.name, entry): (body, entry)
        for body in scene.bodies
        for entry in (*DIAGONAL, *PRODUCTS)
    }
    placeholders = [symbol for symbol in ca.symvar(relations) if symbol.name() in owners_of]
    if not placeholders:
        return relations
    vector = ca.vertcat(*placeholders)
    sensitivity = ca.Function(
        "sensitivity",
        [ca.vertcat(*(s for s in ca.symvar(relations) if s.name() not in owners_of)), vector],
        [ca.jacobian(relations, vector)],
    )
    point = np.random.default_rng(0).uniform(0.5, 1.0, sensitivity.size1_in(0))
    seen = np.max(np.abs(sensitivity(point, np.ones(len(placeholders))).full()), axis=0)
    felt: dict[str, set[str]] = {}
    for symbol, size in zip(placeholders, seen, strict=True):
        if size > _SEEN:
            body, entry = owners_of[symbol.name()]
            felt.setdefault(body.name, set()).update(body.unseen(entry))
    if felt:
        missing = "; ".join(f"body {body!r}: {', '.join(sorted(felt[body]))}" for body in felt)
        raise SceneError(
            f"{missing}: needed, because the joints let the body turn in a way that feels it. Give the "
            "entries (kg m^2); the products are 0 once xx, yy and zz are all given. About its own axis a "
            "beam has the inertia density*(I_y + I_z)*length, with and without torsion."
        )
    return ca.substitute(relations, vector, ca.SX.zeros(len(placeholders)))


# regular mass matrix ---------------------------------------------------------------------------


def _keeps_positive(expressions: ca.SX, symbols: Symbols) -> bool:
    """Whether all entries (n,) are proved to be positive over the range; False: it was not proved."""
    column, parameters = in_doubles(expressions), symbols.parameters
    factors = np.array([p.factor for p in parameters])
    nominal = np.array([p.nominal for p in parameters])
    arguments = (symbols.p, symbols.cosine, symbols.sine)
    function = ca.Function("entries", arguments, [ca.densify(column)])
    if not np.all(function(nominal, np.cos(factors * nominal), np.sin(factors * nominal)).full() > 0.0):
        return False

    def entry(k: int, box: Mapping[str, Interval]) -> Interval:
        intervals = [box.get(p.name, Interval(p.low, p.high)) for p in parameters]
        turns = [item * factor for item, factor in zip(intervals, factors, strict=True)]
        cosine_and_sine = ([FUNCTIONS[name](x) for x in turns] for name in ("cos", "sin"))
        return Interval.of(fold(function, _RULES, intervals, *cosine_and_sine)[0][k])

    used = {s.name() for s in ca.symvar(column)}
    bounds = {
        p.name: (p.low, p.high)
        for k, p in enumerate(parameters)
        if any(argument[k].name() in used for argument in arguments)
    }
    return all(find_zero(partial(entry, k), bounds) is None for k in range(column.numel()))


def _has_energy(values: Values, symbols: Symbols) -> bool:
    """Whether the energy of a body, or of an actuator, is proved not to be negative.

    Numbers have been checked; what depends on parameters has to be positive.
    """
    open_ = [
        label
        for label, value in values.items()
        if label.startswith((*LABELS, "inertia.")) and not is_constant(ca.SX(value))
    ]
    entries = [values[label] for label in open_ if not label.startswith("inertia.")]
    of_inertia = [label for label in open_ if label.startswith("inertia.")]
    if any(label in values and not ca.SX(values[label]).is_zero() for label in _PRODUCTS) and of_inertia:
        if any(label not in values for label in _MATRIX):
            return False
        J = ca.reshape(ca.vertcat(*(ca.SX(values[label]) for label in _MATRIX)), 3, 3)
        entries.append(_pivots(J))
    else:
        entries += [values[label] for label in of_inertia]
    return not entries or _keeps_positive(ca.vertcat(*entries), symbols)


def _efforts_alone(at_rest: kinematics.Placed, link: Link) -> ca.SX:
    """Efforts (n,) of a joint that moves its child, and what is fixed to it, alone."""
    group, links = {link.child.name}, [link]
    for other in at_rest.links:
        if other.parent.name in group and not other.joint.freedoms and other is not link:
            group.add(other.child.name)
            links.append(other)
    alone = replace(at_rest, links=tuple(links))
    moving = kinematics.motions(alone, ca.SX(3, 3), {link.parent.name: ca.SX(3, 3)})
    needed = kinematics.inertial_wrenches(alone, moving)
    return kinematics.pass_inward(alone, moving, {**needed, link.parent.name: ca.SX(3, 2)}).efforts[
        link.owner
    ]


def _pivots(H: ca.SX) -> ca.SX:
    """Pivots (n,) of a symmetric matrix (n, n): it is positive definite if they are positive."""
    return ca.SX(ca.ldl(ca.densify(H), False)[0])  # noqa: FBT003  # in this order
