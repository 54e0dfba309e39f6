"""Bodies in space in 150 digits: vectors, turns, motions and their algebra; derivatives are differences.

A step of 2^-150 leaves 1e-45 out. Two differences, one of second order in time, cancel 350 of 512 bits.
Poses turn by the first two terms of the exponential: what is left out is of third order in steps.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import flint
import numpy as np
from scipy.linalg import qr

BITS = 512
RANK = 1e-11  # of scaled rows, in doubles: rows of closures depend on others, or are far from that

Vector, Matrix, Values = Any, Any, list[Any]  # arb_mat (3, 1), arb_mat (3, 3), numbers


def number(x: Any) -> Any:
    """A number as it is written: 0.1 is a tenth."""
    return flint.arb(repr(x) if isinstance(x, float) else x)


def vector(entries: Sequence[Any]) -> Vector:
    return flint.arb_mat(3, 1, [number(x) for x in entries])


def skew(v: Vector) -> Matrix:
    x, y, z = v.entries()
    return flint.arb_mat(3, 3, [0, -z, y, z, 0, -x, -y, x, 0])


def cross(a: Vector, b: Vector) -> Vector:
    return skew(a) * b


def dot(a: Vector, b: Vector) -> Any:
    return (a.transpose() * b)[0, 0]


def unit(axis: Sequence[Any]) -> Vector:
    v = vector(axis)
    return v * (1 / dot(v, v).sqrt())


def rotation(axis: Sequence[Any], angle: Any) -> Matrix:
    k, angle = skew(unit(axis)), number(angle)
    return EYE + k * angle.sin() + k * k * (1 - angle.cos())


def sine_axis(R: Matrix) -> Vector:
    """Axis of a rotation times the sine of its angle."""
    entries = (R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    return flint.arb_mat(3, 1, [x / 2 for x in entries])


EYE = flint.arb_mat(3, 3, [1, 0, 0, 0, 1, 0, 0, 0, 1])
AXES = [vector(row) for row in np.eye(3).tolist()]
NONE = vector((0, 0, 0))
TIME = flint.arb(2) ** -100
STEP = flint.arb(2) ** -150


class Motion(NamedTuple):
    """Place (3,) and turn (3, 3) of a body in the scene, and their derivatives by time (3,)."""

    place: Vector
    turn: Matrix
    velocity: Vector = NONE
    omega: Vector = NONE
    acceleration: Vector = NONE
    alpha: Vector = NONE

    def moved(self, order: int, k: int) -> "Motion":
        """A step of the displacement (order 0), its rate or acceleration: places, then rotations."""
        step = AXES[k % 3] * STEP
        if k < 3:
            name = ("place", "velocity", "acceleration")[order]
            return self._replace(**{name: getattr(self, name) + step})
        if order == 2:
            return self._replace(alpha=self.alpha + step)
        alpha = self.alpha + cross(step, (self.alpha, self.omega)[order])
        if order == 1:
            return self._replace(omega=self.omega + step, alpha=alpha)
        turned, omega = (EYE + skew(step)) * self.turn, self.omega + cross(step, self.omega)
        return self._replace(turn=turned, omega=omega, alpha=alpha)

    def after(self, t: Any) -> "Motion":
        """The pose a little later."""
        angle = skew(self.omega * t + self.alpha * (t * t / 2))
        place = self.place + self.velocity * t + self.acceleration * (t * t / 2)
        return Motion(place, (EYE + angle + angle * angle * flint.arb(0.5)) * self.turn)

    def point(self, r: Vector) -> Vector:
        return self.place + self.turn * r

    def felt(self, r: Vector, spin: Vector, load: Vector) -> Vector:
        """Acceleration of a point of the body in a frame that spins and falls by `load`."""
        c = self.turn * r
        velocity = self.velocity + cross(self.omega, c)
        a = self.acceleration + cross(self.alpha, c) + cross(self.omega, cross(self.omega, c))
        return a + cross(spin, velocity) * 2 + cross(spin, cross(spin, self.place + c)) - load


GROUND = Motion(NONE, EYE)


# arrays of such numbers ------------------------------------------------------------------------


def zeros(*shape: int) -> np.ndarray:
    return np.full(shape, flint.arb(0), dtype=object)


def rows_of(rows: Sequence[Any], columns: int) -> np.ndarray:
    return np.array(rows, dtype=object).reshape(len(rows), columns)


def array(a: Matrix) -> np.ndarray:
    return np.array(a.entries(), dtype=object).reshape(a.nrows(), a.ncols())


def _matrix(a: np.ndarray) -> Matrix:
    return flint.arb_mat(*a.shape, [flint.arb(x) for x in a.ravel().tolist()])


def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    if 0 in (*a.shape, *b.shape):
        return zeros(a.shape[0], b.shape[1])
    return array(_matrix(a) * _matrix(b))


def solve(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return array(_matrix(a).solve(_matrix(b))) if len(a) else zeros(0, b.shape[1])


def independent(rows: np.ndarray) -> list[int]:
    """Positions of rows that are independent and span all of them, decided in doubles."""
    if not rows.size:
        return []
    a = rows.astype(float)
    sizes = np.max(np.abs(a), axis=1, keepdims=True)
    _, triangle, order = qr((a / np.where(sizes > 0, sizes, 1.0)).T, mode="economic", pivoting=True)
    steps = np.abs(np.diag(triangle))
    return sorted(order[: int(np.sum(steps > RANK * np.max(steps)))].tolist())
