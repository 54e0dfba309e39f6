"""From a scene to its equations: the recursive Newton-Euler residual of the tree."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import casadi as ca
import numpy as np

from mbdlft.base.description import AXES, Values
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Signal
from mbdlft.multibody.assembly.closure import Closure, close_loops, constraint
from mbdlft.multibody.assembly.gyrostat import body_momenta
from mbdlft.multibody.assembly.kinematics import (
    Passed,
    View,
    inertial_wrenches,
    motions,
    pass_inward,
    place,
)
from mbdlft.multibody.assembly.regular import is_regular
from mbdlft.multibody.assembly.resolved import Resolved, in_plane, resolve
from mbdlft.multibody.assembly.signals import (
    Effort,
    acting,
    body_channels,
    check_springs,
    force_density,
    ground_motion,
    list_efforts,
    measures,
    moved_coordinates,
    static_deflections,
    steady_angles,
    uniform_load,
)
from mbdlft.multibody.assembly.tree import (
    Link,
    PortJoint,
    Symbols,
    all_bodies,
    coordinate_owners,
    degrees,
)
from mbdlft.multibody.assembly.weights import efforts_by_products, gains_by_products, pass_weights_inward
from mbdlft.multibody.body import ElasticBody
from mbdlft.multibody.body.rigid import DIAGONAL, PRODUCTS, unseen_name
from mbdlft.multibody.force import BodyWrench, Spring
from mbdlft.multibody.joint.move import turning_along
from mbdlft.multibody.scene.checks import check_fit
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import Coordinate, column
from mbdlft.problem.equations import Equations, rounded, rows_of
from mbdlft.problem.relations import LinearModel, constraint_relations

_SEEN = 1e-13  # a sensitivity of the equations of order one below which an entry is not seen


@dataclass(frozen=True, slots=True, eq=False)
class Assembly:
    """The equations of a scene, and the same with the weights in another order of products.

    Attributes
    ----------
    equations : Equations
        In doubles.
    exact : Equations
        With constants that are not rounded, as in `sx.constants`.
    second_order : function without arguments
        The exact equations in the other order of products of `weights.py`; None if that gains nothing.
    is_regular : function without arguments
        Whether the accelerations are proved to be determined at every value of the parameters; False
        says that it was not proved.
    constraints : function without arguments
        What has to be regular for the constraints of closed loops to be independent; see `Problem`.
    """

    equations: Equations
    exact: Equations
    second_order: Callable[[], Equations | None]
    is_regular: Callable[[], bool] = lambda: False
    constraints: Callable[[], tuple[LinearModel, LinearModel] | None] = lambda: None


def assemble(scene: Scene) -> Equations:
    """Equations of motion of a scene: x = [displacements, rates] of the joints, u = efforts and loads.

    residual = [qdot - v ; RNEA(q, v, vdot) + springs + dampers - efforts - loads ; closures], the
    recursive Newton-Euler algorithm (Featherstone, section 5.3) outward for motions and inward for
    wrenches, with the acceleration and the spin of the frame given to the ground.

    Raises
    ------
    SceneError, NotRationalError, WellPosednessError
        The joints are not a tree, or one of the quantities cannot be used; see `check`.
    """
    return assembly(scene).equations


def assembly(scene: Scene) -> Assembly:
    """As `assemble`, with both orders of products; the second reuses all but the inward pass."""
    resolved = resolve(scene)
    _check_spin(scene)
    mechanics = _mechanics(in_plane(resolved))
    exact = _equations(mechanics, mechanics.passed())
    return Assembly(
        rounded(exact),
        exact,
        partial(_second_order, mechanics),
        partial(_is_regular, mechanics),
        partial(_constraints, mechanics, exact),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Mechanics:
    """A resolved scene in motion, before wrenches are passed inward.

    Attributes
    ----------
    view : View
        The tree with the motions of its bodies.
    closure : rows of the loops that are kept
    efforts : entries of u
    u, z : SX symbols, as in `Equations`
    base, load : SX (3,)
        Acceleration of the frame less gravity: its value, and symbols where it is not zero.
    field : SX (3,)
        The same with the components that are unknown.
    inertial, loads : SX (3, 2) by body
        Wrenches that the motions need, and those of the loads, with the other sign.
    """

    resolved: Resolved
    view: View
    closure: Closure
    efforts: tuple[Effort, ...]
    u: ca.SX
    z: ca.SX
    base: ca.SX
    load: ca.SX
    field: ca.SX
    inertial: Mapping[str, ca.SX]
    loads: Mapping[str, ca.SX]

    @property
    def has_weights(self) -> bool:
        """Whether the equilibrium is one under a uniform load, in a tree that does not spin."""
        scene = self.resolved.scene
        return self.field.nnz() > 0 and not (scene.spin or scene.loops)

    def passed(self) -> Passed:
        """Inward pass of the inertial wrenches and the loads."""
        now, moving = self.view.now, self.view.motions
        if self.has_weights:
            return pass_weights_inward(now, moving, self.inertial, self.loads, self.field)
        total = {name: self.inertial[name] + self.loads[name] for name in self.inertial}
        return pass_inward(now, moving, total)


def _mechanics(r: Resolved) -> _Mechanics:
    scene, links, values = r.scene, r.links, r.values
    uniform = values[f"scene {scene.name!r}"]
    gravity = column(uniform[f"gravity.{a}"] for a in AXES)
    base = column(uniform[f"acceleration.{a}"] - uniform[f"gravity.{a}"] for a in AXES)
    load = ca.SX.sym("load", base.sparsity())
    view = View(links, all_bodies(scene), values, r.symbols.coordinates(links), gravity)
    closure = close_loops(scene, view, r.symbols.evaluate)
    check_springs(scene, view, r.symbols.evaluate)
    densities = {
        load.name: force_density(load, values[owner_name(load)], view)
        for load in scene.loads
        if isinstance(load, Spring)
    }
    efforts = list_efforts(r, densities, closure)
    u = ca.SX.sym("u", len(efforts))
    z = ca.SX.sym("multiplier", len(closure.rows))
    inertial, loads = body_wrenches(
        r, view, ground_motion(scene, uniform, load, efforts, u), acting(r, view, closure, u, z)
    )
    field = uniform_load(scene, load, efforts, u)
    return _Mechanics(r, view, closure, tuple(efforts), u, z, base, load, field, inertial, loads)


def body_wrenches(
    r: Resolved, view: View, ground: ca.SX, loads: Sequence[BodyWrench]
) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
    """Wrenches (3, 2) by body that the motions need, and those of loads with the other sign.

    The motions, for a motion (3, 3) of the `ground`, and the momenta become those of the view.
    """
    view.momenta = body_momenta(r.links, r.values)
    view.motions = motions(view.now, ground)
    inertial = inertial_wrenches(view.now, view.motions)
    for name, momentum in view.momenta.items():
        inertial[name] += turning_along(view.motions.bodies[name], momentum)
    against = {name: ca.SX(3, 2) for name in inertial}
    for load in loads:
        if load.body in against:
            against[load.body] -= load.wrench
    return inertial, against


def _is_regular(m: _Mechanics) -> bool:
    """By the theorem of `regular.py`, for a tree."""
    r = m.resolved
    if r.scene.loops:
        return False
    coordinates = {
        owner: Coordinate(zero := ca.SX(at.q.numel(), 1), zero, at.a)
        for owner, at in m.view.coordinates.items()
    }
    now = m.view.now
    at_rest = place(now.links, now.bodies, now.values, coordinates)
    accelerations = {owner: at.a for owner, at in m.view.coordinates.items()}
    symbols = (r.symbols.p, r.symbols.cosine, r.symbols.sine)
    return is_regular(at_rest, accelerations, r.parameters, symbols)


def _constraints(m: _Mechanics, exact: Equations) -> tuple[LinearModel, LinearModel] | None:
    """Relations of the closures, whose displacements stand behind the dynamics in the residual."""
    first = 2 * exact.degrees_of_freedom
    rows = range(first, first + len(m.closure.rows))
    return constraint_relations(exact, rows, m.closure.dependent)


def _second_order(m: _Mechanics) -> Equations | None:
    """The equations in the other order of products; None if that gains nothing."""
    now, moving = m.view.now, m.view.motions
    if not (m.has_weights and gains_by_products(now)):
        return None
    passed = m.passed()
    efforts = efforts_by_products(now, moving, m.inertial, m.loads, m.field)
    return _equations(m, passed._replace(efforts={**passed.efforts, **efforts}))


def _equations(m: _Mechanics, passed: Passed) -> Equations:
    r, view, symbols = m.resolved, m.view, m.resolved.symbols
    scene, links = r.scene, r.links
    view.passed = passed
    channels = body_channels(r, view, m.u, [e.signal.name for e in m.efforts])
    efforts, deflections = static_deflections(r, m.closure, m.u)
    dynamics = _dynamics(links, symbols, r.values, view, efforts) - channels.forces
    n = symbols.q.numel()
    held = [constraint(scene.loops, view, order)[list(m.closure.rows)] for order in range(3)]
    if m.closure.yielding:
        held[0] = ca.substitute(held[0], symbols.q, symbols.q + deflections)
    moved = moved_coordinates(links, [effort.signal.name for effort in m.efforts])
    held += [symbols.x[c.coordinate + k * n] - m.u[c.inputs[k]] for c in moved for k in range(2)]
    residual = ca.vertcat(symbols.xdot[:n] - symbols.x[n:], dynamics, *held)
    measured, y_signals, default = measures(r, view, channels)
    both = without_unseen(scene, ca.vertcat(residual, measured))
    carried, carried_by = _carried(links, view)
    every = degrees(links)
    coordinate_signals = [degree.measure(order) for order in range(2) for degree in every]
    effort_signals = [effort.signal for effort in m.efforts]
    check_fit(scene, [*coordinate_signals[:n], *effort_signals])
    followers = {*m.closure.dependent, *(c.coordinate for c in moved)}
    followers |= {n + k for k in followers}
    states = tuple(k for k in range(2 * n) if k not in followers)
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
        ignorable=tuple(states.index(k) for k in steady_angles(links) if k in states),
        moved=moved,
        carried=carried,
        carried_by=carried_by,
        parameters=r.parameters,
        x_bounds=_bounds(scene, coordinate_signals[:n]),
        u_bounds=_bounds(scene, effort_signals),
    )


def _bounds(scene: Scene, signals: Sequence[Signal]) -> tuple[float, ...]:
    """Bounds of the fit of the scene by signal, zero where it has none."""
    bounds = scene.fit.bounds if scene.fit else {}
    return tuple(float(bounds.get(signal.name, 0.0)) for signal in signals)


def _check_spin(scene: Scene) -> None:
    bodies = (body for body in scene.bodies if isinstance(body, ElasticBody))
    elastic = [body.name for body in bodies if not body.can_spin]
    if scene.spin and elastic:
        raise SceneError(
            f"scene {scene.name!r}: the frame spins and body {elastic[0]!r} is elastic. Centrifugal "
            "loads change its stiffness, which is known for a 'beam' without torsion, shear and rotary "
            "inertia only: modal data do not say it. Use such beams, or rigid bodies and springs."
        )


def _dynamics(
    links: tuple[Link, ...],
    symbols: Symbols,
    values: Mapping[str, Values],
    view: View,
    acting_efforts: ca.SX,
) -> ca.SX:
    """Efforts needed minus those that act (n,); of an imposed joint, the acceleration minus the input."""
    needed = ca.vertcat(*(view.passed.efforts[owned.owner] for owned in coordinate_owners(links)))
    rows: list[ca.SX] = []
    for row, degree in enumerate(degrees(links)):
        if degree.kind in ("imposed", "motion"):
            rows.append(symbols.a[row] - acting_efforts[row])
            continue
        effort, quantities = needed[row], values.get(degree.owner, {})
        if degree.kind == "joint":
            effort += quantities.get(degree.label("stiffness"), 0.0) * symbols.q[row]
            rate = symbols.v[row] + quantities.get("rate", 0.0)
            effort += quantities.get(degree.label("damping"), 0.0) * rate
        rows.append(effort - acting_efforts[row])
    return ca.vertcat(*rows)


def _carried(links: tuple[Link, ...], view: View) -> tuple[ca.SX, tuple[str, ...]]:
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
        unseen_name(body.name, entry): (body.name, entry)
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
    felt: dict[str, list[str]] = {}
    for symbol, size in zip(placeholders, seen, strict=True):
        if size > _SEEN:
            body, entry = owners_of[symbol.name()]
            felt.setdefault(body, []).append(f"inertia.{entry}")
    if felt:
        missing = "; ".join(f"body {body!r}: {', '.join(sorted(set(felt[body])))}" for body in felt)
        raise SceneError(
            f"{missing}: needed, because the joints let the body turn in a way that feels it. Give the "
            "entries (kg m^2); the products are 0 once xx, yy and zz are all given."
        )
    return ca.substitute(relations, vector, ca.SX.zeros(len(placeholders)))
