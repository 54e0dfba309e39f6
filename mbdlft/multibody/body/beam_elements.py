"""A straight beam: shape functions, their integrals, modes, and what loads and spin do to a bent beam.

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

Polynomials up to a high degree are nearly dependent, and a spectrum of many decades loses the digits of
its small end. So FLINT encloses the modes in balls, with more bits until all are narrow.

An axial force N(s), positive where it pulls, does the work of the shortening int (dw/dx)^2/2 dx of a bent
beam, and turns a section with the polar radius of gyration r by phi at the cost of N r^2 (dphi/dx)^2/2:

    K_G = 1/L int N dN'dN ds        (for torsion times (I_y + I_z)/A)

A pull F at the place s1 has N = F for s < s1. The beam itself, with the proper acceleration a_x of its
origin and the spin omega of its frame, all in its own axes, has

    N = -rho A L a_x (1 - s) + rho A L^2 (omega_y^2 + omega_z^2) (1 - s^2)/2

In a frame that spins, a point at L s + u has the acceleration a + omega x (omega x (L s + u))
+ 2 omega x udot + uddot besides that of alpha. The mass is on the axis.

Source: for K_G, Przemieniecki, Theory of Matrix Structural Analysis, sections 15.2 and 15.3; the laws of
`tests/reference/test_loaded_beams.py` compare with exact solutions.
"""

from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.description import Values
from mbdlft.base.errors import AnalysisError
from mbdlft.multibody.body.elastic import Term, times
from mbdlft.multibody.spatial import Coordinate

Polynomial = tuple[Fraction, ...]  # a weight: coefficients, the constant first
ONE = (Fraction(1),)
LINEAR = (Fraction(0), Fraction(1))  # s
_HALF = Fraction(1, 2)
_Functions = tuple[flint.fmpq_poly, ...]


class Deformation(NamedTuple):
    """What one deformation is made of; free functions compute its integrals."""

    name: str  # ``axial``, ``torsion``, ``bending_y`` or ``bending_z``
    functions: str  # ``cubic``, ``quintic`` or ``shear``
    elements: int  # number of equal parts, whose ends are the nodes 0 to `elements`
    modes: int | None = None  # number of polynomials; None for finite elements
    breaks: tuple[int, ...] = ()  # nodes inside at which modes have stations, ascending


class _Piece(NamedTuple):
    """Polynomials in x on s = start + length x, 0 <= x <= 1, of coordinates from `first` on."""

    start: flint.fmpq
    length: flint.fmpq
    first: int
    displacement: _Functions  # w
    slope: _Functions  # dw/ds
    turn: _Functions  # t
    bend: _Functions  # dt/ds
    shear: _Functions  # dw/ds - t


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
    for piece, other_piece in zip(_pieces(d), _pieces(other), strict=True):
        if not begin <= piece.start < end:
            continue
        f, g = getattr(piece, what), getattr(other_piece, what_other)
        rows = slice(piece.first, piece.first + len(f))
        columns = slice(other_piece.first, other_piece.first + len(g))
        for power, c in enumerate(_in_piece(weight, piece).coeffs()):
            key = (id(f), id(g), power)
            if key not in known:
                exact = [[_integral(a * b * _X**power) for b in g] for a in f]
                known[key] = rounded(np.array(exact, dtype=object))
            total[rows, columns] += known[key] * rounded(np.array([c * piece.length]))
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
    first = _piece(flint.fmpq(0), ds, _element(d), turn)
    return tuple(first._replace(start=k * ds, first=k * _per_element(d)) for k in range(d.elements))


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
    pieces = []
    for start, end in pairwise(ends):
        length = end - start
        powers = [(flint.fmpq(0), k) for k in range(lowest, lowest + d.modes)]
        powers += [(a, k) for a in ends[1:-1] for k in range(lowest, 2 * lowest)]
        w = tuple(
            flint.fmpq_poly([start - a, length]) ** k if a <= start else flint.fmpq_poly([])
            for a, k in powers
        )
        pieces.append(_piece(start, length, w, None))
    return tuple(pieces)


def _polynomials(*rows: Sequence[int | Fraction]) -> _Functions:
    return tuple(flint.fmpq_poly([flint.fmpq(c.numerator, c.denominator) for c in row]) for row in rows)


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


