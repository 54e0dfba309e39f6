"""Frames, vectors and rotations in CasADi SX: the notation of all files of `mbdlft.multibody`.

A frame has an origin and three axes. Two letters name what leads from one frame to another:

    R_pc (3, 3)     rotation: components in frame c become components in frame p, v_p = R_pc v_c
    R_cp = R_pc'    the inverse rotation
    r_pc (3,)       position of the origin of frame c from that of frame p, in the axes of p (m)

p is the frame on the parent's side of a joint and c the frame on the child's side. A small letter
behind a vector is the frame in whose axes its components are given. Capital letters are points: r_PC
(3,) is the vector from the point P to the point C of one body, in the axes of this body.

A motion is a 3 x 3 matrix whose columns are [omega, alpha, acceleration]: angular velocity (rad/s) and
angular acceleration (rad/s^2) of a body, and the linear acceleration (m/s^2) of one of its points, all in
the axes of one frame. They are relative to the frame of the scene, but the last column also has the
uniform acceleration of this frame. A wrench is a 3 x 2 matrix [force, torque] (N, N m) about one point.
All files use these two orders of columns.
"""

from collections.abc import Callable, Iterable
from functools import cache, wraps
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np

from mbdlft.problem.sx.constants import numbers_of


class Coordinate(NamedTuple):
    """Displacements q, rates v and accelerations a (n,) of the coordinates of a joint, move or body."""

    q: ca.SX
    v: ca.SX
    a: ca.SX

    def part(self, entries: int | slice) -> "Coordinate":
        """Displacements, rates and accelerations of some of the coordinates."""
        return Coordinate(self.q[entries], self.v[entries], self.a[entries])


class Small(NamedTuple):
    """Small rotation and displacement (3,) of a point, or their first or second time derivatives."""

    rotation: ca.SX
    displacement: ca.SX


class Space(Protocol):
    """What loads and sensors may ask of the bodies, which ports name.

    Vectors (3,) are in the axes of a body; those of the ground are the axes of the scene.
    """

    gravity: ca.SX  # (3,) of the scene, in its axes (m/s^2)
    velocity: ca.SX  # (3,) of the scene over the ground (m/s)
    elastic: float  # 1; 0 where the magnitude of a spring follows its law: its elongation counts once

    def port(self, port: str) -> tuple[str, ca.SX]:
        """Body of a port, and its position (3,) from the inboard port in the axes of the body (m)."""

    def outward(self, vector: ca.SX, body: str) -> ca.SX:
        """Components (3,) in the axes of a body of a vector that is constant in the axes of the scene."""

    def between(self, a: str, b: str) -> ca.SX:
        """Vector (3,) from port a to port b, in the axes of the body of a (m)."""

    def between_at_rest(self, a: str, b: str) -> ca.SX:
        """The same vector (3,) at equilibrium (m)."""

    def across_now(self, vector: ca.SX, source: str, target: str) -> ca.SX:
        """Components (3,) in the axes of body `target` of a vector (3,) in those of body `source`."""

    def across(self, vector: ca.SX, source: str, target: str) -> ca.SX:
        """The same at equilibrium."""

    def departure(self, a: str, b: str, order: int) -> ca.SX:
        """Displacement (order 0) or velocity (1) (3,) of b from a, in the axes of the body of a."""

    def small(self, port: str, order: int) -> tuple[str, Small]:
        """Body of a port, and the port's displacement (order 0), velocity (1) or acceleration (2)."""

    def motion(self, port: str) -> ca.SX:
        """Motion (3, 3) of a port; gravity is in it as an acceleration of the frame by minus gravity."""

    def joint_wrench(self, joint: str) -> ca.SX:
        """Wrench (3, 2) that a joint exerts on its child, about the child's port and in its axes."""

    def momentum(self, order: int) -> ca.SX:
        """Momentum [linear, angular] (3, 2) of velocities (order 1) or displacements (0)."""

    def mass(self) -> ca.SX:
        """Total mass (kg)."""


def in_scene(space: Space, port: str, order: int) -> tuple[str, ca.SX, ca.SX]:
    """Body of a port, and its displacement and rotation (3,) of one order in the axes of the scene."""
    body, small = space.small(port, order)
    moved, turned = (space.across(v, body, "ground") for v in (small.displacement, small.rotation))
    return body, moved, turned


