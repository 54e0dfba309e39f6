"""From a scene to its equations: the recursive Newton-Euler residual of the tree."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import AXES, Values
from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.base.signal import Freedom, Signal
from mbdlft.multibody.assembly.aligned import Aligned, align
from mbdlft.multibody.assembly.body_signals import body_channels, body_inputs
from mbdlft.multibody.assembly.closure import Closure, close_loops, constraint, reactions
from mbdlft.multibody.assembly.placed import Passed, inertial_wrenches, motions, pass_inward
from mbdlft.multibody.assembly.second_order import efforts_by_products, gains_by_products
from mbdlft.multibody.assembly.symbols import Symbols, coordinate_owners
from mbdlft.multibody.assembly.tree import Link, PortJoint, all_bodies, tree
from mbdlft.multibody.assembly.view import View
from mbdlft.multibody.assembly.weights import pass_weights_inward
from mbdlft.multibody.body import ElasticBody
from mbdlft.multibody.body.rigid import DIAGONAL, PRODUCTS, unseen_name
from mbdlft.multibody.force import BodyWrench, Spring
from mbdlft.multibody.joint import coordinate_label
from mbdlft.multibody.scene.check import check, check_fit
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.spatial import column
from mbdlft.problem.equations import Equations

_SEEN = 1e-13  # a sensitivity of the equations of order one below which an entry is not seen
_APART = 1e-9  # of the reach of its ports: a spring that is shorter has no direction
GROUND_ACCELERATION = tuple(f"ground.acceleration.{axis}" for axis in AXES)


class Effort(NamedTuple):
    """One entry of u: its name, its trim value (None: unknown), whether it can be an input."""

    signal: Signal
    given: ca.SX | float | None
    is_input: bool = True
    is_default: bool = True


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
    found = _assemble(scene, by_products=False)
    assert found is not None
    return found


def assemble_by_products(scene: Scene) -> Equations | None:
    """As `assemble`, with the weights in the order of `products`; None if that gains nothing."""
    return _assemble(scene, by_products=True)


def _assemble(scene: Scene, *, by_products: bool) -> Equations | None:
    """As `assemble`, or `assemble_by_products`."""
    links = tree(scene)
    check(scene)
    _check_spin(scene)
    parameters = tuple(sorted(scene.parameters, key=lambda parameter: parameter.name))
    symbols = Symbols(scene, parameters, links)
    values: Mapping[str, Values] = symbols.quantities(scene)
    aligned = align(scene, values, symbols.evaluate)
    if aligned:
        scene, values = aligned.scene, aligned.values
        links = tree(scene)
    own = values[f"scene {scene.name!r}"]
    gravity = column(own[f"gravity.{a}"] for a in AXES)
    view = View(links, all_bodies(scene), values, symbols.coordinates(links), gravity)
    base = column(own[f"acceleration.{a}"] - own[f"gravity.{a}"] for a in AXES)
    load = ca.SX.sym("load", base.sparsity())
    if by_products and not (_has_weights(scene, load) and gains_by_products(view.now)):
        return None
    closure = close_loops(scene, view, symbols.evaluate)
    _check_springs(scene, view, symbols.evaluate)

    densities = {
        load.name: _force_density(load, values[owner_name(load)], view)
        for load in scene.loads
        if isinstance(load, Spring)
    }
    listed = list_efforts(scene, links, values, densities, closure.rows)
    u = ca.SX.sym("u", len(listed))
    z = ca.SX.sym("multiplier", len(closure.rows))
    view.motions = motions(view.now, ground_motion(scene, own, load, listed, u))
    acted = acting(scene, links, values, view, closure, u, z)
    view.passed = _passed(scene, view, acted, load, by_products=by_products)
    channels = body_channels(links, values, view, u, [effort.signal.name for effort in listed])
    dynamics = _dynamics(links, symbols, values, view, u) - channels.forces
    n = symbols.q.numel()
    carried, carried_by = _carried(links, view)
    held = [constraint(scene.loops, view, order)[list(closure.rows)] for order in range(3)]
    residual = ca.vertcat(symbols.xdot[:n] - symbols.x[n:], dynamics, *held)
    measured, y_signals, displacements = _measures(scene, links, symbols, view, aligned)
    displacements += tuple(len(y_signals) + k for k in range(len(channels.signals)))
    measured, y_signals = ca.vertcat(measured, channels.outputs), y_signals + channels.signals
    both = without_unseen(scene, ca.vertcat(residual, measured))
    coordinate_signals = [
        Signal(f"{named.name}.{freedom.measures[k].name}", freedom.measures[k].unit)
        for k in range(2)
        for named in coordinate_owners(links)
        for freedom in named.freedoms
    ]
    check_fit(scene, [*coordinate_signals[:n], *(effort.signal for effort in listed)])
    followers = {*closure.dependent, *(n + k for k in closure.dependent)}
    states = tuple(k for k in range(2 * n) if k not in followers)
    return Equations(
        name=scene.name,
        residual=both[: residual.numel()],
        output=both[residual.numel() :],
        xdot=symbols.xdot,
        x=symbols.x,
        z=z,
        u=u,
        load=ca.SX(load.nz[:]),
        p=symbols.p,
        cosine=symbols.cosine,
        sine=symbols.sine,
        load_value=ca.SX(base.nz[:]),
        given=ca.SX(
            ca.vertcat(*(0.0 if effort.given is None else effort.given for effort in listed))
        ),
        unknown=tuple(k for k, effort in enumerate(listed) if effort.given is None),
        inputs=tuple(k for k, effort in enumerate(listed) if effort.is_input),
        states=states,
        x_signals=tuple(coordinate_signals[k] for k in states),
        u_signals=tuple(effort.signal for effort in listed),
        y_signals=y_signals,
        equilibrium_signals=tuple(
            Signal(f"{named.name}.{freedom.effort.name}", freedom.effort.unit)
            for named in coordinate_owners(links)
            for freedom in named.freedoms
        ),
        default_inputs=tuple(k for k, effort in enumerate(listed) if effort.is_default),
        default_outputs=displacements,
        carried=carried,
        carried_by=carried_by,
        parameters=parameters,
        x_bounds=_bounds(scene, coordinate_signals[:n]),
        u_bounds=_bounds(scene, [effort.signal for effort in listed]),
    )


def _bounds(scene: Scene, signals: Sequence[Signal]) -> tuple[float, ...]:
    """Bounds of the fit of the scene by signal, zero where it has none."""
    bounds = scene.fit.bounds if scene.fit else {}
    return tuple(float(bounds.get(signal.name, 0.0)) for signal in signals)


def _check_spin(scene: Scene) -> None:
    elastic = [body.name for body in scene.bodies if isinstance(body, ElasticBody)]
    if scene.spin and elastic:
        raise SceneError(
            f"scene {scene.name!r}: the frame spins and body {elastic[0]!r} is elastic. Centrifugal "
            "loads change its stiffness, which modal data do not say. Use rigid bodies and springs."
        )


def list_efforts(
    scene: Scene,
    links: tuple[Link, ...],
    values: Mapping[str, Values],
    densities: Mapping[str, Any],
    rows: Sequence[int],
) -> list[Effort]:
    """Entries of u: of joints, loads, the ground if it is asked for, and multipliers.

    `densities` are force densities of the springs by name (None: unknown), `rows` the constraints of
    the loops that are kept.
    """
    found: list[Effort] = []
    for owner, name, freedoms, kind in coordinate_owners(links):
        for freedom in freedoms:
            signal = freedom.measures[2] if kind == "imposed" else freedom.effort
            given = values.get(owner, {}).get(coordinate_label("preload", freedom))
            given = 0.0 if kind == "imposed" else given
            is_input = kind != "elastic"  # the force that holds a static deflection is internal
            named = Signal(f"{name}.{signal.name}", signal.unit)
            found.append(Effort(named, given, is_input=is_input, is_default=is_input))
    for load in scene.loads:
        given = values[owner_name(load)].get(load.magnitude_key)
        given = densities.get(load.name, given)
        found.append(Effort(Signal(f"{load.name}.{load.signal.name}", load.signal.unit), given))
    found += [Effort(signal, 0.0) for link in links for signal in body_inputs(link.child)]
    asked = set(scene.inputs or ())
    found += [
        Effort(Signal(name, "m/s^2"), 0.0, is_default=False)
        for name in GROUND_ACCELERATION
        if name in asked
    ]
    multipliers = [signal for loop in scene.loops for signal in loop.signals()]
    return found + [Effort(multipliers[k], None, is_input=False, is_default=False) for k in rows]


def _check_springs(scene: Scene, view: View, evaluate: Callable[[ca.SX], Sequence[Array]]) -> None:
    """The ports of springs are apart at nominal and at other points of the range."""
    for load in scene.loads:
        if not isinstance(load, Spring):
            continue
        view.owner = owner_name(load)
        gaps, reach = view.gaps(load.parent, load.child, evaluate)
        apart = [float(np.linalg.norm(gap)) for gap in gaps]
        if min(apart) <= _APART * reach:
            raise SceneError(
                f"{view.owner}: its ports are at one point, so it has no direction. Move one of the "
                f"ports {load.parent!r} and {load.child!r}, or the equilibrium."
            )


def _force_density(spring: Spring, own: Values, view: View) -> Any:
    """Tension over length of a spring at equilibrium; None if it is not given."""
    if spring.rest_length is None:
        return own.get(spring.magnitude_key)
    view.owner = owner_name(spring)
    r = view.between_at_rest(spring.parent, spring.child)
    length2 = ca.dot(r, r)
    if ca.symvar(length2):
        raise NotRationalError(
            f"{view.owner}: the distance of its ports depends on parameters, and its tension "
            "stiffness*(length - rest_length) has the square root of a polynomial. Give the tension over "
            "the length as force_density (N/m), or leave both out and let the trim solve for it."
        )
    length = float(ca.DM(ca.sqrt(length2)))
    return own["stiffness"] * (1.0 - own["rest_length"] / length)


def ground_motion(
    scene: Scene, own: Values, load: ca.SX, listed: Sequence[Effort], u: ca.SX
) -> ca.SX:
    """Motion (3, 3) of the origin of the ground: spin of the frame, and its acceleration."""
    names = [effort.signal.name for effort in listed]
    spin = ca.SX(3, 1)
    if scene.spin:
        axis = np.asarray(scene.spin.axis) / np.linalg.norm(scene.spin.axis)
        spin = ca.sparsify(ca.SX(axis)) * own["spin.rate"]
    asked = {name: u[names.index(name)] for name in GROUND_ACCELERATION if name in names}
    if asked:
        load = load + ca.vertcat(*(asked.get(name, 0.0) for name in GROUND_ACCELERATION))
    return ca.horzcat(spin, ca.SX(3, 1), load)


def acting(
    scene: Scene,
    links: tuple[Link, ...],
    values: Mapping[str, Values],
    view: View,
    closure: Closure,
    u: ca.SX,
    z: ca.SX,
) -> list[BodyWrench]:
    """Wrenches on bodies of all loads and loop closures."""
    k = sum(len(named.freedoms) for named in coordinate_owners(links))
    found: list[BodyWrench] = []
    for load in scene.loads:
        view.owner = owner_name(load)
        found += load.wrenches(values[view.owner], u[k], view)
        k += 1
    count = sum(len(loop.signals()) for loop in scene.loops)
    multipliers = ca.SX(count, 1)
    for position, row in enumerate(closure.rows):
        multipliers[row] = u[u.numel() - len(closure.rows) + position] + z[position]
    return found + reactions(scene.loops, view, multipliers)


def _has_weights(scene: Scene, load: ca.SX) -> bool:
    """Whether the equilibrium is one under a uniform load, in a tree that does not spin."""
    return load.nnz() > 0 and not (scene.spin or scene.loops)


def _passed(
    scene: Scene, view: View, acted: Sequence[BodyWrench], load: ca.SX, *, by_products: bool
) -> Passed:
    """Inward pass of the inertial wrenches and the loads."""
    needed = inertial_wrenches(view.now, view.motions)
    loads = {name: ca.SX(3, 2) for name in needed}
    for on in acted:
        if on.body in loads:
            loads[on.body] -= on.wrench
    if _has_weights(scene, load):
        passed = pass_weights_inward(view.now, view.motions, needed, loads, load)
        if by_products:
            efforts = efforts_by_products(view.now, view.motions, needed, loads, load)
            passed = passed._replace(efforts={**passed.efforts, **efforts})
        return passed
    return pass_inward(
        view.now, view.motions, {name: needed[name] + loads[name] for name in needed}
    )


def _dynamics(
    links: tuple[Link, ...],
    symbols: Symbols,
    values: Mapping[str, Values],
    view: View,
    u: ca.SX,
) -> ca.SX:
    """Efforts needed minus efforts given (n,); for an imposed joint its acceleration minus the input."""
    rows: list[ca.SX] = []
    for owner, _, freedoms, kind in coordinate_owners(links):
        own, needed = values.get(owner, {}), view.passed.efforts[owner]
        for k, freedom in enumerate(freedoms):
            row = len(rows)
            if kind == "imposed":
                rows.append(symbols.a[row] - u[row])
                continue
            effort = needed[k]
            if kind == "joint":
                effort += quantity_of(own, "stiffness", freedom) * symbols.q[row]
                effort += quantity_of(own, "damping", freedom) * symbols.v[row]
            rows.append(effort - u[row])
    return ca.vertcat(*rows)


def _carried(links: tuple[Link, ...], view: View) -> tuple[ca.SX, tuple[str, ...]]:
    """Wrenches through the ports of elastic bodies whose prestress is not said to be negligible."""
    wrenches: list[ca.SX] = []
    names: list[str] = []
    for link in links:
        body = link.parent if isinstance(link.joint, PortJoint) else link.child
        if isinstance(body, ElasticBody) and body.prestress is None:
            wrenches.append(ca.vec(view.passed.joints[link.child.name]))
            names += [body.name] * 6
    return ca.vertcat(ca.SX(0, 1), *wrenches), tuple(names)


def quantity_of(own: Values, key: str, freedom: Freedom) -> Any:
    """Value of a quantity of one coordinate; zero if the joint has none."""
    return own.get(coordinate_label(key, freedom), 0.0)


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


def _measures(
    scene: Scene, links: tuple[Link, ...], symbols: Symbols, view: View, aligned: Aligned | None
) -> tuple[ca.SX, tuple[Signal, ...], tuple[int, ...]]:
    """Outputs: measures of all joints, and the sensors that are asked for.

    Returns
    -------
    expressions (n_y,), signals (n_y), positions of the default outputs
    """
    entries: list[ca.SX] = []
    signals: list[Signal] = []
    default: list[int] = []
    row = 0
    for _, name, freedoms, kind in coordinate_owners(links):
        for freedom in freedoms:
            if kind != "elastic":
                default.append(len(entries))
            for measure, value in zip(
                freedom.measures, (symbols.q, symbols.v, symbols.a), strict=True
            ):
                entries.append(value[row])
                signals.append(Signal(f"{name}.{measure.name}", measure.unit))
            row += 1
    for sensor in scene.sensors:
        named = sensor.signals()
        if scene.outputs is not None and not {s.name for s in named} & set(scene.outputs):
            continue
        view.owner = f"sensor {sensor.name!r}"
        default += range(len(signals), len(signals) + len(named))
        measured = sensor.measure(view)
        entries.append(aligned.back(measured) if aligned else measured)
        signals += named
    return ca.vertcat(*entries), tuple(signals), tuple(default)
