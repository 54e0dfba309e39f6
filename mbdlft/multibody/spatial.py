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

from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

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


def column(entries: Iterable[ca.SX | float]) -> ca.SX:
    """Column (n,) of n numbers and expressions; a zero becomes a structural zero of the SX."""
    listed = tuple(entries)
    result = ca.SX(len(listed), 1)
    for k, entry in enumerate(listed):
        if not (entry.is_zero() if isinstance(entry, ca.SX) else entry == 0.0):
            result[k] = entry
    return result


def rotate(axis: ca.SX, cosine: ca.SX | float, sine: ca.SX | float, vectors: ca.SX) -> ca.SX:
    """R v for each column v of `vectors` (3, n), with the rotation R about the unit vector `axis` (3,).

    R v = v_par + cosine v_perp + sine axis x v, where v_par is the part of v along the axis and v_perp
    the part across it. R does not change v_par, so a rotation about a coordinate axis multiplies cosine
    and sine with two components only. For any other constant axis, v_perp is first written by its two
    components e1' v and e2' v across the axis: its three components depend on each other, and each would
    be multiplied with cosine and sine.
    """
    if axis.nnz() == 1:
        return ca.SX(_rotate(vectors.shape[1])(axis, cosine, sine, vectors))
    return ca.SX(_rotate_across(vectors.shape[1])(*_across(axis), cosine, sine, vectors))


@cache
def _rotate(columns: int) -> ca.Function:
    """(axis (3,), cosine, sine, vectors (3, columns)) -> rotated vectors (3, columns)."""
    axis, vectors = ca.SX.sym("axis", 3), ca.SX.sym("vectors", 3, columns)
    cosine, sine = ca.SX.sym("cosine"), ca.SX.sym("sine")
    parallel = ca.mtimes(axis, ca.mtimes(axis.T, vectors))
    perpendicular = vectors - parallel
    rotated = parallel + cosine * perpendicular + sine * ca.mtimes(ca.skew(axis), vectors)
    return ca.Function("rotate", [axis, cosine, sine, vectors], [rotated])


@cache
def _rotate_across(columns: int) -> ca.Function:
    """([e1 e2], [e1 e2]/|e1|^2 (3, 2), cosine, sine, vectors (3, columns)) -> rotated (3, columns)."""
    across, vectors = ca.SX.sym("across", 3, 2), ca.SX.sym("vectors", 3, columns)
    back = ca.SX.sym("back", 3, 2)
    cosine, sine = ca.SX.sym("cosine"), ca.SX.sym("sine")
    first, second = ca.vertsplit(ca.mtimes(across.T, vectors))
    more = ca.vertcat(cosine * first - sine * second - first, sine * first + cosine * second - second)
    return ca.Function(
        "rotate_across", [across, back, cosine, sine, vectors], [vectors + ca.mtimes(back, more)]
    )


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


def rotate_back(axis: ca.SX, cosine: ca.SX | float, sine: ca.SX | float, vectors: ca.SX) -> ca.SX:
    """R' v for each column v; the inverse of `rotate`."""
    return rotate(axis, cosine, -sine, vectors)


def move_motion(motion: ca.SX, r: ca.SX) -> ca.SX:
    """Motion (3, 3) of another point of the same rigid body, at `r` (3,) from the given point (m)."""
    return motion if r.nnz() == 0 else _move_motion()(motion, r)


def move_wrench(wrench: ca.SX, r: ca.SX) -> ca.SX:
    """Wrench (3, 2) about a new point; `wrench` is about the point at `r` (3,) from the new one (m)."""
    return wrench if r.nnz() == 0 else _move_wrench()(wrench, r)


@cache
def _move_motion() -> ca.Function:
    """(motion (3, 3), r (3,)) -> motion (3, 3)."""
    motion, r = ca.SX.sym("motion", 3, 3), ca.SX.sym("r", 3)
    omega, alpha, acceleration = ca.horzsplit(motion)
    moved = acceleration + ca.cross(alpha, r) + ca.cross(omega, ca.cross(omega, r))
    return ca.Function("move_motion", [motion, r], [ca.horzcat(omega, alpha, moved)])


@cache
def _move_wrench() -> ca.Function:
    """(wrench (3, 2), r (3,)) -> wrench (3, 2)."""
    wrench, r = ca.SX.sym("wrench", 3, 2), ca.SX.sym("r", 3)
    force, torque = ca.horzsplit(wrench)
    moved = ca.horzcat(force, torque + ca.cross(r, force))
    return ca.Function("move_wrench", [wrench, r], [moved])
