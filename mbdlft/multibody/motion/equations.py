"""Equations of motion at displacements of any size, for simulation, at numbers of the parameters.

    qdot = N(q) v,    H(q) a + h(q, v) - efforts - J' lambda = 0,    J a + Jdot v = -2 s J v - s^2 phi

The gaps phi(q) of loops, rigid couplings and contacts have the rates J v. Bodies that roll have rates
psi(q, v) = 0 besides, with dpsi/dt = -s psi. The multipliers lambda do no work on motions that fit, and s
brings back what integration lets drift (Baumgarte 1972). N = 1 but for rotation vectors
q = 2 tan(angle/2) axis of balls and free bodies, whose v are angular velocities in own axes:

    qdot = v + q x v/2 + (q . v) q/4

Such a vector ends at half a turn. So where no spring holds it, q begins at a reference (a quaternion),
which may follow the body; the whole rotation is what is shown.
Springs keep their law at any length: tension k (l - l0) + c ldot along the line of their ports. Elastic
bodies are those of `floating`, contacts, struts and wheels those of `rolling`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.description import Values
from mbdlft.base.errors import TrimError
from mbdlft.base.samples import physical_points
from mbdlft.base.unit import Signal
from mbdlft.multibody.assembly import assembly, resolved
from mbdlft.multibody.assembly.kinematics import pass_inward
from mbdlft.multibody.assembly.newton_euler import Assembly, dynamics, in_motion
from mbdlft.multibody.assembly.tree import Degree, PortJoint, degrees
from mbdlft.multibody.body import ElasticBody
from mbdlft.multibody.equilibrium.conditions import gaps_of
from mbdlft.multibody.force import BodyWrench, Guided, Load, Spring
from mbdlft.multibody.joint.move import Ball
from mbdlft.multibody.motion.floating import Bent, needed
from mbdlft.multibody.motion.rolling import guided, held
from mbdlft.multibody.motion.space import LargeView
from mbdlft.multibody.scene.quantities import owner_name
from mbdlft.multibody.scene.scene import Scene
from mbdlft.multibody.sensor import JointWrench
from mbdlft.problem.equations import physical_symbols, rows_of
from mbdlft.problem.sx.constants import in_doubles
from mbdlft.problem.trim import trim_efforts

_BACK = 10.0  # s (1/s): ten times faster than the slowest motions that are looked at


class Motion(NamedTuple):
    """xdot = rates, 0 = residual(x, z, u), y = outputs: SX of x = [q ; v], z = [a ; lambda], u.

    At x = 0, u = 0 the mechanism is in its equilibrium, and y = 0: a sensor that feels weight, or turns
    with its frame, shows what is added to that. `constraints` are the gaps and their rates.
    `shown` is x with the whole rotations of `balls`, whose q begin at the `references`, and with motions
    that are inputs, in place of their entries of x, which nothing uses.
    """

    coordinates: tuple[Signal, ...]  # of x
    states: tuple[int, ...]  # positions in x of those that the others follow
    followers: tuple[int, ...]  # and of these, without motions that are inputs
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
    """The equations at physical values of the parameters; the others are nominal."""
    small = assembly(scene)
    point = physical_points(small.resolved.parameters, values, "simulate", TrimError)
    at_rest, _ = trim_efforts(small.equations, point)
    m, view, balls, references = _at_any_size(small)
    r, every = m.resolved, degrees(m.resolved.links)
    q, a = view.q, view.a
    qdot, names = view.qdot, [effort.signal.name for effort in m.efforts]
    u, kept = ca.SX.sym("input", len(names)), len(names) - len(m.closure.rows)
    total = ca.vertcat((ca.SX(at_rest[0]) + u)[:kept], ca.SX.zeros(len(m.closure.rows)))
    for k, load in enumerate(scene.loads, start=len(every)):
        if isinstance(load, Spring):
            law = small.resolved.values[owner_name(load)]
            total[k] = u[k] + _density(load, view, law, float(at_rest[0, k]))
    coupled = resolved.couplings(r, view, m.closure, m.u, m.z, names).efforts
    channels = resolved.body_channels(r, view, m.u, names)
    acting, _ = resolved.static_deflections(r, m.closure, m.u)
    multipliers = ca.SX.sym("lambda", len(m.closure.rows))
    constraints, fitting, J = _constraints(m, view)
    # what imposes the acceleration of a joint carries the multipliers
    J[:, [k for k, degree in enumerate(every) if degree.kind in ("imposed", "motion")]] = 0.0
    efforts = dynamics(r, view, acting, coupled) - channels.forces - ca.mtimes(J.T, multipliers)
    measured, signals, default = resolved.measures(r, view, channels)
    chosen = _chosen(scene, signals, default)
    coordinates = tuple(degree.measure(order) for order in range(2) for degree in every)
    residual = ca.vertcat(efforts, fitting)
    shown = ca.SX(r.symbols.x)
    for k, reference in zip(balls, ca.vertsplit(references, 4) if balls else (), strict=True):
        shown[k : k + 3] = _whole(reference, q[k : k + 3])
    place = {signal.name: k for k, signal in enumerate(coordinates)}
    y = [shown[place[x.name]] if (x := signals[k]).name in place else measured[k] for k in chosen]
    made = [shown, residual, ca.vertcat(ca.SX(0, 1), *y), constraints]
    known = [total, ca.SX.zeros(m.z.numel()), ca.SX(m.base.nz[:])]
    made = ca.substitute(made, [m.u, m.z, ca.SX(m.load.nz[:])], known)
    rates, given = ca.vertcat(qdot, a), dict[int, ca.SX]()
    for coordinate, entries in resolved.moved_coordinates(r.links, names):
        given |= {coordinate + order * len(every): u[entries[order]] for order in range(2)}
        rates[coordinate + len(every)] = 0.0
    inputs, z = [k for k, e in enumerate(m.efforts) if e.is_input], ca.vertcat(a, multipliers)
    others = [k for k in range(len(names)) if k not in inputs]
    old = [rows_of(u, others), rows_of(r.symbols.x, list(given))]
    new = [ca.SX.zeros(len(others)), ca.vertcat(ca.SX(0, 1), *given.values())]
    shown, *made = ca.substitute(made, old, new)
    numbers = _at_numbers(r, [shown, rates, *made], point)
    at = (r.symbols.x, z, rows_of(u, inputs), references)
    numbers[3] -= _at_rest(numbers[2], numbers[3], *at)
    return Motion(
        coordinates,
        small.equations.states,
        tuple(k for k in range(len(coordinates)) if k not in {*small.equations.states, *given}),
        tuple(m.efforts[k].signal for k in inputs),
        tuple(signals[k] for k in chosen),
        tuple(balls),
        *at,
        *numbers,
    )


def _at_rest(residual: ca.SX, y: ca.SX, x: ca.SX, z: ca.SX, u: ca.SX, references: ca.SX) -> ca.DM:
    """Outputs in the equilibrium: accelerations are zero there, multipliers what they have to be."""
    still = np.zeros(u.numel()), np.tile([1.0, 0.0, 0.0, 0.0], references.numel() // 4)
    at, zero = [x, z, u, references], np.zeros(x.numel())
    parts = ca.Function("z", at, [ca.jacobian(residual, z), residual])(zero, np.zeros(z.numel()), *still)
    J, missing = (np.asarray(part.full()) for part in parts)
    of_rest: ca.DM = ca.Function("y", at, [y])(zero, -np.linalg.lstsq(J, missing[:, 0])[0], *still)
    return of_rest


def _constraints(m: Assembly, view: LargeView) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Gaps, their rates and those of what rolls, which are zero; rows of accelerations that keep them so;
    and J, in whose rows the multipliers act."""
    scene, (first, rolling) = m.resolved.scene, (m.closure.holonomic, len(m.closure.rows))
    on_ground, every = held(scene.touches, view), gaps_of(scene, view, view.q)[0]
    gaps = ca.vertcat(every, on_ground.gaps)
    others = [row - gaps.numel() for row in m.closure.rows[first:rolling]]
    phi, psi = rows_of(gaps, m.closure.rows[:first]), rows_of(on_ground.rates, others)
    drift = ca.mtimes(ca.jacobian(phi, view.q), view.qdot)
    kept = view.rate(drift) + 2.0 * _BACK * drift + _BACK**2 * phi
    worked = ca.vertcat(drift, rows_of(on_ground.worked, others))
    keeping = ca.vertcat(kept, view.rate(psi) + _BACK * psi)
    return ca.vertcat(phi, drift, psi), keeping, ca.jacobian(worked, view.v)


