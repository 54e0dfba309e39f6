"""Elastic bodies in motions of any size: small deformations about a floating frame.

The acceleration a of the origin (less gravity), the angular velocity w and acceleration alpha of the
frame are in its own axes. A body with the deformation q has the first moment s(q), the inertia J(q) and
the angular momentum h(q, qdot), linear in qdot. Its energy

    m V.V/2 + V.(w x s + sdot) + w.J w/2 + w.h + qdot.M qdot/2

for the velocity V of its origin gives, by Lagrange and d'Alembert,

    force   = m a + alpha x s + w x (w x s + 2 sdot) + sddot
    torque  = s x a + d/dt(J w + h) + w x (J w + h)
    efforts = (ds/dq)' a + d/dt (dh/dqdot)' w - d/dq(w.J w/2 + w.h) + M qddot + D qdot + K q

To the first order they are those of `body.elastic`, with s = m c + P_u q and h = P_th qdot. What is not
known of a body is left out of the energy, so energy and momentum are conserved all the same: that J, and
P by h, change with q, unless the mass of a beam is on its axis. An axial force in a beam does the work of
its shortening by bending, which therefore is in s and J, and in the place of its ports.

Source: Shabana, Dynamics of Multibody Systems, chapter 5, with velocities in the axes of the body.
"""

from functools import partial

import casadi as ca

from mbdlft.base.description import Values
from mbdlft.multibody.body import ElasticBody
from mbdlft.multibody.body.beam import Beam
from mbdlft.multibody.body.elastic import times
from mbdlft.multibody.joint.move import Ball, Deformed
from mbdlft.multibody.spatial import Coordinate


def needed(body: ElasticBody, motion: ca.SX, values: Values, at: Coordinate) -> tuple[ca.SX, ca.SX]:
    """Wrench (3, 2) about the origin and generalized forces (n,) that a motion (3, 3) needs."""
    (q, v, a), (omega, alpha, acceleration) = at, ca.horzsplit(motion)
    e, d = body.elastic(values), partial(_rate, at=at)
    s, J, h = _inertial(body, values, at)
    sdot, L = d(s), ca.mtimes(J, omega) + h
    force = body.total_mass(values) * acceleration + ca.cross(alpha, s) + d(sdot)
    force += ca.cross(omega, ca.cross(omega, s) + 2.0 * sdot)
    torque = ca.cross(s, acceleration) + ca.mtimes(J, alpha) + d(L) + ca.cross(omega, L)
    turning = ca.jacobian(h, v)
    # omega and alpha do not depend on q: they are those of the frame
    inertial = ca.mtimes(ca.jacobian(s, q).T, acceleration) + ca.mtimes(turning.T, alpha)
    inertial += d(ca.mtimes(turning.T, omega)) - ca.gradient(
        ca.dot(omega, 0.5 * ca.mtimes(J, omega) + h), q
    )
    deforming = times(e.mass, a) + times(e.damping, v) + times(e.stiffness, q)
    return ca.horzcat(force, torque), deforming + inertial


def _rate(expression: ca.SX, at: Coordinate) -> ca.SX:
    """The rate of an expression of q and qdot by these alone."""
    return ca.SX(ca.jtimes(expression, at.q, at.v) + ca.jtimes(expression, at.v, at.a))


def _inertial(body: ElasticBody, values: Values, at: Coordinate) -> tuple[ca.SX, ca.SX, ca.SX]:
    """s (3,), J (3, 3) and h (3,)."""
    participation = body.elastic(values).participation
    alpha = ca.SX.sym("alpha", 3)
    undeformed = body.rigid_wrench(ca.horzcat(ca.SX(3, 1), alpha, ca.SX(3, 1)), values)
    s = body.first_moment(values, ca.SX(3, 1)) + times(participation, at.q)[:3]
    J, h = ca.jacobian(undeformed[:, 1], alpha), times(participation, at.v)[3:]
    if isinstance(body, Beam):
        along, across, turning = body.of_second_order(values, at)
        s[0] -= along
        J += ca.SX.eye(3) * ca.trace(across) - across
        h += turning
    return s, J, h


class Bent(Deformed):
    """The move to a port of an elastic body, with the shortening of beams and rotations of any size."""

    def __init__(self, body: ElasticBody, port: str, values: Values, at: Coordinate) -> None:
        self.degrees_of_freedom, self.at = int(at.q.numel()), at
        shape, d = partial(times, body.shapes(port, values)), partial(_rate, at=at)
        pull = body.pulled(port, values, -ca.SX.eye(3)[:, 0], at)
        u = shape(at.q)[:3] - 0.5 * ca.dot(at.q, pull) * ca.SX.eye(3)[:, 0]
        phi, slope = shape(at.q)[3:], shape(at.v)[3:]
        self.stretch = 1.0 + 0.25 * ca.dot(phi, phi)
        omega = (slope - 0.5 * ca.cross(phi, slope)) / self.stretch
        self.slide = Coordinate(u, d(u), d(d(u)))
        self.ball = Ball(Coordinate(phi, omega, d(omega)), ca.SX(3, 1))

    def effort(self, carried: ca.SX, motion: ca.SX) -> ca.SX:
        force, torque, phi = self.in_parent_axes(carried[:, :1]), carried[:, 1], self.ball.at.q
        torque = (torque + 0.5 * ca.cross(phi, torque)) / self.stretch
        moved = ca.mtimes(ca.jacobian(self.slide.q, self.at.q).T, force)
        return ca.SX(moved + ca.mtimes(ca.jacobian(phi, self.at.q).T, torque))
