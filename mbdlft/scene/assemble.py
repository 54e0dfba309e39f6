"""From a scene to its equations: the recursive Newton-Euler residual of the tree."""

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from mbdlft.body import Body
from mbdlft.body.rigid import DIAGONAL, PRODUCTS, unseen_name
from mbdlft.description import AXES
from mbdlft.equations import Equations
from mbdlft.errors import SceneError
from mbdlft.joint import Coordinate, Turn
from mbdlft.parameter import Parameter
from mbdlft.scene.check import check
from mbdlft.scene.quantities import Place, angle_at, owner_name, owners, value_at
from mbdlft.scene.scene import Scene
from mbdlft.scene.tree import Link, tree
from mbdlft.signal import Signal
from mbdlft.spatial import exact_cosine_sine, move_motion, move_wrench
from mbdlft.unit import parse_unit

_SEEN = 1e-13  # a sensitivity of the equations of order one below which an entry is not seen

Values = Mapping[str, Any]


def assemble(scene: Scene) -> Equations:
    """Equations of motion of a scene: x = [displacements, rates] of the joints, u = joint efforts.

    residual = [qdot - v ; RNEA(q, v, vdot) + springs + dampers - u], the recursive Newton-Euler
    algorithm (Featherstone, section 5.3) outward for motions and inward for wrenches, with the
    uniform acceleration of the frame given to the ground.

    Raises
    ------
    SceneError, NotRationalError, WellPosednessError
        The scene is not a tree, or one of its quantities cannot be used; see `check`.
    """
    links = tree(scene)
    check(scene)
    parameters = tuple(sorted(scene.parameters, key=lambda parameter: parameter.name))
    symbols = _Symbols(scene, parameters, links)
    values, turns = symbols.quantities(scene, links)
    gravity = values[f"scene {scene.name!r}"]
    base = ca.vertcat(*(gravity[f"acceleration.{a}"] - gravity[f"gravity.{a}"] for a in AXES))
    base = ca.sparsify(ca.SX(base))
    load = ca.SX.sym("load", base.sparsity())
    residual = _newton_euler(links, symbols, values, turns, ca.horzcat(ca.SX(3, 2), load))
    n = symbols.q.numel()
    residual = ca.vertcat(symbols.xdot[:n] - symbols.x[n:], residual - symbols.u)
    residual = _without_unseen(scene, residual, symbols)
    measured, y_signals = _measures(links, symbols)
    moving = [link for link in links if link.joint.degrees_of_freedom]
    return Equations(
        name=scene.name,
        residual=residual,
        output=measured,
        xdot=symbols.xdot,
        x=symbols.x,
        z=ca.SX(0, 1),
        u=symbols.u,
        load=ca.SX(load.nz[:]),
        p=symbols.p,
        cosine=symbols.cosine,
        sine=symbols.sine,
        load_value=ca.SX(base.nz[:]),
        x_signals=tuple(
            Signal(f"{link.joint.name}.{link.joint.measures[k][0]}", link.joint.measures[k][1])
            for k in (0, 1)
            for link in moving
        ),
        u_signals=tuple(
            Signal(f"{link.joint.name}.{link.joint.effort[0]}", link.joint.effort[1])
            for link in moving
            if link.joint.effort
        ),
        y_signals=y_signals,
        parameters=parameters,
    )


class _Symbols:
    """The symbols of one assembly."""

    def __init__(
        self, scene: Scene, parameters: tuple[Parameter, ...], links: tuple[Link, ...]
    ) -> None:
        n = sum(link.joint.degrees_of_freedom for link in links)
        if n == 0:
            raise SceneError(f"scene {scene.name!r}: all joints are fixed, so nothing moves.")
        self.x = ca.SX.sym("x", 2 * n)
        self.xdot = ca.SX.sym("xdot", 2 * n)
        self.u = ca.SX.sym("u", n)
        self.q, self.v, self.a = self.x[:n], self.x[n:], self.xdot[n:]
        self.p = ca.SX.sym("p", len(parameters))
        self.cosine = ca.SX.sym("cosine", len(parameters))
        self.sine = ca.SX.sym("sine", len(parameters))
        self.index = {parameter.name: k for k, parameter in enumerate(parameters)}
        self.names: dict[str, Any] = dict(scene.constant_values())
        for name, k in self.index.items():
            factor = parse_unit(parameters[k].unit).factor
            self.names[name] = self.p[k] if factor == 1.0 else factor * self.p[k]

    def coordinates(self, links: tuple[Link, ...]) -> list[Coordinate]:
        """Slices of q, v and a for each link."""
        found, k = [], 0
        for link in links:
            part = slice(k, k := k + link.joint.degrees_of_freedom)
            found.append(Coordinate(self.q[part], self.v[part], self.a[part]))
        return found

    def quantities(
        self, scene: Scene, links: tuple[Link, ...]
    ) -> tuple[dict[str, Values], dict[str, list[Turn]]]:
        """Values of all quantities by owner, and the equilibrium rotation of each joint."""
        values: dict[str, Values] = {}
        turns: dict[str, list[Turn]] = {}
        for owner, quantities in owners(scene):
            values[owner] = {
                label: value_at(Place(owner, label), expected, self.names)
                for label, expected in quantities.items()
                if expected.unit != "rad"
            }
            for label, expected in quantities.items():
                if expected.unit == "rad":
                    angle = angle_at(scene, Place(owner, label), expected)
                    turns[owner] = self._turns(angle.constant, angle.multiples)
        return values, turns

    def _turns(self, constant: float, multiples: Mapping[str, int]) -> list[Turn]:
        found = [
            Turn(
                self.cosine[self.index[name]],
                (1.0 if count > 0 else -1.0) * self.sine[self.index[name]],
            )
            for name, count in multiples.items()
            for _ in range(abs(count))
        ]
        if constant != 0.0:
            found.append(Turn(*exact_cosine_sine(constant)))
        return found


