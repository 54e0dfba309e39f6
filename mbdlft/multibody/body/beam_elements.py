"""Shape functions of a straight beam, and their integrals: matrices of numbers for each deformation.

A deformation (axial, torsion or bending) is a function w(s) of s = x/L in [0, 1], zero at s = 0, and for
bending a turn t(s), which is L times the rotation of the section, zero at s = 0 too. Without shear,
t = dw/ds. Every function is made of polynomials on pieces between nodes, with fractions as coefficients,
and every integral is exact until it is rounded once. ds = 1/n for n elements. Coordinates are

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
from math import comb
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbdlft.multibody.body.beam_modes import combined, exact_modes

Polynomial = tuple[Fraction, ...]  # coefficients, the constant first
ONE = (Fraction(1),)
LINEAR = (Fraction(0), Fraction(1))  # s
_HALF = Fraction(1, 2)


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

    start: Fraction
    length: Fraction
    first: int
    displacement: tuple[Polynomial, ...]
    slope: tuple[Polynomial, ...]
    turn: tuple[Polynomial, ...]
    bend: tuple[Polynomial, ...]
    shear: tuple[Polynomial, ...]


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
        return np.asarray(clamped, dtype=float)
    return combined(_modal(d)[0], clamped, _modal(other)[0])


@cache
def moments(
    d: Deformation, what: str, weight: Polynomial = ONE, first: int = 0, last: int | None = None
) -> NDArray[np.float64]:
    """Integrals (n,) of weight(s) f_i ds between two nodes."""
    begin, end = _between(d, first, last)
    total = [Fraction(0)] * _count(d)
    for piece in _pieces(d):
        if not begin <= piece.start < end:
            continue
        local = _in_piece(weight, piece)
        for k, f in enumerate(getattr(piece, what)):
            own = sum((c * _moment(f, power) for power, c in enumerate(local)), Fraction(0))
            total[piece.first + k] += own * piece.length
    return _as_row(d, total)


@cache
def values_at(d: Deformation, what: str, node: int) -> NDArray[np.float64]:
    """Values (n,) of ``displacement`` or ``turn`` at a node from 1 to `elements`."""
    at, row = Fraction(node, d.elements), [Fraction(0)] * _count(d)
    piece = next(p for p in _pieces(d) if p.start < at <= p.start + p.length)
    x = (at - piece.start) / piece.length
    for k, f in enumerate(getattr(piece, what)):
        row[piece.first + k] = sum((c * x**i for i, c in enumerate(f)), Fraction(0))
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
    dtype = float if d.modes is None else object
    total = np.zeros((_count(d), _count(other)), dtype=dtype)
    if dtype is object:
        total = total + Fraction(0)
    known: dict[tuple[int, int, int], NDArray[Any]] = {}
    for left, right in zip(_pieces(d), _pieces(other), strict=True):
        if not begin <= left.start < end:
            continue
        f, g = getattr(left, what), getattr(right, what_other)
        rows = slice(left.first, left.first + len(f))
        columns = slice(right.first, right.first + len(g))
        for power, c in enumerate(_in_piece(weight, left)):
            key = (id(f), id(g), power)
            if key not in known:
                exact = [[_moment(_times(a, b), power) for b in g] for a in f]
                known[key] = np.array(exact, dtype=object).astype(dtype)
            factor = c * left.length
            total[rows, columns] += known[key] * (factor if dtype is object else float(factor))
    return total


def _between(d: Deformation, first: int, last: int | None) -> tuple[Fraction, Fraction]:
    """Positions s of two nodes; the tip where there is no last one."""
    return Fraction(first, d.elements), Fraction(d.elements if last is None else last, d.elements)


def _moment(f: Polynomial, power: int) -> Fraction:
    """The integral of x^power f(x) over [0, 1]."""
    return sum((c / (k + power + 1) for k, c in enumerate(f)), Fraction(0))


def _times(f: Polynomial, g: Polynomial) -> Polynomial:
    product = [Fraction(0)] * (len(f) + len(g) - 1)
    for i, a in enumerate(f):
        for j, b in enumerate(g):
            product[i + j] += a * b
    return tuple(product)


def _slope(f: Polynomial, length: Fraction) -> Polynomial:
    """df/ds of f(x), s = start + length x."""
    return tuple(k * c / length for k, c in enumerate(f))[1:] or (Fraction(0),)


def _less(f: Polynomial, g: Polynomial) -> Polynomial:
    n = max(len(f), len(g))
    a, b = ((*h, *[Fraction(0)] * (n - len(h))) for h in (f, g))
    return tuple(p - q for p, q in zip(a, b, strict=True))


def _in_piece(f: Polynomial, piece: _Piece) -> Polynomial:
    """The polynomial f(s) as one of x."""
    return _moved(f, piece.start, piece.length)


def _moved(f: Polynomial, start: Fraction, length: Fraction) -> Polynomial:
    """f(start + length x) as a polynomial of x."""
    moved = [Fraction(0)] * len(f)
    for k, c in enumerate(f):
        for j in range(k + 1):
            moved[j] += c * comb(k, j) * start ** (k - j) * length**j
    return tuple(moved)


def _as_row(d: Deformation, entries: Sequence[Fraction]) -> NDArray[np.float64]:
    """Entries of all coordinates as those (n,) of the free ones, in modal form if there are modes."""
    row = np.array(entries[_clamped(d) :], dtype=object)
    if d.modes is None:
        return row.astype(float)
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
    ds = Fraction(1, d.elements)
    w = _element(d)
    if _bends(d) and d.functions == "shear":
        turn = tuple(tuple(c / ds for c in t) for t in _SHEAR_TURNS)
    else:
        turn = tuple(_slope(f, ds) for f in w)
    one = _piece(Fraction(0), ds, w, turn)
    return tuple(one._replace(start=k * ds, first=k * _per_element(d)) for k in range(d.elements))


def _piece(
    start: Fraction,
    length: Fraction,
    w: tuple[Polynomial, ...],
    turn: tuple[Polynomial, ...] | None,
) -> _Piece:
    slope = tuple(_slope(f, length) for f in w)
    turn = slope if turn is None else turn
    bend = tuple(_slope(f, length) for f in turn)
    shear = tuple(_less(f, g) for f, g in zip(slope, turn, strict=True))
    return _Piece(start, length, 0, w, slope, turn, bend, shear)


def _modal_pieces(d: Deformation) -> tuple[_Piece, ...]:
    """Powers of s, and powers of s - a beyond each station a."""
    assert d.modes is not None
    lowest = 2 if _bends(d) else 1
    ends = [Fraction(k, d.elements) for k in (0, *d.breaks, d.elements)]
    found = []
    for start, end in pairwise(ends):
        length = end - start
        powers = [(Fraction(0), k) for k in range(lowest, lowest + d.modes)]
        powers += [(a, k) for a in ends[1:-1] for k in range(lowest, 2 * lowest)]
        w = tuple(
            _moved((*[Fraction(0)] * k, Fraction(1)), start - a, length)
            if a <= start
            else (Fraction(0),)
            for a, k in powers
        )
        found.append(_piece(start, length, w, None))
    return tuple(found)


def _polynomials(*rows: Sequence[int | Fraction]) -> tuple[Polynomial, ...]:
    return tuple(tuple(map(Fraction, row)) for row in rows)


def _element(d: Deformation) -> tuple[Polynomial, ...]:
    """Functions w(x) on one element."""
    return _LINEAR if not _bends(d) else _BENDING[d.functions]


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