class _View(LargeView):
    """The view with loads by their law at any size."""

    def wrenches(self, load: Load, magnitude: ca.SX) -> list[BodyWrench]:
        if isinstance(load, Guided):
            return guided(load, magnitude, self)
        return super().wrenches(load, magnitude)


def _at_any_size(small: Assembly) -> tuple[Assembly, LargeView, list[int], ca.SX]:
    """The assembly with springs as forces along the line of their ports, without laws of their own.

    With it its view, positions in q of balls that no spring holds, and their references.
    """
    r = small.resolved
    springs = {owner_name(load) for load in r.scene.loads if isinstance(load, Spring)}
    undamped = {owner: {**x, "damping": 0.0} if owner in springs else x for owner, x in r.values.items()}
    r = replace(r, values=undamped)
    view, s, every = _View(*r.seen()), r.symbols, degrees(r.links)
    view.move(s.q, s.v, s.a, _rates_of(every, s.q, s.v))
    view.elastic = 0.0
    balls, references, moves = list[int](), [ca.SX(0, 1)], dict(view.now.moves)
    carried = {link.owner: link.child.name for link in r.links}
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
    for link in r.links:
        if isinstance(joint := link.joint, PortJoint):
            of_body, at = r.values[owner_name(joint.body)], view.coordinates[link.owner]
            moves[link.child.name] = (
                *moves[link.child.name][:-1],
                Bent(joint.body, joint.port, of_body, at),
            )
    view.now = replace(view.now, moves=moves)
    m = in_motion(r, view, small.closure, {})
    inertial, of_bodies = dict(m.inertial), {link.child_owner: ca.SX(0, 1) for link in r.links}
    for link in r.links:
        if isinstance(body := link.child, ElasticBody):
            motion, at = view.motions.bodies[body.name], view.coordinates[link.child_owner]
            wrench, of_bodies[link.child_owner] = needed(body, motion, r.values[link.child_owner], at)
            inertial[body.name] = wrench
    total = {name: wrench + m.loads[name] for name, wrench in inertial.items()}
    view.passed = pass_inward(view.now, view.motions, total, of_bodies)
    return m, view, balls, ca.vertcat(*references)


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