def _newton_euler(
    links: tuple[Link, ...],
    symbols: _Symbols,
    values: Mapping[str, Values],
    turns: Mapping[str, list[Turn]],
    ground: ca.SX,
) -> ca.SX:
    """Joint efforts (n,) for a motion of the ground (3, 3)."""
    coordinates = symbols.coordinates(links)
    motions: dict[str, ca.SX] = {}
    inboard: dict[str, ca.SX] = {}
    arms: dict[str, ca.SX] = {}  # from the inboard port of the parent to the joint
    wrenches: dict[str, ca.SX] = {}
    for link, coordinate in zip(links, coordinates, strict=True):
        name, joint = link.child.name, owner_name(link.joint)
        motion = ground
        if link.parent.name in motions:
            arms[name] = _port(link.parent, link.parent_port, values) - inboard[link.parent.name]
            motion = move_motion(motions[link.parent.name], arms[name])
        motion = link.joint.motion(motion, values[joint], turns.get(joint, []), coordinate)
        inboard[name] = _port(link.child, link.child_port, values)
        motions[name] = motion
        wrenches[name] = link.child.wrench(motion, values[owner_name(link.child)], inboard[name])
    efforts: list[ca.SX] = []
    for link, coordinate in zip(reversed(links), reversed(coordinates), strict=True):
        name, joint = link.child.name, owner_name(link.joint)
        carried = link.joint.carry(wrenches[name], motions[name], values[joint])
        efforts.insert(0, link.joint.resistance(carried, values[joint], coordinate))
        if link.parent.name in motions:
            passed = link.joint.wrench(carried, values[joint], turns.get(joint, []), coordinate)
            wrenches[link.parent.name] += move_wrench(passed, arms[name])
    return ca.vertcat(*efforts)


def _port(body: Body, port: str, values: Mapping[str, Values]) -> ca.SX:
    """Position (3,) of a port in the frame of its body (m)."""
    label = body.port_label(port)
    if label is None:
        return ca.SX(3, 1)
    own = values[owner_name(body)]
    return ca.sparsify(ca.SX(ca.vertcat(*(own[f"{label}.{axis}"] for axis in AXES))))


def _without_unseen(scene: Scene, residual: ca.SX, symbols: _Symbols) -> ca.SX:
    """The residual without placeholders of inertia entries; an error if the motion sees one."""
    owners_of = {
        unseen_name(body.name, entry): (body.name, entry)
        for body in scene.bodies
        for entry in (*DIAGONAL, *PRODUCTS)
    }
    placeholders = [symbol for symbol in ca.symvar(residual) if symbol.name() in owners_of]
    if not placeholders:
        return residual
    vector = ca.vertcat(*placeholders)
    sensitivity = ca.Function(
        "sensitivity",
        [ca.vertcat(*(s for s in ca.symvar(residual) if s.name() not in owners_of)), vector],
        [ca.jacobian(residual, vector)],
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
    return ca.substitute(residual, vector, ca.SX.zeros(len(placeholders)))


def _measures(links: tuple[Link, ...], symbols: _Symbols) -> tuple[ca.SX, tuple[Signal, ...]]:
    """All outputs of the joints: displacement, rate and acceleration of each coordinate."""
    entries: list[ca.SX] = []
    signals: list[Signal] = []
    for link, coordinate in zip(links, symbols.coordinates(links), strict=True):
        for (name, unit), value in zip(link.joint.measures, coordinate, strict=False):
            entries.append(value)
            signals.append(Signal(f"{link.joint.name}.{name}", unit))
    return ca.vertcat(*entries), tuple(signals)
