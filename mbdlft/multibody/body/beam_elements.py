"""Shape functions of a straight beam, and their integrals: matrices of numbers for each deformation.

A deformation (axial, torsion or bending) is a function w(s) of s = x/L in [0, 1], zero at s = 0, and for
bending a turn t(s), which is L times the rotation of the section, zero at s = 0 too. Without shear,
t = dw/ds. Every function is made of polynomials on pieces between nodes, with fractions as coefficients,
by FLINT, and every integral is exact until it is rounded once. ds = 1/n for n elements. Coordinates are

    elements   axial, torsion: w at the nodes (linear functions)
               bending, cubic: w and ds dw/ds at the nodes; quintic: also ds^2 d2w/ds2
               bending with shear: w of degree 4 and t of degree 3 on each element, w and ds t at the
               nodes, and five functions that are zero at the nodes
    modes      s, ..., s^r; in bending s^2, ..., s^(r+1): among them are all deflections by loads at the
               tip. At each station with (s - a)_+; in bending (s - a)_+^2 and (s - a)_+^3. They are
               orthogonalized once and for all: int N'N ds = 1, int ddN'ddN ds = diag(values).
"""

from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.multibody.body.beam_modes import combined, exact_modes

Polynomial = tuple[Fraction, ...]  # a weight: coefficients, the constant first
ONE = (Fraction(1),)
LINEAR = (Fraction(0), Fraction(1))  # s
_HALF = Fraction(1, 2)
_Functions = tuple[flint.fmpq_poly, ...]


class Deformation(NamedTuple):
    """What one deformation is made of; free functions compute its integrals.

    Attributes
    ----------
    name : ``axial``, ``torsion``, ``bending_y`` or ``bending_z``
    functions : ``cubic``, ``quintic`` or ``shear``
    elements : number of equal parts, whose ends are the nodes 0 to `elements`
    modes : number of polynomials; None for finite elements
    breaks : nodes inside at which modes have stations, ascending
    """

    name: str
    functions: str
    elements: int
    modes: int | None = None
    breaks: tuple[int, ...] = ()


class _Piece(NamedTuple):
    """Polynomials in x on s = start + length x, 0 <= x <= 1, of consecutive coordinates.

    `displacement` is w, `slope` dw/ds, `turn` t, `bend` dt/ds, `shear` dw/ds - t; all by one coordinate.
    """

    start: flint.fmpq
    length: flint.fmpq
    first: int
    displacement: _Functions
    slope: _Functions
    turn: _Functions
    bend: _Functions
    shear: _Functions


@cache
def products(
    d: Deformation, what: str, weight: Polynomial = ONE, first: int = 0, last: int | None = None
) -> NDArray[np.float64]:
    """Integrals (n, n) of weight(s) f_i f_j ds between two nodes, for f = `what`, a field of `_Piece`.

    The array is shared: do not write to it.
    """
    whole = weight == ONE and not first and last in (None, d.elements)
    if d.modes is not None and whole and what in ("displacement", strain(d)):
        values = _modal(d)[1]
        return np.eye(len(values)) if what == "displacement" else np.diag(values)
    return cross_products(d, what, d, what, weight, first, last)


@cache
def cross_products(
    d: Deformation,
    what: str,
    other: Deformation,
    what_other: str,
    weight: Polynomial = ONE,
    first: int = 0,
    last: int | None = None,
) -> NDArray[np.float64]:
    """Integrals (n, m) of weight(s) f_i g_j ds between two nodes, of deformations with equal nodes."""
    raw = _raw(d, what, other, what_other, weight, first, last)
    clamped = raw[_clamped(d) :, _clamped(other) :]
    if d.modes is None:
        return clamped
    return combined(_modal(d)[0], clamped, _modal(other)[0])


@cache
def moments(
    d: Deformation, what: str, weight: Polynomial = ONE, first: int = 0, last: int | None = None
) -> NDArray[np.float64]:
    """Integrals (n,) of weight(s) f_i ds between two nodes."""
    begin, end = _between(d, first, last)
    total = [flint.fmpq(0)] * _count(d)
    for piece in _pieces(d):
        if not begin <= piece.start < end:
            continue
        local = _in_piece(weight, piece)
        for k, f in enumerate(getattr(piece, what)):
            total[piece.first + k] += _integral(local * f) * piece.length
    return _as_row(d, total)