# modes ---------------------------------------------------------------------------------------

DIGITS = 400  # behind the point; products of modes cancel up to some 200 of them
BITS = (512, 1024, 2048, 4096, 8192)

Modes = tuple[Any, NDArray[np.float64]]


def exact_modes(mass: NDArray[np.object_], stiffness: NDArray[np.object_]) -> Modes:
    """X (n, n), of FLINT, with X' M X = 1 and X' K X = diag(values), and the values (n,), ascending.

    M and K (n, n) of Fraction are symmetric and positive definite, with distinct values.
    """
    M, K = _rational(mass), _rational(stiffness)
    for bits in BITS:
        with flint.ctx.workprec(bits):
            modes = _enclosed(M, K)
        if modes is not None:
            return modes
    raise AnalysisError(f"modes of {len(mass)} shapes: {BITS[-1]} bits do not tell them apart.")


def _enclosed(M: Any, K: Any) -> Modes | None:
    """As `exact_modes`; None if there are too few bits."""
    try:
        inverses, vectors = flint.acb_mat(K.solve(M)).eig(right=True)
    except ValueError:  # two of them are not told apart
        return None
    n, values = M.nrows(), [float(1 / inverse.real) for inverse in inverses]
    modes = []
    for k in np.argsort(values):
        phi = flint.arb_mat(n, 1, [vectors[i, int(k)].real for i in range(n)])
        phi = phi * (1 / (phi.transpose() * M * phi)[0, 0].sqrt())
        # phi and -phi are the same mode: it is positive, as the sum of its coefficients says
        modes.append((phi if sum(phi.entries()).mid() >= 0 else -phi).entries())
    X = flint.arb_mat(modes).transpose()
    if max(entry.rad() for entry in X.entries()) > flint.arb(2) ** -DIGITS:
        return None
    return X, np.sort(values)


def combined(X: Any, matrix: NDArray[np.object_], Y: Any | None = None) -> NDArray[np.float64]:
    """X' A Y of fractions A (n, m), with X and Y of `exact_modes`; each entry is rounded once."""
    with flint.ctx.workprec(BITS[-1]):
        product = X.transpose() * _rational(matrix)
        product = product if Y is None else product * Y
    entries = [float(entry) for entry in product.entries()]
    return np.array(entries).reshape(product.nrows(), product.ncols())


def _rational(matrix: NDArray[np.object_]) -> Any:
    """A matrix (n, m) of fractions as one of FLINT."""
    entries = [flint.fmpq(entry.numerator, entry.denominator) for entry in matrix.ravel()]
    return flint.fmpq_mat(len(matrix), matrix.shape[1], entries)


# loads and spin ------------------------------------------------------------------------------

Blocks = Sequence[tuple[str, Deformation, slice]]
DIRECTION = {"axial": 0, "bending_y": 1, "bending_z": 2}

_OUTSIDE = (Fraction(1), Fraction(-1))  # 1 - s: the mass outside of s
_OUTSIDE_BY_ARM = (Fraction(1, 2), Fraction(0), Fraction(-1, 2))  # (1 - s^2)/2: its first moment


def unknown_loads(deformations: Sequence[str]) -> tuple[int, ...]:
    """Loads of force and torque (0 to 5) whose effect on the stiffness is not that of an axial force.

    A load that bends the beam in one plane couples its torsion with its bending in the other one, and a
    torque along it couples the two bendings. In one plane alone nothing is left out.
    """
    has = set(deformations)
    rows: set[int] = set()
    if {"torsion", "bending_y"} <= has:
        rows |= {2, 4}
    if {"torsion", "bending_z"} <= has:
        rows |= {1, 5}
    if {"bending_y", "bending_z"} <= has:
        rows |= {3}
    return tuple(sorted(rows))


def pulled(blocks: Blocks, node: int, force: ca.SX, values: Values, radius: Any, q: ca.SX) -> ca.SX:
    """K_G q (n,) by a pull `force` (N) at a node; `radius` is (I_y + I_z)/A, for torsion."""
    return _stiffened(blocks, force / values["length"], ONE, node, radius, q)