def column(entries: Iterable[ca.SX | float]) -> ca.SX:
    """Column (n,) of n numbers and expressions; a zero becomes a structural zero of the SX."""
    listed = tuple(entries)
    result = ca.SX(len(listed), 1)
    for k, entry in enumerate(listed):
        if not (entry.is_zero() if isinstance(entry, ca.SX) else entry == 0.0):
            result[k] = entry
    return result


def traced(function: Callable[..., ca.SX]) -> Callable[..., ca.SX]:
    """The function as one of CasADi, made once for each shape of its arguments: SX or numbers."""

    @cache
    def made(*shapes: tuple[int, int]) -> ca.Function:
        symbols = [ca.SX.sym(f"x{k}", *shape) for k, shape in enumerate(shapes)]
        return ca.Function(function.__name__.lstrip("_"), symbols, [function(*symbols)])

    @wraps(function)
    def called(*arguments: Any) -> ca.SX:
        # a copy of an SX takes as long as many operations: CasADi tries what else it could be
        entries = [a if isinstance(a, ca.SX) else ca.SX(a) for a in arguments]
        return made(*(entry.shape for entry in entries))(*entries)

    return called


def rotate(axis: ca.SX, cosine: ca.SX | float, sine: ca.SX | float, vectors: ca.SX) -> ca.SX:
    """R v for each column v of `vectors` (3, n), with the rotation R about the unit vector `axis` (3,).

    R v = v_par + cosine v_perp + sine axis x v, where v_par is the part of v along the axis and v_perp
    the part across it. R does not change v_par, so a rotation about a coordinate axis multiplies cosine
    and sine with two components only. For any other constant axis, v_perp is first written by its two
    components e1' v and e2' v across the axis: its three components depend on each other, and each would
    be multiplied with cosine and sine.
    """
    if axis.nnz() == 1:
        return _rotate(axis, cosine, sine, vectors)
    return _rotate_across(*_across(axis), cosine, sine, vectors)


@traced
def _rotate(axis: ca.SX, cosine: ca.SX, sine: ca.SX, vectors: ca.SX) -> ca.SX:
    parallel = ca.mtimes(axis, ca.mtimes(axis.T, vectors))
    perpendicular = vectors - parallel
    return parallel + cosine * perpendicular + sine * ca.mtimes(ca.skew(axis), vectors)


@traced
def _rotate_across(across: ca.SX, back: ca.SX, cosine: ca.SX, sine: ca.SX, vectors: ca.SX) -> ca.SX:
    """Rotated vectors (3, n); `across` is [e1 e2] (3, 2), `back` the same over |e1|^2."""
    first, second = ca.vertsplit(ca.mtimes(across.T, vectors))
    more = ca.vertcat(cosine * first - sine * second - first, sine * first + cosine * second - second)
    return vectors + ca.mtimes(back, more)


def _across(axis: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Vectors [e1 e2] (3, 2) across the constant unit vector `axis` (3,), e1 x e2 = |e1|^2 axis, and the
    same over |e1|^2.

    e1 and e2 are of one length. One component of e1 is zero, so that fewer products are formed.
    """
    along = numbers_of(axis)[:, 0]
    unit = ca.SX.eye(3)[:, int(np.argmin(np.abs(along)))]
    first = ca.sparsify(ca.cross(axis, unit))
    across = ca.horzcat(first, ca.cross(axis, first))
    return across, across / ca.dot(first, first)


def move_motion(motion: ca.SX, r: ca.SX) -> ca.SX:
    """Motion (3, 3) of another point of the same rigid body, at `r` (3,) from the given point (m)."""
    return motion if r.nnz() == 0 else _moved_motion(motion, r)


def move_wrench(wrench: ca.SX, r: ca.SX) -> ca.SX:
    """Wrench (3, 2) about a new point; `wrench` is about the point at `r` (3,) from the new one (m)."""
    return wrench if r.nnz() == 0 else _moved_wrench(wrench, r)


@traced
def _moved_motion(motion: ca.SX, r: ca.SX) -> ca.SX:
    omega, alpha, acceleration = ca.horzsplit(motion)
    moved = acceleration + ca.cross(alpha, r) + ca.cross(omega, ca.cross(omega, r))
    return ca.horzcat(omega, alpha, moved)


@traced
def _moved_wrench(wrench: ca.SX, r: ca.SX) -> ca.SX:
    force, torque = ca.horzsplit(wrench)
    return ca.horzcat(force, torque + ca.cross(r, force))
