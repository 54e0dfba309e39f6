"""Whether polynomials in Bernstein form can vanish: on pieces of a box of deltas and of frequency.

A polynomial p lies in the convex hull of its coefficients p_c, each known up to an error e. If there is a
direction a, |a| = 1, with

    Re(conj(a) p_c) > e + g |q_c|        for all coefficients,

then |p| > g |q| everywhere on the piece: with q = 0 it does not vanish, and with the products q of p and
a transfer, its norm is below 1/g. (For unit vectors v, u the polynomial p - g v'q u lies in the convex
hull of p_c - g v'q_c u, where |v'q_c u| <= |q_c|, the largest singular value.) Directions that a
coefficient allows are an arc; all arcs must meet.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array

_EPS = float(np.finfo(float).eps)
_ROUNDING = 64.0 * _EPS  # of angles, and of sums of few terms: larger than what rounding makes
_SINGULAR = 1e-11  # of singular values of small matrices, relative to the largest
_LOOK = 512  # coefficients that are looked at first
Values = NDArray[np.complex128]


class Piece(NamedTuple):
    """Polynomials on a part of the box, and on low <= t <= high.

    Attributes
    ----------
    values : complex array (1 + n_gain, r_1 + 1, ..., n + 1)
        An axis of a delta that is fixed has the length 1.
    error : array (1 + n_gain, n + 1)
    low, high : float
    outputs : int
        Of the transfer, whose entries row by row are the last n_gain.
    """

    values: Values
    error: Array
    low: float
    high: float
    outputs: int = 0


class Cone(NamedTuple):
    """Angles (rad) between which all values of a polynomial lie; less than pi apart."""

    low: float
    high: float


def cone(coefficients: Values, error: Array) -> Cone | None:
    """The angles of a polynomial on a piece: coefficients (..., m + 1) with errors (m + 1,).

    None where they may span half a turn, and so the polynomial may vanish.
    """
    return _cone(coefficients, np.broadcast_to(error, coefficients.shape))


def _cone(values: Values, radius: Array) -> Cone | None:
    flat, radii = values.ravel(), np.ravel(radius)
    step = max(1, len(flat) // _LOOK)
    some = _angles(flat[::step], radii[::step])
    if some is None or step == 1:
        return some
    return _angles(flat, radii)


def _angles(flat: Values, radii: Array) -> Cone | None:
    sizes = np.abs(flat) * (1.0 - _ROUNDING)
    if not np.all(radii < sizes):
        return None
    middle = np.sum(flat / sizes)
    if middle == 0.0:
        return None
    turned = flat * np.conj(middle / abs(middle))
    angles, widths = np.arctan2(turned.imag, turned.real), np.arcsin(radii / sizes)
    low, high = float(np.min(angles - widths)), float(np.max(angles + widths))
    if not high - low < np.pi - _ROUNDING:
        return None
    base = float(np.angle(middle))
    return Cone(base + low - _ROUNDING, base + high + _ROUNDING)


def excludes(piece: Piece, gain: float) -> bool:
    """Whether p cannot vanish on a piece, and |p| > gain |q| there; `gain` is 1 over a bound."""
    p, error = piece.values[0], piece.error[0]
    if len(piece.values) == 1:
        return cone(p, error) is not None
    q = piece.values[1:]
    q = q.reshape(piece.outputs, -1, *p.shape)
    errors = np.sqrt(np.sum(piece.error[1:] ** 2, axis=0))
    size = np.sqrt(np.sum(q.real**2 + q.imag**2, axis=(0, 1)))
    if min(q.shape[:2]) > 1 and np.all(gain * size < (1.0 + q.shape[0]) * np.abs(p)):
        matrices = np.moveaxis(q.reshape(*q.shape[:2], -1), -1, 0)
        size = np.linalg.svd(matrices, compute_uv=False)[:, 0].reshape(p.shape)
    return _cone(p, (error + gain * (size + errors)) * (1.0 + _SINGULAR)) is not None


def turn_of(piece: Piece, axis: int) -> int:
    """1 or -1 if roots on this piece of the axis move to the right or left with delta; else 0.

    Where p(j omega, delta) = 0, the real part of the root changes by Im(p_delta / p_omega) d delta.
    """
    p, error = piece.values[0], piece.error[0]
    along = cone(np.diff(p, axis=axis), 2.0 * error + 2.0 * _EPS * _largest(p))
    if along is None:
        return 0
    speed = cone(np.diff(p, axis=-1), _pairs(error) + 2.0 * _EPS * _pairs(_largest(p)))
    if speed is None:
        return 0
    low, high = along.low - speed.high - _ROUNDING, along.high - speed.low + _ROUNDING
    half = np.floor(low / np.pi)
    if half != np.floor(high / np.pi) or high - low >= np.pi - _ROUNDING:
        return 0
    return 1 if half % 2 == 0 else -1


def _largest(values: Values) -> Array:
    """The largest size for each power of t (m + 1,)."""
    return np.asarray(np.max(np.abs(values), axis=tuple(range(values.ndim - 1))))


def _pairs(row: Array) -> Array:
    return row[..., 1:] + row[..., :-1]


def spreads(piece: Piece) -> Array:
    """How much p changes along each delta, and along t, relative to its size: (number of deltas + 1,)."""
    p = piece.values[0]
    size = float(np.mean(np.abs(p)))
    found = [
        float(np.max(np.sum(np.abs(np.diff(p, axis=k)), axis=k), initial=0.0))
        for k in range(p.ndim)
    ]
    return np.asarray(found) / max(size, 1e-300)


def halves(piece: Piece, axis: int) -> tuple[Piece, Piece]:
    """Both halves of a piece along a delta, the lower first; -1 is the axis of t (de Casteljau)."""
    along = axis + 1 if axis >= 0 else -1
    largest = np.stack([_largest(row) for row in piece.values])
    low, high = _split(piece.values, along)
    if axis >= 0:
        error = piece.error + (piece.values.shape[along] - 1) * 2.0 * _EPS * largest
        return piece._replace(values=low, error=error), piece._replace(values=high, error=error)
    n, middle = piece.error.shape[-1], 0.5 * (piece.low + piece.high)
    errors = [
        (e + n * 2.0 * _EPS * m) * (1.0 + 2.0 * n * _EPS)
        for e, m in zip(_split(piece.error, -1), _split(largest, -1), strict=True)
    ]
    return (
        piece._replace(values=low, error=errors[0], high=middle),
        piece._replace(values=high, error=errors[1], low=middle),
    )


def _split(values: Any, axis: int) -> tuple[Any, Any]:
    """Coefficients on both halves of an axis."""
    row = np.moveaxis(values, axis, 0)
    low, high = [row[0]], [row[-1]]
    while len(row) > 1:
        row = 0.5 * (row[1:] + row[:-1])
        low.append(row[0])
        high.append(row[-1])
    return np.stack(low, axis=axis), np.stack(high[::-1], axis=axis)


def fixed(piece: Piece, axis: int, side: int) -> Piece:
    """The piece on the face where a delta has its lower (-1) or upper (1) end."""
    place = -1 if side > 0 else 0
    return piece._replace(values=np.take(piece.values, [place], axis=axis + 1))
