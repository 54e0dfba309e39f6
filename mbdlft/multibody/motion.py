"""Equations of motion at displacements of any size, for simulation, at numbers of the parameters.

    qdot = N(q) v,    H(q) a + h(q, v) - efforts - J' lambda = 0,    J a + Jdot v = -2 s J v - s^2 phi

The gaps phi(q) of loops and rigid couplings have the rates J v. Their multipliers lambda do no work on
motions that fit, and s brings back what integration lets drift (Baumgarte 1972). N = 1 but for rotation
vectors q = 2 tan(angle/2) axis of balls and free bodies, whose v are angular velocities in own axes:

    qdot = v + q x v/2 + (q . v) q/4

Such a vector ends at half a turn. So where no spring holds it, q begins at a reference (a quaternion),
which may follow the body; the whole rotation is what is shown.
Springs keep their law at any length: tension k (l - l0) + c ldot along the line of their ports.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import Values
from mbdlft.base.errors import SceneError, TrimError
from mbdlft.base.samples import physical_points
from mbdlft.base.unit import Signal
from mbdlft.multibody.assembly import assembly
from mbdlft.multibody.assembly.kinematics import View
from mbdlft.multibody.assembly.newton_euler import Assembly, dynamics, in_motion
from mbdlft.multibody.assembly.resolved import Resolved, body_channels, couplings, measures
from mbdlft.multibody.assembly.tree import Degree, degrees
from mbdlft.multibody.body import ElasticBody
from mbdlft.multibody.equilibrium.conditions import gaps_of
from mbdlft.multibody.force import Buoyancy, Force, Spring, Torque
from mbdlft.multibody.joint.move import Ball
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.problem.equations import physical_symbols, rows_of
from mbdlft.problem.sx.constants import in_doubles
from mbdlft.problem.trim import trim_efforts

_ANY_SIZE = (Force, Torque, Buoyancy, Spring)  # loads whose laws hold for motions of any size
_BACK = 10.0  # s (1/s): ten times faster than the slowest motions that are looked at


class Motion(NamedTuple):
    """xdot = rates, 0 = residual(x, z, u), y = outputs: SX of x = [q ; v], z = [a ; lambda], u.

    At x = 0, u = 0 the mechanism is in its equilibrium. `constraints` are the gaps and their rates.
    `shown` is x with the whole rotations of `balls`, whose q begin at the `references`.
    """

    coordinates: tuple[Signal, ...]  # of x
    states: tuple[int, ...]  # positions in x of those that the others follow
    inputs: tuple[Signal, ...]  # of u
    outputs: tuple[Signal, ...]
    balls: tuple[int, ...]  # positions in x of their first entries
    x: ca.SX
    z: ca.SX
    u: ca.SX
    references: ca.SX  # (4,) of each ball
    shown: ca.SX
    rates: ca.SX
    residual: ca.SX
    y: ca.SX
    constraints: ca.SX


def equations_of_motion(scene: Scene, values: Mapping[str, float]) -> Motion:
    """The equations at physical values of the parameters; the others are nominal.

    Raises
    ------
    SceneError
        The scene has bodies, loads or contacts that are known for small motions only.
    TrimError
        A value is not usable, or nothing holds the equilibrium there.
    """
    _refuse_small(scene)
    small = assembly(scene)
    point = physical_points(small.resolved.parameters, values, "simulate", TrimError)
    at_rest, _ = trim_efforts(small.equations, point)
    m, balls, references = _at_any_size(small)
    r, every = m.resolved, degrees(m.resolved.links)
    q, v, a = r.symbols.q, r.symbols.v, r.symbols.a
    qdot, names = _rates_of(every, q, v), [effort.signal.name for effort in m.efforts]
    u, kept = ca.SX.sym("input", len(names)), len(names) - len(m.closure.rows)
    total = ca.vertcat((ca.SX(at_rest[0]) + u)[:kept], ca.SX.zeros(len(m.closure.rows)))
    for k, load in enumerate(scene.loads, start=len(every)):
        if isinstance(load, Spring):
            law = small.resolved.values[owner_name(load)]
            total[k] = u[k] + _density(load, m.view, law, float(at_rest[0, k]), (q, qdot))
    coupled = couplings(r, m.view, m.closure, m.u, m.z, names).efforts
    multipliers = ca.SX.sym("lambda", len(m.closure.rows))
    phi = rows_of(gaps_of(scene, m.view, q)[0], m.closure.rows)
    drift = ca.mtimes(ca.jacobian(phi, q), qdot)
    J = ca.jacobian(drift, v)
    held = ca.mtimes(ca.jacobian(drift, q), qdot) + ca.mtimes(J, a)
    held += 2.0 * _BACK * drift + _BACK**2 * phi
    efforts = dynamics(r, m.view, m.u, coupled) - ca.mtimes(J.T, multipliers)
    measured, signals, default = measures(r, m.view, body_channels(r, m.view, m.u, names))
    chosen = _chosen(scene, signals, default)
    coordinates = tuple(degree.measure(order) for order in range(2) for degree in every)
    residual = ca.vertcat(efforts, held)
    shown = ca.SX(r.symbols.x)
    for k, reference in zip(balls, ca.vertsplit(references, 4) if balls else (), strict=True):
        shown[k : k + 3] = _whole(reference, q[k : k + 3])
    # sensors measure small motions; coordinates are shown as they are
    place = {signal.name: k for k, signal in enumerate(coordinates)}
    y = [shown[place[x.name]] if (x := signals[k]).name in place else measured[k] for k in chosen]
    made = [shown, ca.vertcat(qdot, a), residual, ca.vertcat(ca.SX(0, 1), *y), ca.vertcat(phi, drift)]
    known = [total, ca.SX.zeros(m.z.numel()), ca.SX(m.base.nz[:])]
    made = ca.substitute(made, [m.u, m.z, ca.SX(m.load.nz[:])], known)
    moved = {d.measure(order).name for d in every if d.kind == "motion" for order in range(2)}
    inputs = [k for k, e in enumerate(m.efforts) if e.is_input and e.signal.name not in moved]
    others = [k for k in range(len(names)) if k not in inputs]
    made = ca.substitute(made, [rows_of(u, others)], [ca.SX.zeros(len(others))])
    return Motion(
        coordinates,
        small.equations.states,
        tuple(m.efforts[k].signal for k in inputs),
        tuple(signals[k] for k in chosen),
        tuple(balls),
        r.symbols.x,
        ca.vertcat(a, multipliers),
        rows_of(u, inputs),
        references,
        *_at_numbers(r, made, point),
    )


def _refuse_small(scene: Scene) -> None:
    """Raise a SceneError for what a scene has that is known for small motions only."""
    small = [f"elastic body {body.name!r}" for body in scene.bodies if isinstance(body, ElasticBody)]
    small += [f"contact {contact.name!r}" for contact in scene.contacts]
    small += [f"{x.kind} {x.name!r}" for x in scene.loads if not isinstance(x, _ANY_SIZE)]
    if small:
        raise SceneError(
            f"scene {scene.name!r}: {', '.join(small)}: known for small motions only, which the linear "
            "model has. Simulate that one (step_response), or a scene without."
        )


def _at_any_size(small: Assembly) -> tuple[Assembly, list[int], ca.SX]:
    """The assembly with springs as forces along the line of their ports, without laws of their own.

    With it positions in q of balls that no spring holds, and their references.
    """
    r = small.resolved
    springs = {owner_name(load) for load in r.scene.loads if isinstance(load, Spring)}
    undamped = {owner: {**x, "damping": 0.0} if owner in springs else x for owner, x in r.values.items()}
    r = replace(r, values=undamped)
    view = r.view()
    view.elastic = 0.0
    balls, references, moves = list[int](), [ca.SX(0, 1)], dict(view.now.moves)
    every, carried = degrees(r.links), {link.owner: link.child.name for link in r.links}
    for k, degree in enumerate(every):
        if not _turns(degree):
            continue
        values = r.values[degree.owner]
        stiffnesses = (values.get(each.label("stiffness"), 0.0) for each in every[k : k + 3])
        if not all(ca.SX(stiffness).is_zero() for stiffness in stiffnesses):
            continue
        balls.append(k)
        references.append(ca.SX.sym(f"reference of {degree.name}", 4))
        child = carried[degree.owner]
        moves[child] = tuple(
            replace(move, before=_rotation(references[-1])) if isinstance(move, Ball) else move
            for move in moves[child]
        )
    view.now = replace(view.now, moves=moves)
    m = in_motion(r, view, small.closure, {})
    view.passed = m.passed_as_displaced()
    return m, balls, ca.vertcat(*references)


def _turns(degree: Degree) -> bool:
    """Whether a coordinate is the first of a rotation vector."""
    return degree.freedom.measures[0].name == "rotation.x"


def _rotation(quaternion: ca.SX) -> ca.SX:
    """The rotation (3, 3) of a unit quaternion (4,), w first."""
    w, v = quaternion[0], quaternion[1:]
    return ca.SX.eye(3) + 2.0 * w * ca.skew(v) + 2.0 * ca.mtimes(ca.skew(v), ca.skew(v))


def _moved(reference: ca.SX, q: ca.SX) -> ca.SX:
    """A quaternion (4,) of any length of the rotation by q (3,) behind a reference (4,)."""
    w, v = reference[0], reference[1:]
    return ca.vertcat(w - 0.5 * ca.dot(v, q), 0.5 * w * q + v + 0.5 * ca.cross(v, q))


def _whole(reference: ca.SX, q: ca.SX) -> ca.SX:
    """The rotation vector 2 tan(angle/2) axis of the rotation by q behind its reference."""
    moved = _moved(reference, q)
    return 2.0 * moved[1:] / moved[0]


def moved_reference(reference: Array, q: Array) -> Array:
    """The unit quaternion (4,) of the rotation by a rotation vector q (3,) behind a reference (4,)."""
    moved = ca.evalf(_moved(ca.SX(reference), ca.SX(q))).full()[:, 0]
    return np.asarray(moved / np.linalg.norm(moved))


def _rates_of(every: Sequence[Degree], q: ca.SX, v: ca.SX) -> ca.SX:
    """qdot (n,)."""
    qdot = ca.SX(v)
    for k, degree in enumerate(every):
        if _turns(degree):
            turn, rate = q[k : k + 3], v[k : k + 3]
            qdot[k : k + 3] += 0.5 * ca.cross(turn, rate) + 0.25 * ca.dot(turn, rate) * turn
    return qdot


def _density(
    spring: Spring, view: View, values: Values, at_rest: float, moving: tuple[ca.SX, ca.SX]
) -> ca.SX:
    """Tension over length (N/m), with that at equilibrium, at displacements and their rates."""
    view.owned(spring)
    r, still = (f(spring.parent, spring.child) for f in (view.between, view.between_at_rest))
    length, before = ca.norm_2(r), ca.norm_2(still)
    stretched = ca.jtimes(length, *moving)
    k, c = values["stiffness"], values["damping"]
    return ca.SX((k * (length - before) + at_rest * before + c * stretched) / length)


def _chosen(scene: Scene, signals: Sequence[Signal], default: Sequence[int]) -> list[int]:
    """Positions of the outputs: those of the scene, without forces of couplings and contacts."""
    if scene.outputs is None:
        return list(default)
    names = [signal.name for signal in signals]
    return [names.index(name) for name in scene.outputs if name in names]


def _at_numbers(r: Resolved, expressions: Sequence[ca.SX], point: Array) -> list[ca.SX]:
    """Expressions in doubles at physical values (1, n_p)."""
    symbols, p, cosine, sine = physical_symbols(r.parameters)
    old, new = [r.symbols.p, r.symbols.cosine, r.symbols.sine], [p, cosine, sine]
    physical = ca.substitute([in_doubles(each) for each in expressions], old, new)
    return [ca.densify(each) for each in ca.substitute(physical, [symbols], [ca.SX(point[0])])]
