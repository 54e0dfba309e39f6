"""The factors of a joint: how vectors, motions and wrenches cross each of them.

A joint is a product of moves from the port of the parent to that of the child: constant ones (`Turned`,
`Shifted`) that place the equilibrium, and those with coordinates (`Hinge`, `Slide`, `Ball`). For
every move, with B before it and A after it,

    v_A = R' v_B,      r_B = offset + R r_A,      f_B = R f_A,   torque_B = R torque_A + offset x f_B

Motions are (3, 3), wrenches (3, 2): see `mbdlft.multibody.spatial`. Efforts are those of the recursive
Newton-Euler algorithm (Featherstone, section 5.3).
"""

import abc
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import casadi as ca

from mbdlft.multibody.spatial import Coordinate, move_motion, move_wrench, rotate, rotate_back


class Turn(NamedTuple):
    """One factor of an equilibrium rotation: cosine and sine of its angle."""

    cosine: ca.SX | float
    sine: ca.SX | float


class Move(abc.ABC):
    """One factor of a joint; every concrete kind is final."""

    degrees_of_freedom: int = 0

    def rotated(self, vectors: ca.SX) -> ca.SX:
        """R v: components before the move of vectors (3, n) given after it."""
        return vectors

    def rotated_back(self, vectors: ca.SX) -> ca.SX:
        """R' v: components after the move of vectors (3, n) given before it."""
        return vectors

    def offset(self) -> ca.SX:
        """Displacement (3,) of the origin, in the axes before the move (m)."""
        return ca.SX(3, 1)

    @abc.abstractmethod
    def motion(self, motion: ca.SX) -> ca.SX:
        """Motion (3, 3) after the move, from that before it."""

    @abc.abstractmethod
    def wrench(self, wrench: ca.SX) -> ca.SX:
        """Wrench (3, 2) before the move, from that after it."""

    def carried(self, wrench: ca.SX, motion: ca.SX) -> ca.SX:
        """Wrench (3, 2) after the move with that of the actuator's inertia added."""
        return wrench

    def effort(self, carried: ca.SX, motion: ca.SX) -> ca.SX:
        """Efforts (degrees_of_freedom,) for a carried wrench and the motion after the move."""
        return ca.SX(0, 1)


@dataclass(frozen=True, slots=True, eq=False)
class Turned(Move):
    """A constant rotation about `axis`."""

    axis: ca.SX
    turn: Turn

    def rotated(self, vectors: ca.SX) -> ca.SX:
        return rotate(self.axis, *self.turn, vectors)

    def rotated_back(self, vectors: ca.SX) -> ca.SX:
        return rotate_back(self.axis, *self.turn, vectors)

    def motion(self, motion: ca.SX) -> ca.SX:
        return self.rotated_back(motion)

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return self.rotated(wrench)


@dataclass(frozen=True, slots=True, eq=False)
class Shifted(Move):
    """A constant displacement by `r` (m)."""

    r: ca.SX

    def offset(self) -> ca.SX:
        return self.r

    def motion(self, motion: ca.SX) -> ca.SX:
        return move_motion(motion, self.r)

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return move_wrench(wrench, self.r)


