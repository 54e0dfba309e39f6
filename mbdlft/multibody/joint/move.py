"""Moves, the factors of a joint: each transforms vectors, motions and wrenches between two frames.

A joint is a product of moves from the frame of the parent's port to that of the child's port. Constant
moves (`Turned`, `Shifted`) place the equilibrium; the others (`Hinge`, `Slide`, `Ball`) have coordinates.
A move leads from the frame p on its parent's side to the frame c on its child's side. With R_pc and r_pc
as in `mbdlft.multibody.spatial`, a free vector v, a point at x, a force f and its torque tau transform by

    v_c = R_pc' v_p,    x_p = r_pc + R_pc x_c,    f_p = R_pc f_c,    tau_p = R_pc tau_c + r_pc x f_p

Motions are (3, 3), wrenches (3, 2). Efforts are those of the recursive Newton-Euler algorithm
(Featherstone, section 5.3).
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from mbdlft.multibody.spatial import Coordinate, move_motion, move_wrench, rotate, traced

# labels of the momenta (N m s) along the axis of a joint that turns at a steady rate, alone or with what
# carries it: of its actuator, and of the bodies that it moves
ROTOR, MOMENTUM = "momentum.actuator", "momentum.bodies"


class Turn(NamedTuple):
    """One of the rotations that make an equilibrium rotation: cosine and sine of its angle."""

    cosine: ca.SX | float
    sine: ca.SX | float


class Move(abc.ABC):
    """One factor of a joint; every concrete kind is final."""

    degrees_of_freedom: int = 0

    def in_parent_axes(self, vectors: ca.SX) -> ca.SX:
        """R_pc v: components in frame p of vectors (3, n) that are given in frame c."""
        return vectors

    def in_child_axes(self, vectors: ca.SX) -> ca.SX:
        """R_pc' v: components in frame c of vectors (3, n) that are given in frame p."""
        return vectors

    def offset(self) -> ca.SX:
        """r_pc (3,): position of the origin of frame c from that of frame p, in the axes of p (m)."""
        return ca.SX(3, 1)

    @abc.abstractmethod
    def motion(self, motion: ca.SX) -> ca.SX:
        """Motion (3, 3) of frame c, in its axes, from the motion of frame p in the axes of p."""

    @abc.abstractmethod
    def wrench(self, wrench: ca.SX) -> ca.SX:
        """Wrench (3, 2) about the origin of p, in its axes, from the same wrench in frame c."""

    def carried(self, wrench: ca.SX, motion: ca.SX) -> ca.SX:
        """Wrench (3, 2) in frame c, with the wrench that the actuator's inertia needs added to it."""
        return wrench

    def effort(self, carried: ca.SX, motion: ca.SX) -> ca.SX:
        """Efforts (degrees_of_freedom,) for the wrench of `carried` and the motion of frame c."""
        return ca.SX(0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Turned(Move):
    """A constant rotation about the unit vector `axis` (3,)."""

    axis: ca.SX
    turn: Turn

    def in_parent_axes(self, vectors: ca.SX) -> ca.SX:
        return rotate(self.axis, *self.turn, vectors)

    def in_child_axes(self, vectors: ca.SX) -> ca.SX:
        return rotate(self.axis, self.turn.cosine, -self.turn.sine, vectors)

    def motion(self, motion: ca.SX) -> ca.SX:
        return self.in_child_axes(motion)

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return self.in_parent_axes(wrench)


@dataclass(frozen=True, slots=True, eq=False)
class Shifted(Move):
    """A constant displacement by `r` (3,) (m), which is r_pc; R_pc = 1."""

    r: ca.SX

    def offset(self) -> ca.SX:
        return self.r

    def motion(self, motion: ca.SX) -> ca.SX:
        return move_motion(motion, self.r)

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return move_wrench(wrench, self.r)


@dataclass(frozen=True, slots=True, eq=False)
class Hinge(Move):
    """A rotation by q (rad) about the unit vector `axis` (3,).

        omega_c = R_pc' omega_p + axis qdot
        alpha_c = R_pc' alpha_p + (R_pc' omega_p) x axis qdot + axis qddot
        effort  = axis . tau_c + n J (axis . alpha_c + (n - 1) qddot) + J_r qddot

    J is the inertia of the actuator, a massless rotor about the axis. With the gear ratio n = 1 it
    turns with the child: equations (7) to (9) of Kassarian et al. 2023. With another gear ratio the
    rotor turns n times as far as the child, seen from the parent. Its inertia then acts on the parent
    with the torque J (axis . alpha_p + n qddot), and the effort is the torque behind the gear, on the
    child's side. As n grows with J_r = n^2 J, only the `reflected` inertia J_r is left (Featherstone,
    section 9.6).

    What a `steady` hinge carries is symmetric about the axis and turns at a steady rate beside qdot. Its
    frame c does not turn with it: R_pc = 1. The rotor has the momentum `momentum` along the axis (N m s),
    which needs the torque omega_c x axis momentum; that of the child is in `assembly/gyrostat.py`.
    """

    axis: ca.SX
    at: Coordinate
    inertia: ca.SX | float = 0.0
    ratio: ca.SX | float = 1.0
    momentum: ca.SX | float = 0.0
    steady: bool = False
    reflected: ca.SX | float = 0.0
    degrees_of_freedom = 1

    def in_parent_axes(self, vectors: ca.SX) -> ca.SX:
        if self.steady:
            return vectors
        return rotate(self.axis, ca.cos(self.at.q), ca.sin(self.at.q), vectors)

    def in_child_axes(self, vectors: ca.SX) -> ca.SX:
        if self.steady:
            return vectors
        return rotate(self.axis, ca.cos(self.at.q), -ca.sin(self.at.q), vectors)

    def motion(self, motion: ca.SX) -> ca.SX:
        return _hinge_motion(self.in_child_axes(motion), self.axis, self.at.v, self.at.a)

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return self.in_parent_axes(wrench)

    def carried(self, wrench: ca.SX, motion: ca.SX) -> ca.SX:
        if isinstance(self.inertia, float) and self.inertia == 0.0:
            return wrench
        carried = _hinge_actuator(wrench, motion, self.axis, self.inertia)
        if self.steady:
            carried = carried + turning_along(motion, self.axis * self.momentum)
        if not self._is_geared():
            return carried
        # the rotor turns by (n - 1) qdot faster than the child: this additional spin needs a torque where
        # it changes, and a gyroscopic torque where the body turns its axis
        more = self.inertia * (self.ratio - 1.0)
        gyroscopic = ca.cross(motion[:, 0], self.axis * (more * self.at.v))
        torque = self.axis * (more * self.at.a) + gyroscopic
        return ca.horzcat(carried[:, 0], carried[:, 1] + torque)

    def effort(self, carried: ca.SX, motion: ca.SX) -> ca.SX:
        effort = ca.mtimes(self.axis.T, carried[:, 1])
        if not (isinstance(self.reflected, float) and self.reflected == 0.0):
            effort += self.reflected * self.at.a
        if not self._is_geared():
            return effort
        more = self.ratio - 1.0
        turned = ca.mtimes(self.axis.T, motion[:, 1]) + more * self.at.a
        return effort + more * self.inertia * turned

    def _is_geared(self) -> bool:
        return not (isinstance(self.ratio, float) and self.ratio == 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Slide(Move):
    """A translation by q (m) along the unit vector `axis` (3,): r_pc = axis q, R_pc = 1.

        a_c    = a_p + alpha x r_pc + omega x (omega x r_pc) + 2 omega x axis qdot + axis qddot
        effort = axis . f_c + m qddot

    m is the mass that the actuator moves along the axis relative to the parent (a reflected inertia).
    """

    axis: ca.SX
    at: Coordinate
    inertia: ca.SX | float = 0.0
    degrees_of_freedom = 1

    def offset(self) -> ca.SX:
        return self.axis * self.at.q

    def motion(self, motion: ca.SX) -> ca.SX:
        return _slide_motion(motion, self.axis, *self.at)

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return move_wrench(wrench, self.offset())

    def effort(self, carried: ca.SX, motion: ca.SX) -> ca.SX:
        return ca.mtimes(self.axis.T, carried[:, 0]) + self.inertia * self.at.a


@dataclass(frozen=True, slots=True, eq=False)
class Ball(Move):
    """A rotation by the small rotation vector q = 2 tan(theta/2) axis.

        R_pc = 1 + ([q] + [q]^2/2)/(1 + q.q/4)       the Cayley transform: rational, no singularity at 0
        omega_c = R_pc' omega_p + v,   alpha_c = R_pc' alpha_p + (R_pc' omega_p) x v + vdot
        effort  = tau_c + J vdot                     J (3,) in the axes of the child

    [q] is the matrix of the cross product with q. v is the angular velocity relative to the parent, in
    the axes of the child; at q = 0, qdot = v, and a linearization about q = 0 needs no more. With a
    `before` (3, 3), a rotation that is made first, R_pc is that times the rotation by q.
    """

    at: Coordinate
    inertia: ca.SX
    before: ca.SX | None = None
    degrees_of_freedom = 3

    def in_parent_axes(self, vectors: ca.SX) -> ca.SX:
        turned = _cayley(self.at.q, vectors)
        return turned if self.before is None else ca.mtimes(self.before, turned)

    def in_child_axes(self, vectors: ca.SX) -> ca.SX:
        return _cayley(-self.at.q, self._after(vectors))

    def _after(self, vectors: ca.SX) -> ca.SX:
        return vectors if self.before is None else ca.mtimes(self.before.T, vectors)

    def motion(self, motion: ca.SX) -> ca.SX:
        return _ball_motion(self._after(motion), *self.at)

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return self.in_parent_axes(wrench)

    def effort(self, carried: ca.SX, motion: ca.SX) -> ca.SX:
        return carried[:, 1] + self.inertia * self.at.a


class Deformed(Move):
    """The move by which a deformation displaces a port, linear in the elastic coordinates q (n,).

    Frame p is where the port is in the undeformed body, frame c the port itself.

        r_pc = u,   R_pc = rotation by the small rotation vector phi (`Ball`),   [u ; phi] = Phi q
        effort = Phi_u' f_p + Phi_phi' (tau_c + phi x tau_c/2) + K_G q

    Because phi is a rotation vector, the last term is needed: with it, the stiffness that an equilibrium
    torque causes is symmetric. `shape` computes Phi q (6,) for q (n,), `transposed` Phi' w (n,) for a
    force and torque w (6,), `pulled` K_G q (n,) by which the force (3,) of the port stiffens the body.
    """

    def __init__(
        self,
        shape: Callable[[ca.SX], ca.SX],
        transposed: Callable[[ca.SX], ca.SX],
        pulled: Callable[[ca.SX], ca.SX],
        at: Coordinate,
    ) -> None:
        self.degrees_of_freedom = int(at.q.numel())
        self.effort_of, self.pulled = transposed, pulled
        small = [shape(vector) for vector in at]
        self.slide = Coordinate(*(vector[:3] for vector in small))
        self.ball = Ball(Coordinate(*(vector[3:] for vector in small)), ca.SX(3, 1))

    def in_parent_axes(self, vectors: ca.SX) -> ca.SX:
        return self.ball.in_parent_axes(vectors)

    def in_child_axes(self, vectors: ca.SX) -> ca.SX:
        return self.ball.in_child_axes(vectors)

    def offset(self) -> ca.SX:
        return self.slide.q

    def motion(self, motion: ca.SX) -> ca.SX:
        u, du, ddu = self.slide
        omega, alpha, acceleration = ca.horzsplit(move_motion(motion, u))
        moved = ca.horzcat(omega, alpha, acceleration + 2 * ca.cross(omega, du) + ddu)
        return self.ball.motion(moved)

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return move_wrench(self.ball.wrench(wrench), self.slide.q)

    def effort(self, carried: ca.SX, motion: ca.SX) -> ca.SX:
        force, torque = self.in_parent_axes(carried[:, :1]), carried[:, 1]
        torque = torque + 0.5 * ca.cross(self.ball.at.q, torque)
        return self.effort_of(ca.vertcat(force, torque)) + self.pulled(carried[:, 0])


def turning_along(motion: ca.SX, momentum: ca.SX) -> ca.SX:
    """Wrench (3, 2) that a body needs to turn a momentum (3,) (N m s) with it: omega x momentum."""
    return ca.horzcat(ca.SX(3, 1), ca.cross(motion[:, 0], momentum))


def turned(axis: ca.SX, turns: tuple[Turn, ...]) -> tuple[Turned, ...]:
    """Constant rotations about the unit vector `axis` (3,), one for each of `turns`."""
    return tuple(Turned(axis, turn) for turn in turns)


def shifted(r: ca.SX) -> tuple[Shifted, ...]:
    """A constant displacement by `r` (3,), or no move at all if it is zero."""
    r = ca.sparsify(ca.SX(r))
    return (Shifted(r),) if r.nnz() else ()


@traced
def _hinge_motion(motion: ca.SX, axis: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
    """Motion of frame c (3, 3); `motion` is that of p in the axes of c."""
    omega, alpha, acceleration = ca.horzsplit(motion)
    relative = axis * v
    return ca.horzcat(omega + relative, alpha + ca.cross(omega, relative) + axis * a, acceleration)


@traced
def _hinge_actuator(wrench: ca.SX, motion: ca.SX, axis: ca.SX, inertia: ca.SX) -> ca.SX:
    """The wrench (3, 2) with the torque of the rotor; `motion` is that of c."""
    omega, alpha, _ = ca.horzsplit(motion)
    spin = inertia * ca.dot(axis, omega)
    torque = axis * (inertia * ca.dot(axis, alpha)) + ca.cross(omega, axis * spin)
    return ca.horzcat(wrench[:, 0], wrench[:, 1] + torque)


@traced
def _slide_motion(motion: ca.SX, axis: ca.SX, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
    omega, alpha, acceleration = ca.horzsplit(move_motion(motion, axis * q))
    return ca.horzcat(omega, alpha, acceleration + 2 * ca.cross(omega, axis * v) + axis * a)


@traced
def _cayley(q: ca.SX, vectors: ca.SX) -> ca.SX:
    """R_pc times vectors (3, n) in c; see `Ball`."""
    across = ca.mtimes(ca.skew(q), vectors)
    twice = ca.mtimes(ca.skew(q), across)
    return vectors + (across + 0.5 * twice) / (1.0 + 0.25 * ca.dot(q, q))


@traced
def _ball_motion(motion: ca.SX, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
    omega, alpha, acceleration = ca.horzsplit(_cayley(-q, motion))
    return ca.horzcat(omega + v, alpha + ca.cross(omega, v) + a, acceleration)