def stiffened_by_motion(blocks: Blocks, motion: ca.SX, values: Values, radius: Any, q: ca.SX) -> ca.SX:
    """K_G q (n,) by the weight of the beam itself, for a motion (3, 3) of its origin."""
    rho, A, L = (values[key] for key in ("density", "area", "length"))
    weight = -(rho * A) * motion[0, 2]
    total = _stiffened(blocks, weight, _OUTSIDE, None, radius, q)
    spin = motion[1, 0] * motion[1, 0] + motion[2, 0] * motion[2, 0]
    return total + _stiffened(blocks, (rho * A * L) * spin, _OUTSIDE_BY_ARM, None, radius, q)


def _stiffened(
    blocks: Blocks, factor: ca.SX, weight: Polynomial, last: int | None, radius: Any, q: ca.SX
) -> ca.SX:
    """The factor times int weight dN'dN ds q (n,), of all deformations that turn the axis or sections."""
    total = ca.SX(q.numel(), 1)
    for name, d, columns in blocks:
        if name == "axial":
            continue
        scale = factor * radius if name == "torsion" else factor
        matrix = products(d, "slope", weight, 0, last)
        total[columns] = times([Term(scale, matrix)], q[columns])
    return total


def spinning(blocks: Blocks, motion: ca.SX, values: Values, at: Coordinate) -> tuple[ca.SX, ca.SX]:
    """Wrench (3, 2) about the origin, and generalized forces (n,), that only a spinning frame needs.

    Without those of the undeformed body in the wrench. Axial deformation and bending only.
    """
    line, L = values["density"] * values["area"] * values["length"], values["length"]
    omega = motion[:, 0]
    across, twice = ca.skew(omega), 2 * ca.skew(omega)
    inward = ca.mtimes(across, across)
    mean = {name: _mean(blocks, ONE, vector) for name, vector in (("q", at.q), ("v", at.v))}
    first = {name: _mean(blocks, LINEAR, vector) for name, vector in (("q", at.q), ("v", at.v))}
    force = ca.mtimes(inward, mean["q"]) + ca.mtimes(twice, mean["v"])
    along = ca.vertcat(1, 0, 0)
    torque = ca.cross(along, ca.mtimes(inward, first["q"]) + ca.mtimes(twice, first["v"]))
    torque = L * (torque + ca.cross(first["q"], inward[:, 0]))
    efforts = ca.SX(at.q.numel(), 1)
    for name, d, rows in blocks:
        i = DIRECTION[name]
        needed = ca.DM(moments(d, "displacement", LINEAR)) * (L * inward[i, 0])
        for other, e, columns in blocks:
            j = DIRECTION[other]
            shared = ca.sparsify(ca.SX(cross_products(d, "displacement", e, "displacement")))
            moved = inward[i, j] * at.q[columns] + twice[i, j] * at.v[columns]
            needed = needed + ca.mtimes(shared, moved)
        efforts[rows] = line * needed
    return line * ca.horzcat(force, torque), efforts


def second_moments(blocks: Blocks, values: Values, at: Coordinate) -> tuple[ca.SX, ca.SX]:
    """What a deformation u adds to the second moments int r r' (3, 3), and int u x udot (3,).

    Axial deformation and bending of a mass on the axis, at r = L s + u.
    """
    line, L = values["density"] * values["area"] * values["length"], values["length"]
    first = ca.horzcat(L * _mean(blocks, LINEAR, at.q), ca.SX(3, 2)).T
    moments, moving = first + first.T, ca.SX(3, 3)
    for name, d, rows in blocks:
        for other, e, columns in blocks:
            i, j = DIRECTION[name], DIRECTION[other]
            shared = ca.sparsify(ca.SX(cross_products(d, "displacement", e, "displacement")))
            left = ca.mtimes(at.q[rows].T, shared)
            moments[i, j] += ca.mtimes(left, at.q[columns])
            moving[i, j] += ca.mtimes(left, at.v[columns])
    skew = moving - moving.T
    return line * moments, line * ca.vertcat(skew[1, 2], skew[2, 0], skew[0, 1])


def _mean(blocks: Blocks, weight: Polynomial, q: ca.SX) -> ca.SX:
    """Integral (3,) of weight(s) times the displacement."""
    total = ca.SX(3, 1)
    for name, d, columns in blocks:
        row = ca.DM(moments(d, "displacement", weight)).T
        total[DIRECTION[name]] = ca.mtimes(ca.SX(row), q[columns])
    return total