@cache
def values_at(d: Deformation, what: str, node: int) -> NDArray[np.float64]:
    """Values (n,) of ``displacement`` or ``turn`` at a node from 1 to `elements`."""
    at, row = flint.fmpq(node, d.elements), [flint.fmpq(0)] * _count(d)
    piece = next(p for p in _pieces(d) if p.start < at <= p.start + p.length)
    x = (at - piece.start) / piece.length
    for k, f in enumerate(getattr(piece, what)):
        row[piece.first + k] = f(x)
    return _as_row(d, row)


def strain(d: Deformation) -> str:
    """The field of `_Piece` whose products make the stiffness: dt/ds of bending, else dw/ds."""
    return "bend" if _bends(d) else "slope"


def size(d: Deformation) -> int:
    """Number of coordinates."""
    return _count(d) - _clamped(d)


# modes ---------------------------------------------------------------------------------------


@cache
def _modal(d: Deformation) -> tuple[Any, NDArray[np.float64]]:
    """The combinations (n, n) of the polynomials that are modes, and int ddN ddN ds of each (n,)."""
    mass, stiffness = (_raw(d, what, d, what, ONE, 0, None) for what in ("displacement", strain(d)))
    return exact_modes(mass, stiffness)


# integrals -----------------------------------------------------------------------------------


def _raw(
    d: Deformation,
    what: str,
    other: Deformation,
    what_other: str,
    weight: Polynomial,
    first: int,
    last: int | None,
) -> NDArray[Any]:
    """As `cross_products`, with the coordinates that are clamped; exact for modes."""
    begin, end = _between(d, first, last)
    rounded = _doubles if d.modes is None else np.asarray
    total = rounded(np.full((_count(d), _count(other)), flint.fmpq(0)))
    known: dict[tuple[int, int, int], NDArray[Any]] = {}
    for left, right in zip(_pieces(d), _pieces(other), strict=True):
        if not begin <= left.start < end:
            continue
        f, g = getattr(left, what), getattr(right, what_other)
        rows = slice(left.first, left.first + len(f))
        columns = slice(right.first, right.first + len(g))
        for power, c in enumerate(_in_piece(weight, left).coeffs()):
            key = (id(f), id(g), power)
            if key not in known:
                exact = [[_integral(a * b * _X**power) for b in g] for a in f]
                known[key] = rounded(np.array(exact, dtype=object))
            total[rows, columns] += known[key] * rounded(np.array([c * left.length]))
    return total


def _between(d: Deformation, first: int, last: int | None) -> tuple[flint.fmpq, flint.fmpq]:
    """Positions s of two nodes; the tip where there is no last one."""
    end = d.elements if last is None else last
    return flint.fmpq(first, d.elements), flint.fmpq(end, d.elements)


def _integral(f: flint.fmpq_poly) -> flint.fmpq:
    """The integral of f(x) over [0, 1]."""
    return f.integral()(1)


def _in_piece(f: Polynomial, piece: _Piece) -> flint.fmpq_poly:
    """The polynomial f(s) as one of x."""
    (whole,) = _polynomials(f)
    return whole(flint.fmpq_poly([piece.start, piece.length]))


def _doubles(entries: NDArray[Any]) -> NDArray[np.float64]:
    """Exact entries, each rounded once."""
    return np.array([int(e.p) / int(e.q) for e in entries.ravel()]).reshape(entries.shape)


def _as_row(d: Deformation, entries: Sequence[flint.fmpq]) -> NDArray[np.float64]:
    """Entries of all coordinates as those (n,) of the free ones, in modal form if there are modes."""
    row = np.array(entries[_clamped(d) :], dtype=object)
    if d.modes is None:
        return _doubles(row)
    return combined(_modal(d)[0], row[:, None])[:, 0]


# pieces --------------------------------------------------------------------------------------


def _bends(d: Deformation) -> bool:
    return d.name.startswith("bending")