def _density(spring: Spring, view: LargeView, values: Values, at_rest: float) -> ca.SX:
    """Tension over length (N/m), with that at equilibrium, at displacements and their rates."""
    view.owned(spring)
    r, still = (f(spring.parent, spring.child) for f in (view.between, view.between_at_rest))
    length, before = ca.norm_2(r), ca.norm_2(still)
    stretched = view.rate(length)
    k, c = values["stiffness"], values["damping"]
    return ca.SX((k * (length - before) + at_rest * before + c * stretched) / length)


def _chosen(scene: Scene, signals: Sequence[Signal], default: Sequence[int]) -> list[int]:
    """Positions of the outputs: those of the scene, without forces of couplings and contacts.

    Nor are there wrenches of joints where loops or contacts push on what a joint carries.
    """
    wrenches = [s for s in scene.sensors if isinstance(s, JointWrench) and (scene.loops or scene.touches)]
    left_out = {signal.name for sensor in wrenches for signal in sensor.signals()}
    names = [signal.name for signal in signals]
    asked = [names[k] for k in default] if scene.outputs is None else scene.outputs
    return [names.index(name) for name in asked if name in names and name not in left_out]


def _at_numbers(r: resolved.Resolved, expressions: Sequence[ca.SX], point: Array) -> list[ca.SX]:
    """Expressions in doubles at physical values (1, n_p)."""
    symbols, p, cosine, sine = physical_symbols(r.parameters)
    old, new = [r.symbols.p, r.symbols.cosine, r.symbols.sine], [p, cosine, sine]
    physical = ca.substitute([in_doubles(each) for each in expressions], old, new)
    return [ca.densify(each) for each in ca.substitute(physical, [symbols], [ca.SX(point[0])])]
