"""From a scene to its equations: the recursive Newton-Euler residual of the tree."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbdlft.analyze.sample import random
from mbdlft.body import ElasticBody
from mbdlft.body.rigid import DIAGONAL, PRODUCTS, unseen_name
from mbdlft.description import AXES, Values
from mbdlft.equations import Equations, SpringLaw
from mbdlft.errors import NotRationalError, SceneError
from mbdlft.force import BodyWrench, Spring
from mbdlft.joint import Turn, labelled
from mbdlft.lft.lft import Array
from mbdlft.parameter import Parameter
from mbdlft.scene.channels import body_channels, body_inputs
from mbdlft.scene.check import check
from mbdlft.scene.closure import Closure, close_loops, constraint, reactions
from mbdlft.scene.placed import inertial_wrenches, motions, pass_inward
from mbdlft.scene.quantities import Place, angle_at, owner_name, owners, value_at
from mbdlft.scene.scene import Scene
from mbdlft.scene.tree import Link, PortJoint, all_bodies, tree
from mbdlft.scene.view import View
from mbdlft.signal import Freedom, Signal
from mbdlft.spatial import Coordinate, exact_cosine_sine
from mbdlft.unit import parse_unit

_SEEN = 1e-13  # a sensitivity of the equations of order one below which an entry is not seen
_POINTS = 16  # random points at which loops are checked, beside nominal
GROUND_ACCELERATION = tuple(f"ground.acceleration.{axis}" for axis in AXES)


class Effort(NamedTuple):
    """One entry of u: its name, its trim value (None: unknown), whether it can be an input."""

    signal: Signal
    given: ca.SX | float | None
    is_input: bool = True
    is_default: bool = True


class Owned(NamedTuple):
    """Coordinates of a joint or of an elastic body."""

    owner: str
    name: str
    freedoms: tuple[Freedom, ...]
    kind: str  # "joint", "imposed" or "elastic"


def coordinate_owners(links: tuple[Link, ...]) -> list[Owned]:
    """Joints and bodies from the ground outward; each body after the joint that holds it."""
    found = []
    for link in links:
        joint, body = link.joint, link.child
        if not isinstance(joint, PortJoint):
            kind = "imposed" if getattr(joint, "imposed", False) else "joint"
            found.append(Owned(link.owner, joint.name, joint.freedoms, kind))
        found.append(Owned(owner_name(body), body.name, body.freedoms(), "elastic"))
    return found


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
    links = tree(scene)
    check(scene)
    _check_spin(scene)
    parameters = tuple(sorted(scene.parameters, key=lambda parameter: parameter.name))
    symbols = _Symbols(scene, parameters, links)
    values = symbols.quantities(scene)
    own = values[f"scene {scene.name!r}"]
    gravity = ca.sparsify(ca.SX(ca.vertcat(*(own[f"gravity.{a}"] for a in AXES))))
    view = View(links, all_bodies(scene), values, symbols.coordinates(links), gravity)
    elastic = view.elastic = ca.SX.sym("elastic")
    closure = close_loops(scene, view, symbols.evaluate)

    listed = _efforts(scene, links, values, view, closure)
    u = ca.SX.sym("u", len(listed))
    z = ca.SX.sym("multiplier", len(closure.rows))
    base = ca.vertcat(*(own[f"acceleration.{a}"] - own[f"gravity.{a}"] for a in AXES))
    base = ca.sparsify(ca.SX(base))
    load = ca.SX.sym("load", base.sparsity())
    view.motions = motions(view.now, _ground_motion(scene, own, load, listed, u))
    needed = inertial_wrenches(view.now, view.motions)
    for acted in _acting(scene, links, values, view, closure, u, z):
        if acted.body in needed:
            needed[acted.body] -= acted.wrench
    view.passed = pass_inward(view.now, view.motions, needed)
    channels = body_channels(links, values, view, u, [effort.signal.name for effort in listed])
    dynamics = _dynamics(links, symbols, values, view, u) - channels.forces
    n = symbols.q.numel()
    carried, carried_by = _carried(links, view)
    held = [constraint(scene.loops, view, order)[list(closure.rows)] for order in range(3)]
    residual = ca.vertcat(symbols.xdot[:n] - symbols.x[n:], dynamics, *held)
    measured, y_signals, displacements = _measures(scene, links, symbols, view)
    displacements += tuple(len(y_signals) + k for k in range(len(channels.signals)))
    measured, y_signals = ca.vertcat(measured, channels.outputs), y_signals + channels.signals
    both = _without_unseen(scene, ca.vertcat(residual, measured), symbols)
    coordinate_signals = [
        Signal(f"{named.name}.{freedom.measures[k].name}", freedom.measures[k].unit)
        for k in range(2)
        for named in coordinate_owners(links)
        for freedom in named.freedoms
    ]
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
        springs=_spring_laws(scene, values, view, listed),
        elastic=elastic,
        carried=carried,
        carried_by=carried_by,
        parameters=parameters,
    )


def _check_spin(scene: Scene) -> None:
    elastic = [body.name for body in scene.bodies if isinstance(body, ElasticBody)]
    if scene.spin and elastic:
        raise SceneError(
            f"scene {scene.name!r}: the frame spins and body {elastic[0]!r} is elastic. Centrifugal "
            "loads change its stiffness, which modal data do not say. Use rigid bodies and springs."
        )


class _Symbols:
    """The symbols of one assembly."""

    def __init__(
        self, scene: Scene, parameters: tuple[Parameter, ...], links: tuple[Link, ...]
    ) -> None:
        n = sum(len(named.freedoms) for named in coordinate_owners(links))
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
        self.names: dict[str, Any] = dict(scene.constant_values())
        for name, k in self.index.items():
            factor = parse_unit(parameters[k].unit).factor
            self.names[name] = self.p[k] if factor == 1.0 else factor * self.p[k]

    def coordinates(self, links: tuple[Link, ...]) -> dict[str, Coordinate]:
        """Slices of q, v and a by owner, in the order of `coordinate_owners`."""
        found, k = {}, 0
        for named in coordinate_owners(links):
            part = slice(k, k := k + len(named.freedoms))
            found[named.owner] = Coordinate(self.q[part], self.v[part], self.a[part])
        return found

    def quantities(self, scene: Scene) -> dict[str, Values]:
        """Values of all quantities by owner and label; an angle is a tuple of turns."""
        return {
            owner: {
                label: self._turns(scene, Place(owner, label), expected)
                if expected.unit == "rad"
                else value_at(Place(owner, label), expected, self.names)
                for label, expected in quantities.items()
            }
            for owner, quantities in owners(scene)
        }

    def _turns(self, scene: Scene, place: Place, expected: Any) -> tuple[Turn, ...]:
        angle = angle_at(scene, place, expected)
        found = [
            Turn(
                self.cosine[self.index[name]],
                (1.0 if count > 0 else -1.0) * self.sine[self.index[name]],
            )
            for name, count in angle.multiples.items()
            for _ in range(abs(count))
        ]
        if angle.constant != 0.0:
            found.append(Turn(*exact_cosine_sine(angle.constant)))
        return tuple(found)

    def evaluate(self, expression: ca.SX) -> list[Array]:
        """Values of an expression of the parameters, at nominal and at random points."""
        function = ca.Function("values", [self.p, self.cosine, self.sine], [ca.densify(expression)])
        points = [np.array([parameter.nominal for parameter in self.parameters])]
        if self.parameters:
            inside = random(self.parameters, _POINTS, 0)
            points += list(np.stack([inside[p.name] for p in self.parameters], axis=1))
        factors = np.array([parse_unit(parameter.unit).factor for parameter in self.parameters])
        return [
            function(point, np.cos(factors * point), np.sin(factors * point)).full()
            for point in points
        ]


def _efforts(
    scene: Scene,
    links: tuple[Link, ...],
    values: Mapping[str, Values],
    view: View,
    closure: Closure,
) -> list[Effort]:
    """Entries of u: of joints, loads, the ground if it is asked for, and the multipliers."""
    found: list[Effort] = []
    for owner, name, freedoms, kind in coordinate_owners(links):
        for freedom in freedoms:
            signal = freedom.measures[2] if kind == "imposed" else freedom.effort
            given = values.get(owner, {}).get(labelled("preload", freedom))
            given = 0.0 if kind == "imposed" else given
            is_input = kind != "elastic"  # the force that holds a static deflection is internal
            named = Signal(f"{name}.{signal.name}", signal.unit)
            found.append(Effort(named, given, is_input=is_input, is_default=is_input))
    for load in scene.loads:
        own = values[owner_name(load)]
        given = own.get(load.magnitude_key)
        if isinstance(load, Spring) and load.rest_length is not None:
            given = _force_density(load, own, view)
        found.append(Effort(Signal(f"{load.name}.{load.signal.name}", load.signal.unit), given))
    found += [Effort(signal, 0.0) for link in links for signal in body_inputs(link.child)]
    asked = set(scene.inputs or ())
    found += [
        Effort(Signal(name, "m/s^2"), 0.0, is_default=False)
        for name in GROUND_ACCELERATION
        if name in asked
    ]
    multipliers = [signal for loop in scene.loops for signal in loop.signals()]
    return found + [
        Effort(multipliers[k], None, is_input=False, is_default=False) for k in closure.rows
    ]


def _force_density(spring: Spring, own: Values, view: View) -> Any:
    """Tension over length at equilibrium of a spring with a rest length."""
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
    if length == 0.0:
        raise SceneError(f"{view.owner}: its ports are at one point, so it has no direction.")
    return own["stiffness"] * (1.0 - own["rest_length"] / length)


def _ground_motion(
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


def _acting(
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


def _dynamics(
    links: tuple[Link, ...],
    symbols: _Symbols,
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
                effort += _of(own, "stiffness", freedom) * symbols.q[row]
                effort += _of(own, "damping", freedom) * symbols.v[row]
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


def _of(own: Values, key: str, freedom: Freedom) -> Any:
    return own.get(labelled(key, freedom), 0.0)


def _without_unseen(scene: Scene, relations: ca.SX, symbols: _Symbols) -> ca.SX:
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
    scene: Scene, links: tuple[Link, ...], symbols: _Symbols, view: View
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
        entries.append(sensor.measure(view))
        signals += named
    return ca.vertcat(*entries), tuple(signals), tuple(default)


def _spring_laws(
    scene: Scene, values: Mapping[str, Values], view: View, listed: Sequence[Effort]
) -> tuple[SpringLaw, ...]:
    """Laws of the springs with a rest length, for displacements that are not small."""
    names = [effort.signal.name for effort in listed]
    found = []
    for load in scene.loads:
        if isinstance(load, Spring) and load.rest_length is not None:
            view.owner = owner_name(load)
            own, r = values[view.owner], view.between(load.parent, load.child)
            index = names.index(f"{load.name}.{load.signal.name}")
            found.append(
                SpringLaw(index, ca.dot(r, r), ca.SX(own["stiffness"]), ca.SX(own["rest_length"]))
            )
    return tuple(found)