@dataclass(frozen=True, slots=True, eq=False)
class Hinge(Move):
    """A rotation by q about `axis`.

        omega_A = R' omega_B + axis qdot,  alpha_A = R' alpha_B + (R' omega_B) x axis qdot + axis qddot
        effort  = axis . torque_A + n J (axis . alpha_A + (n - 1) qddot)

    J is the inertia of the actuator, a massless rotor about the axis. It turns with the child where the
    gear ratio n is 1: equations (7) to (9) of Kassarian et al. 2023. Else it turns n times as far, seen
    from the parent, which feels J (axis . alpha_B + n qddot), and the effort is that behind the gear.
    """

    axis: ca.SX
    at: Coordinate
    inertia: ca.SX | float = 0.0
    ratio: ca.SX | float = 1.0
    degrees_of_freedom = 1

    def rotated(self, vectors: ca.SX) -> ca.SX:
        return rotate(self.axis, ca.cos(self.at.q), ca.sin(self.at.q), vectors)

    def rotated_back(self, vectors: ca.SX) -> ca.SX:
        return rotate_back(self.axis, ca.cos(self.at.q), ca.sin(self.at.q), vectors)

    def motion(self, motion: ca.SX) -> ca.SX:
        return ca.SX(_hinge_motion()(self.rotated_back(motion), self.axis, self.at.v, self.at.a))

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return self.rotated(wrench)

    def carried(self, wrench: ca.SX, motion: ca.SX) -> ca.SX:
        if isinstance(self.inertia, float) and self.inertia == 0.0:
            return wrench
        carried = ca.SX(_hinge_actuator()(wrench, motion, self.axis, self.inertia))
        if not self._is_geared():
            return carried
        # what the rotor turns more than the child: its spin, which the parent turns along, and its rate
        more = self.inertia * (self.ratio - 1.0)
        gyroscopic = ca.cross(motion[:, 0], self.axis * (more * self.at.v))
        torque = self.axis * (more * self.at.a) + gyroscopic
        return ca.horzcat(carried[:, 0], carried[:, 1] + torque)

    def effort(self, carried: ca.SX, motion: ca.SX) -> ca.SX:
        effort = ca.mtimes(self.axis.T, carried[:, 1])
        if not self._is_geared():
            return effort
        more = self.ratio - 1.0
        turned = ca.mtimes(self.axis.T, motion[:, 1]) + more * self.at.a
        return effort + more * self.inertia * turned

    def _is_geared(self) -> bool:
        return not (isinstance(self.ratio, float) and self.ratio == 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Slide(Move):
    """A translation by q along `axis`.

        a_A    = a_P + 2 omega x axis qdot + axis qddot,   P on the parent's side, where A is
        effort = axis . force_A + m qddot

    m is the mass that the actuator moves along the axis relative to the parent (a reflected inertia).
    """

    axis: ca.SX
    at: Coordinate
    inertia: ca.SX | float = 0.0
    degrees_of_freedom = 1

    def offset(self) -> ca.SX:
        return self.axis * self.at.q

    def motion(self, motion: ca.SX) -> ca.SX:
        return ca.SX(_slide_motion()(motion, self.axis, *self.at))

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return ca.SX(_slide_wrench()(wrench, self.axis, self.at.q))

    def effort(self, carried: ca.SX, motion: ca.SX) -> ca.SX:
        return ca.mtimes(self.axis.T, carried[:, 0]) + self.inertia * self.at.a


@dataclass(frozen=True, slots=True, eq=False)
class Ball(Move):
    """A rotation by the small rotation vector q = 2 tan(theta/2) axis.

        R = 1 + ([q] + [q]^2/2)/(1 + q.q/4)          the Cayley transform: rational, no singularity at 0
        omega_A = R' omega_B + v,   alpha_A = R' alpha_B + (R' omega_B) x v + vdot
        effort  = torque_A + J vdot                   J (3,) in the axes of the child

    v is the angular velocity relative to the parent in the axes of the child; qdot = v at q = 0, which is
    all that a linearization needs.
    """

    at: Coordinate
    inertia: ca.SX
    degrees_of_freedom = 3

    def rotated(self, vectors: ca.SX) -> ca.SX:
        return ca.SX(_cayley(vectors.shape[1])(self.at.q, vectors))

    def rotated_back(self, vectors: ca.SX) -> ca.SX:
        return ca.SX(_cayley(vectors.shape[1])(-self.at.q, vectors))

    def motion(self, motion: ca.SX) -> ca.SX:
        return ca.SX(_ball_motion()(motion, *self.at))

    def wrench(self, wrench: ca.SX) -> ca.SX:
        return self.rotated(wrench)

    def effort(self, carried: ca.SX, motion: ca.SX) -> ca.SX:
        return carried[:, 1] + self.inertia * self.at.a


class Deformed(Move):
    """From the place of a port in the undeformed body to the port: linear in elastic coordinates.

        r_A = u,   R = rotation by the small rotation vector phi,   [u ; phi] = Phi q
        effort = Phi_u' f + Phi_phi' (torque_A + phi x torque_A/2)

    The last term makes the stiffness by an equilibrium torque symmetric: phi is a rotation vector.
    """

    def __init__(
        self,
        shape: Callable[[ca.SX], ca.SX],
        transposed: Callable[[ca.SX], ca.SX],
        at: Coordinate,
    ) -> None:
        self.degrees_of_freedom = int(at.q.numel())
        self.effort_of = transposed
        small = [shape(vector) for vector in at]
        self.slide = Coordinate(*(vector[:3] for vector in small))
        self.ball = Ball(Coordinate(*(vector[3:] for vector in small)), ca.SX(3, 1))

    def rotated(self, vectors: ca.SX) -> ca.SX:
        return self.ball.rotated(vectors)

    def rotated_back(self, vectors: ca.SX) -> ca.SX:
        return self.ball.rotated_back(vectors)

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
        force, torque = self.rotated(carried[:, :1]), carried[:, 1]
        torque = torque + 0.5 * ca.cross(self.ball.at.q, torque)
        return self.effort_of(ca.vertcat(force, torque))


def turned(axis: ca.SX, turns: tuple[Turn, ...]) -> tuple[Turned, ...]:
    """A rotation about one axis by the sum of the angles of `turns`."""
    return tuple(Turned(axis, turn) for turn in turns)


def shifted(r: ca.SX) -> tuple[Shifted, ...]:
    """A displacement, or nothing where it is zero."""
    r = ca.sparsify(ca.SX(r))
    return (Shifted(r),) if r.nnz() else ()


@cache
def _hinge_motion() -> ca.Function:
    """What the rates of a hinge add to a motion in the axes of the child."""
    motion, axis = ca.SX.sym("motion", 3, 3), ca.SX.sym("axis", 3)
    v, a = ca.SX.sym("v"), ca.SX.sym("a")
    omega, alpha, acceleration = ca.horzsplit(motion)
    relative = axis * v
    child = ca.horzcat(omega + relative, alpha + ca.cross(omega, relative) + axis * a, acceleration)
    return ca.Function("hinge_motion", [motion, axis, v, a], [child])


@cache
def _hinge_actuator() -> ca.Function:
    wrench, motion = ca.SX.sym("wrench", 3, 2), ca.SX.sym("motion", 3, 3)
    axis, inertia = ca.SX.sym("axis", 3), ca.SX.sym("J")
    omega, alpha, _ = ca.horzsplit(motion)
    spin = inertia * ca.dot(axis, omega)
    torque = axis * (inertia * ca.dot(axis, alpha)) + ca.cross(omega, axis * spin)
    carried = ca.horzcat(wrench[:, 0], wrench[:, 1] + torque)
    return ca.Function("hinge_actuator", [wrench, motion, axis, inertia], [carried])


@cache
def _slide_motion() -> ca.Function:
    motion, axis = ca.SX.sym("motion", 3, 3), ca.SX.sym("axis", 3)
    q, v, a = (ca.SX.sym(name) for name in "qva")
    omega, alpha, acceleration = ca.horzsplit(move_motion(motion, axis * q))
    child = ca.horzcat(omega, alpha, acceleration + 2 * ca.cross(omega, axis * v) + axis * a)
    return ca.Function("slide_motion", [motion, axis, q, v, a], [child])


@cache
def _slide_wrench() -> ca.Function:
    wrench, axis, q = ca.SX.sym("wrench", 3, 2), ca.SX.sym("axis", 3), ca.SX.sym("q")
    return ca.Function("slide_wrench", [wrench, axis, q], [move_wrench(wrench, axis * q)])


@cache
def _cayley(columns: int) -> ca.Function:
    q, vectors = ca.SX.sym("q", 3), ca.SX.sym("vectors", 3, columns)
    across = ca.mtimes(ca.skew(q), vectors)
    twice = ca.mtimes(ca.skew(q), across)
    rotated = vectors + (across + 0.5 * twice) / (1.0 + 0.25 * ca.dot(q, q))
    return ca.Function("cayley", [q, vectors], [rotated])


@cache
def _ball_motion() -> ca.Function:
    motion = ca.SX.sym("motion", 3, 3)
    q, v, a = (ca.SX.sym(name, 3) for name in "qva")
    omega, alpha, acceleration = ca.horzsplit(_cayley(3)(-q, motion))
    child = ca.horzcat(omega + v, alpha + ca.cross(omega, v) + a, acceleration)
    return ca.Function("ball_motion", [motion, q, v, a], [child])
