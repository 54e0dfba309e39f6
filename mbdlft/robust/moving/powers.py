"""The same system in products of its states, and with more of what its parameters multiply.

Of xdot = A x + B w, z = C x + D w, w = Delta z, the products x^a = x_1^a_1 ... x_n^a_n of a degree p obey
a linear system again, whose channels are products of degree p - 1 times w:

    d(x^a)/dt = sum_i a_i x^(a - e_i) (A x + B w)_i,      x^b z = C (x x^b) + D (x^b w),   |b| = p - 1,

with the same deltas. It comes to rest if and only if the first one does. So a V that is quadratic in the
products proves as much: it has the degree 2 p in the states, and may have any harmonic of the phase of a
mode up to 2 p, while a quadratic one has a single one of them (Zelentsovsky, IEEE TAC 39, 1994; Chesi,
Garulli, Tesi, Vicino, Automatica 39, 2003). A slow parameter needs this: what its rate does to a mode
has the sign of a cosine of twice the phase, of which a quadratic V takes the amplitude 1, one of degree 4
1/sqrt(2), and any V the mean 2/pi.

V depends on the deltas through Delta z only. Channels delta x, delta^2 x, ... that act on nothing make
all entries of V polynomials in the delta.
"""

from collections.abc import Sequence
from itertools import combinations_with_replacement, pairwise, product
from math import comb
from typing import Any, NamedTuple

import flint
import numpy as np

from mbdlft.base.array import Array
from mbdlft.robust.balls import balls, entries
from mbdlft.robust.bisect.characteristic import Realization
from mbdlft.robust.realization import turned


class Shape(NamedTuple):
    """Of a form: its degree in products of two states, and that of all of its entries in slow deltas."""

    degree: int = 1
    order: int = 0


PLAIN = Shape()
SHAPES = (
    Shape(2, 1),
    Shape(2, 2),
    Shape(4, 2),
    Shape(6, 2),
    Shape(8, 2),
)  # that are tried where a plain one proves too little
_MOST = Shape(8, 3)


def is_shape(shape: Shape, states: int, size: int) -> bool:
    """Whether a form may have a shape, and the number of products of so many states is no larger."""
    is_known = 1 <= shape.degree <= _MOST.degree and 0 <= shape.order <= _MOST.order
    return is_known and comb(states + shape.degree - 1, shape.degree) <= size


def shaped(model: Realization, shape: Shape, rates: Array) -> Realization:
    """The model in products of its states, with channels of slow deltas; entries are those of numpy."""
    moves = np.isfinite(rates) & (rates > 0.0)
    return widened(lifted(model, shape.degree), moves.tolist(), shape.order)


def shaped_in_balls(model: Realization, states: Array, shape: Shape, rates: Array) -> Realization:
    """The same of a model of doubles in the states L x; a ZeroDivisionError if L is singular."""
    matrices = [balls(matrix) for matrix in (model.A, model.B, model.C, states)]
    arrays: list[Any] = [entries(matrix) for matrix in (*matrices, matrices[-1].inv())]
    A, B, C, L, back = arrays
    return shaped(turned(model._replace(A=A, B=B, C=C), L, back), shape, rates)


def lifted(model: Realization, degree: int) -> Realization:
    """The model of the products of a degree of its states, without inputs and outputs."""
    if degree == 1:
        return model
    n, r = model.B.shape
    place, below = ({a: k for k, a in enumerate(_exponents(n, p))} for p in (degree, degree - 1))
    N, count = len(place), len(below)
    A, B, C = (_nothing(model, *shape) for shape in ((N, N), (N, r * count), (r * count, N)))
    for (b, row), i in product(below.items(), range(n)):
        a = _more(b, i)
        for k in range(n):
            A[place[a], place[_more(b, k)]] += a[i] * model.A[i, k]
        B[place[a], row::count] += a[i] * model.B[i]
        C[row::count, place[a]] += model.C[:, i]
    D: Any = np.kron(model.D, np.eye(count))
    sizes = tuple(size * count for size in model.sizes)
    return alone(model._replace(sizes=sizes, A=A, B=B, C=C, D=D))


def widened(model: Realization, moves: Sequence[bool], order: int) -> Realization:
    """The model with channels delta x, ..., delta^order x of deltas that move.

    Channels of these that get nothing but states are sums of them, and are left out.
    """
    n, r = model.B.shape
    if not order or not any(moves):
        return model
    old_spans = [slice(*ends) for ends in pairwise(np.cumsum([0, *model.sizes]).tolist())]
    is_kept = [
        not m or bool(np.any(model.D[old_span])) for m, old_span in zip(moves, old_spans, strict=True)
    ]
    of_old = [size * kept for size, kept in zip(model.sizes, is_kept, strict=True)]
    sizes = [old + order * n * m for old, m in zip(of_old, moves, strict=True)]
    total = sum(sizes)
    w, C = _nothing(model, r, total), _nothing(model, total, n)  # the old w by the new ones
    D = _nothing(model, total, total)
    rows = []
    for start, old, old_span, m in zip(
        np.cumsum([0, *sizes[:-1]]), of_old, old_spans, moves, strict=True
    ):
        first = start + old
        if old:
            w[old_span, start:first] = np.eye(old)
            rows.append((slice(start, first), old_span))
        else:
            w[old_span, first : first + n] = model.C[old_span]
        if m:
            C[first : first + n] = np.eye(n)
            for layer in range(1, order):
                at = first + layer * n
                D[at : at + n, at - n : at] = np.eye(n)
    for new, old_span in rows:
        C[new], D[new] = model.C[old_span], model.D[old_span] @ w
    return alone(model._replace(sizes=tuple(sizes), B=model.B @ w, C=C, D=D))


def _exponents(n: int, degree: int) -> list[tuple[int, ...]]:
    """Exponents of the products of a degree of n states."""
    chosen = combinations_with_replacement(range(n), degree)
    return [tuple(np.bincount(c, minlength=n).tolist()) for c in chosen]


def _more(exponents: tuple[int, ...], i: int) -> tuple[int, ...]:
    return tuple(e + (k == i) for k, e in enumerate(exponents))


def _nothing(model: Realization, *shape: int) -> Any:
    """Zeros of the kind of a model: doubles, or balls."""
    zeros: Any = np.zeros(shape, dtype=model.A.dtype)
    if zeros.dtype == object:
        zeros[...] = flint.arb(0)
    return zeros


def alone(model: Realization) -> Realization:
    """The model without inputs and outputs."""
    n, r = model.B.shape
    none = np.zeros
    return model._replace(E=none((n, 0)), F=none((r, 0)), G=none((0, n)), H=none((0, r)), J=none((0, 0)))