def _per_element(d: Deformation) -> int:
    """By how many coordinates the first one of the next element is farther."""
    if not _bends(d):
        return 1
    return {"cubic": 2, "quintic": 3, "shear": 7}[d.functions]


def _count(d: Deformation) -> int:
    """Number of coordinates, with those that the clamp holds."""
    if d.modes is not None:
        return d.modes + len(d.breaks) * (2 if _bends(d) else 1)
    return _per_element(d) * d.elements + len(_element(d)) - _per_element(d)


def _clamped(d: Deformation) -> int:
    """Number of coordinates of the first node that the clamp holds: all but its curvature."""
    if d.modes is not None:
        return 0
    return 2 if _bends(d) else 1


@cache
def _pieces(d: Deformation) -> tuple[_Piece, ...]:
    if d.modes is not None:
        return _modal_pieces(d)
    ds = flint.fmpq(1, d.elements)
    shear = _bends(d) and d.functions == "shear"
    turn = tuple(t / ds for t in _SHEAR_TURNS) if shear else None
    one = _piece(flint.fmpq(0), ds, _element(d), turn)
    return tuple(one._replace(start=k * ds, first=k * _per_element(d)) for k in range(d.elements))


def _piece(start: flint.fmpq, length: flint.fmpq, w: _Functions, turn: _Functions | None) -> _Piece:
    slope = tuple(f.derivative() / length for f in w)
    turn = slope if turn is None else turn
    bend = tuple(f.derivative() / length for f in turn)
    shear = tuple(f - g for f, g in zip(slope, turn, strict=True))
    return _Piece(start, length, 0, w, slope, turn, bend, shear)


def _modal_pieces(d: Deformation) -> tuple[_Piece, ...]:
    """Powers of s, and powers of s - a beyond each station a."""
    assert d.modes is not None
    lowest = 2 if _bends(d) else 1
    ends = [flint.fmpq(k, d.elements) for k in (0, *d.breaks, d.elements)]
    found = []
    for start, end in pairwise(ends):
        length = end - start
        powers = [(flint.fmpq(0), k) for k in range(lowest, lowest + d.modes)]
        powers += [(a, k) for a in ends[1:-1] for k in range(lowest, 2 * lowest)]
        w = tuple(
            flint.fmpq_poly([start - a, length]) ** k if a <= start else flint.fmpq_poly([])
            for a, k in powers
        )
        found.append(_piece(start, length, w, None))
    return tuple(found)


def _polynomials(*rows: Sequence[int | Fraction]) -> _Functions:
    return tuple(
        flint.fmpq_poly([flint.fmpq(c.numerator, c.denominator) for c in row]) for row in rows
    )


def _element(d: Deformation) -> _Functions:
    """Functions w(x) on one element."""
    return _LINEAR if not _bends(d) else _BENDING[d.functions]


_X = flint.fmpq_poly([0, 1])
_LINEAR = _polynomials((1, -1), (0, 1))
_CUBIC = _polynomials((1, 0, -3, 2), (0, 1, -2, 1), (0, 0, 3, -2), (0, 0, -1, 1))
_QUINTIC = _polynomials(
    (1, 0, 0, -10, 15, -6),
    (0, 1, 0, -6, 8, -3),
    (0, 0, _HALF, -3 * _HALF, 3 * _HALF, -_HALF),
    (0, 0, 0, 10, -15, 6),
    (0, 0, 0, -4, 7, -3),
    (0, 0, 0, _HALF, -1, _HALF),
)
# w and ds t of the first node, three functions of w and two of t that are zero at both, the last node
_NOTHING = (0,)
_BUBBLES = ((0, 1, -1), (0, 1, -3, 2), (0, 1, -6, 10, -5))
_SHEAR = _polynomials((1, -1), _NOTHING, *_BUBBLES, _NOTHING, _NOTHING, (0, 1), _NOTHING)
_SHEAR_TURNS = _polynomials(
    _NOTHING, (1, -1), _NOTHING, _NOTHING, _NOTHING, *_BUBBLES[:2], _NOTHING, (0, 1)
)
_BENDING = {"cubic": _CUBIC, "quintic": _QUINTIC, "shear": _SHEAR}
