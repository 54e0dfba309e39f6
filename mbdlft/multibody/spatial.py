"""Vectors and rotations in CasADi SX.

A motion is a 3 x 3 matrix whose columns are [omega, alpha, acceleration]: angular velocity (rad/s),
angular acceleration (rad/s^2) and linear acceleration (m/s^2) of one point, relative to the frame
of the scene plus the uniform acceleration of that frame, all expressed in one body frame.
A wrench is a 3 x 2 matrix [force, torque] (N, N m) about one point. This file fixes both orders.

``R_pc`` turns components in the child's frame into components in the parent's frame.
"""

from collections.abc import Iterable
from functools import cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray


class Coordinate(NamedTuple):
    """Displacements, rates and accelerations (n,) of coordinates: of a joint, a move, a body."""

    q: ca.SX
    v: ca.SX
    a: ca.SX

    def part(self, entries: int | slice) -> "Coordinate":
        """Those of some of the coordinates."""
        return Coordinate(self.q[entries], self.v[entries], self.a[entries])


def column(entries: Iterable[ca.SX | float]) -> ca.SX:
    """Column of numbers and expressions; zeros are structural."""
    given = tuple(entries)
    found = ca.SX(len(given), 1)
    for k, entry in enumerate(given):
        if not (entry.is_zero() if isinstance(entry, ca.SX) else entry == 0.0):
            found[k] = entry
    return found


def skew(a: ca.SX) -> ca.SX:
    """Matrix of the cross product: skew(a) b = a x b; a (3,), result (3, 3)."""
    return ca.skew(a)


def rotate(axis: ca.SX, cosine: ca.SX | float, sine: ca.SX | float, vectors: ca.SX) -> ca.SX:
    """R v for each column v: rotation about the unit vector `axis`; vectors (3, n), result (3, n).

    R v = v_par + cosine v_perp + sine axis x v. The component along the axis is not touched, so a
    rotation about a coordinate axis costs the work of the plane. So does one about another constant
    axis: cosine and sine meet the two components of v across the axis, not three that depend on
    each other.
    """
    if axis.nnz() == 1:
        return ca.SX(_rotate(vectors.shape[1])(axis, cosine, sine, vectors))
    return ca.SX(_rotate_across(vectors.shape[1])(_across(axis), cosine, sine, vectors))


@cache
def _rotate(columns: int) -> ca.Function:
    axis, vectors = ca.SX.sym("axis", 3), ca.SX.sym("vectors", 3, columns)
    cosine, sine = ca.SX.sym("cosine"), ca.SX.sym("sine")
    parallel = ca.mtimes(axis, ca.mtimes(axis.T, vectors))
    perpendicular = vectors - parallel
    rotated = parallel + cosine * perpendicular + sine * ca.mtimes(skew(axis), vectors)
    return ca.Function("rotate", [axis, cosine, sine, vectors], [rotated])


@cache
def _rotate_across(columns: int) -> ca.Function:
    across, vectors = ca.SX.sym("across", 3, 2), ca.SX.sym("vectors", 3, columns)
    cosine, sine = ca.SX.sym("cosine"), ca.SX.sym("sine")
    first, second = ca.vertsplit(ca.mtimes(across.T, vectors))
    more = ca.vertcat(
        cosine * first - sine * second - first, sine * first + cosine * second - second
    )
    return ca.Function(
        "rotate_across", [across, cosine, sine, vectors], [vectors + ca.mtimes(across, more)]
    )


def _across(axis: ca.SX) -> NDArray[np.float64]:
    """Unit vectors e1, e2 (3, 2) across a constant unit vector, e1 x e2 = axis; e1 has a zero."""
    along = np.asarray(ca.DM(axis).full()).ravel()
    first = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(along, first)], axis=1)


def rotate_back(axis: ca.SX, cosine: ca.SX | float, sine: ca.SX | float, vectors: ca.SX) -> ca.SX:
    """R' v for each column v; the inverse of `rotate`."""
    return rotate(axis, cosine, -sine, vectors)


def move_motion(motion: ca.SX, r: ca.SX) -> ca.SX:
    """Motion of the point at `r` (m) from the old one, of the same rigid body (3, 3)."""
    return motion if r.nnz() == 0 else _move_motion()(motion, r)


def move_wrench(wrench: ca.SX, r: ca.SX) -> ca.SX:
    """Wrench about the old point, given about the point at `r` (m) from it (3, 2)."""
    return wrench if r.nnz() == 0 else _move_wrench()(wrench, r)


@cache
def _move_motion() -> ca.Function:
    motion, r = ca.SX.sym("motion", 3, 3), ca.SX.sym("r", 3)
    omega, alpha, acceleration = ca.horzsplit(motion)
    moved = acceleration + ca.cross(alpha, r) + ca.cross(omega, ca.cross(omega, r))
    return ca.Function("move_motion", [motion, r], [ca.horzcat(omega, alpha, moved)])


@cache
def _move_wrench() -> ca.Function:
    wrench, r = ca.SX.sym("wrench", 3, 2), ca.SX.sym("r", 3)
    force, torque = ca.horzsplit(wrench)
    moved = ca.horzcat(force, torque + ca.cross(r, force))
    return ca.Function("move_wrench", [wrench, r], [moved])
