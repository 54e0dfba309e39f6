"""A proof of stability on a box of deltas, without frequencies: Lyapunov functions that depend on deltas.

Let d = det(I - D Delta), and N = d A, both polynomials in the deltas. On a part of the box on which d > 0
and a polynomial P(delta) = P' has

    S(delta) = -(N'P + P N) > 0,

no model has a pole on the axis, as v'S v = -2 d Re(s) v'P v for a pole s with the vector v. Parts cover
the box, which is connected, and its middle is stable: so is all of it. P need not be positive.

P interpolates solutions of A'P + P A = -Q at Chebyshev nodes of the part. With the modes of its middle as
coordinates, each scaled, P is nearly the energy of the modes there, and Q = I what they dissipate; Q is
the same on the part. So S is d Q but for the error of the interpolation: where frequencies cancel in
P N and its transpose, they cancel in the coefficients. Parts are small only where modes turn into each
other within a range of deltas that is as small as their damping. (Polynomials P for boxes: Chesi,
Garulli, Tesi, Vicino, IEEE TAC 50, 2005.)

S > 0 if all of its Bernstein coefficients are. The products are in doubles, with bounds of their
rounding, and Cholesky's factor of what is left without these proves that it is positive (Rump, BIT 46,
2006). A part on which this fails is cut along the delta in which P has the largest term of the highest
degree. The proof is the list of cuts, and the coordinates of each part, from which P is computed again.
"""

from collections.abc import Sequence
from functools import cache
from itertools import product
from math import comb, prod
from typing import Any, NamedTuple
from warnings import catch_warnings

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_continuous_lyapunov

from mbdlft.base.array import Array
from mbdlft.base.running import tell
from mbdlft.exact.rounding import EPS, eigenvectors_of
from mbdlft.response.modes import balancing
from mbdlft.robust.bisect.boxes import Check, Ends, split
from mbdlft.robust.bisect.characteristic import Realization, state_polynomials
from mbdlft.robust.evidence import LyapunovProof

_UP = 1.0 + 1e-9  # times sums of bounds: more than their rounding
_DEGREE = 4  # of P in each delta; less where there are many
_DEAREST = 1.0  # units of work of a part
_PRODUCT, _SOLUTION, _NODE, _PART = 1.2e-10, 3.0e-8, 1.5e-4, 2e-3  # units of work
_SLACK = 1e-4  # of S, which a proof has more than rounding needs: P is computed again elsewhere
_SMALLEST = 2.0**-20  # of the box: a part of this size is not cut again
_HOPELESS = 0.02  # of the box that has to be proved with half of the work


class _Part(NamedTuple):
    """N and d as Bernstein coefficients (r_1 + 1, ..., n^2 + 1) on deltas c - h to c + h, of a unit box.

    Their errors are at most `steps` EPS of `sizes`, which has their shape.
    """

    values: Array
    sizes: Array
    steps: int
    center: Array
    half: Array


class Attempt(NamedTuple):
    """What came of a search."""

    proof: LyapunovProof | None
    counterexample: Array | None  # deltas of the unit box that are wrong
    center: Array  # of the last part, in the unit box: one that resisted, if there is neither
    work: float  # units that were used


def degree_of(model: Realization) -> int:
    """The degree of P in each delta; 0 if there are too many deltas or states for the work of a part."""
    return next((e for e in range(_DEGREE, 0, -1) if _cost(model, e) <= _DEAREST), 0)


def _cost(model: Realization, degree: int) -> float:
    """Units of work of a part of the box."""
    nodes, n = (degree + 1.0) ** len(model.sizes), len(model.A)
    products = _PRODUCT * prod(size + 1 for size in model.sizes)
    return _PART + nodes * (_NODE + (_SOLUTION + products) * n**3)


def searched(model: Realization, ends: Ends, degree: int, work: float, is_wrong: Check) -> Attempt:
    """Look for a proof that all models of the box |delta| <= ends are stable."""
    waiting, log, states = [_whole(model, ends)], list[int](), list[Array]()
    used, proved, cost = 0.0, 0.0, _cost(model, degree)
    part = waiting[0]
    while waiting:
        if used + cost > work or (used > 0.5 * work and proved < _HOPELESS):
            return Attempt(None, None, part.center, used)
        used += cost
        tell(used)
        part = waiting.pop()
        if is_wrong(part.center):
            return Attempt(None, part.center, part.center, used)
        modes = _modes(part, len(model.A))
        P = None if modes is None else _interpolated(part, modes, degree)
        if modes is not None and P is not None and _is_positive(part, modes, P, _SLACK):
            log.append(0)
            states.append(modes)
            proved += float(np.prod(part.half))
            continue
        axis = _axis(part, modes, P)
        if not part.half[axis] > _SMALLEST:
            return Attempt(None, None, part.center, used)
        log.append(1 + axis)
        waiting += reversed(_halves(part, axis))
    proof = LyapunovProof(tuple(log), degree, np.array(states))
    return Attempt(proof, None, part.center, used)


def replayed(model: Realization, ends: Ends, proof: LyapunovProof) -> bool:
    """Whether a list of cuts, and coordinates of the parts, prove what `searched` says."""
    n, states = len(model.A), list(proof.states)
    if not 1 <= proof.degree <= _DEGREE or proof.states.shape != (proof.log.count(0), n, n):
        return False
    waiting = [_whole(model, ends)]
    for step in proof.log:
        if not waiting or not 0 <= step <= len(model.sizes):
            return False
        part = waiting.pop()
        if step:
            waiting += reversed(_halves(part, step - 1))
            continue
        modes = states.pop(0)
        P = _interpolated(part, modes, proof.degree) if np.all(np.isfinite(modes)) else None
        if P is None or not _is_positive(part, modes, P):
            return False
    return not waiting


def _whole(model: Realization, ends: Ends) -> _Part:
    values, sizes = state_polynomials(model, ends)
    q = len(model.sizes)
    return _Part(values, sizes, 2, np.zeros(q), np.ones(q))


def _halves(part: _Part, axis: int) -> list[_Part]:
    """Both halves along a delta, the lower first (de Casteljau)."""
    half = part.half.copy()
    half[axis] *= 0.5
    steps = part.steps + part.values.shape[axis]
    parts = []
    halves = zip(split(part.values, axis), split(part.sizes, axis), strict=True)
    for side, pair in zip((-1.0, 1.0), halves, strict=True):
        center = part.center.copy()
        center[axis] += side * half[axis]
        parts.append(_Part(*pair, steps, center, half))
    return parts


def _modes(part: _Part, n: int) -> Array | None:
    """Columns (n, n) of the modes in the middle, in which -(A + A') is I; None if they are dependent."""
    N, d = _at_nodes(part, n, [np.array([0.5])] * len(part.center))
    if not d.item() > 0.0:
        return None
    A = N.reshape(n, n) / d.item()
    scale = balancing(A)
    values, vectors = eigenvectors_of(A * scale / scale[:, None])[::2]
    columns: list[Array] = []
    for k in np.flatnonzero(values.imag >= 0.0):
        shapes = (vectors[:, k].real, vectors[:, k].imag)[: 1 + int(values[k].imag > 0.0)]
        columns += [scale * shape / np.sqrt(2.0 * abs(values[k].real)) for shape in shapes]
    modes = np.array(columns).T
    return modes if modes.shape == A.shape and np.all(np.isfinite(modes)) else None


def _at_nodes(part: _Part, n: int, nodes: Sequence[Array]) -> tuple[Array, Array]:
    """N (..., n, n) and d (...) at nodes of each delta, which go from 0 to 1 on the part."""
    values = part.values
    for axis, t in enumerate(nodes):
        basis = _basis(values.shape[axis] - 1, tuple(t.tolist()))
        values = np.moveaxis(np.tensordot(basis, values, (1, axis)), 0, axis)
    return values[..., :-1].reshape(*values.shape[:-1], n, n), values[..., -1]


@cache
def _basis(degree: int, nodes: tuple[float, ...]) -> Array:
    """Bernstein polynomials of a degree at nodes (number of nodes, degree + 1)."""
    return np.array(
        [[comb(degree, i) * t**i * (1.0 - t) ** (degree - i) for i in range(degree + 1)] for t in nodes]
    )


def _interpolated(part: _Part, modes: Array, degree: int) -> Array | None:
    """Bernstein coefficients (degree + 1, ..., n, n) of P in these coordinates; None if there is no P."""
    n, q = len(modes), len(part.center)
    nodes = 0.5 - 0.5 * np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
    N, d = _at_nodes(part, n, [nodes] * q)
    if not np.all(d > 0.0):
        return None
    try:
        matrices = np.linalg.solve(modes, N / d[..., None, None] @ modes)
        P = np.array([_solution(A) for A in matrices.reshape(-1, n, n)]).reshape(matrices.shape)
    except np.linalg.LinAlgError:
        return None
    inverse = np.linalg.inv(_basis(degree, tuple(nodes.tolist())))
    for axis in range(q):
        P = np.moveaxis(np.tensordot(inverse, P, (1, axis)), 0, axis)
    P = 0.5 * (P + P.mT)
    return np.asarray(P) if np.all(np.isfinite(P)) else None


def _solution(A: NDArray[Any]) -> Array:
    """The solution P of A'P + P A = -I; of a matrix near to A, with a warning, where there is none."""
    with catch_warnings(action="ignore"):
        return np.asarray(solve_continuous_lyapunov(A.T, -np.eye(len(A))))


def _is_positive(part: _Part, modes: Array, P: Array, slack: float = 0.0) -> bool:
    """Whether d > 0 and S > 0 on a part are proved, and by how much of the mean of S.

    With W near to the inverse of T, the modes, P stands for W'P W, and T'S T is the sum of -E'P (W N T)
    and its transpose, E = W T. Each product of k terms is off by at most k EPS of that of sizes.
    """
    n, q = len(modes), len(part.center)
    shape, rounding = part.values.shape[:q], part.steps * EPS
    if not np.all(part.values[..., -1] > 2.0 * rounding * part.sizes[..., -1]):
        return False
    W = np.linalg.inv(modes)
    N = W @ part.values[..., :-1].reshape(*shape, n, n) @ modes
    largest = np.outer(np.sum(np.abs(W), axis=0), np.sum(np.abs(modes), axis=1))
    errors = part.sizes[..., :-1] @ largest.ravel()
    near = W @ modes - np.eye(n)
    identity = float(np.linalg.norm(np.abs(near) + 2.0 * n * EPS * (np.abs(W) @ np.abs(modes))))
    terms = prod(P.shape[:q])
    share = 2.0 * (identity + rounding + (6.0 * n + 2.0 * terms + 40.0) * EPS)
    half = _product(P, N)
    S = -(half + half.mT)
    sizes = _product(np.linalg.norm(P, axis=(-2, -1))[..., None, None], errors[..., None, None])
    trace = np.trace(S, axis1=-2, axis2=-1)
    less = share * sizes[..., 0, 0] + (slack / n + 4.0 * (n + 2.0) * EPS) * np.abs(trace)
    S = S - (less * _UP)[..., None, None] * np.eye(n)
    if not np.all(np.isfinite(S)):
        return False
    try:
        np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        return False
    return True


def _product(P: Array, N: Array) -> Array:
    """Bernstein coefficients of the product of polynomials of matrices (..., k, k)."""
    q, k = P.ndim - 2, P.shape[-1]
    shapes = P.shape[:q], N.shape[:q]
    both = tuple(a + b - 1 for a, b in zip(*shapes, strict=True))
    weighted = np.moveaxis(N * _binomials(shapes[1])[..., None, None], -2, 0)
    columns, total = weighted.reshape(k, -1), np.zeros((k, *both, k))
    for at in product(*map(range, shapes[0])):
        place = slice(None), *(slice(i, i + size) for i, size in zip(at, shapes[1], strict=True))
        total[place] += (prod(map(comb, (s - 1 for s in shapes[0]), at)) * P[at] @ columns).reshape(
            weighted.shape
        )
    return np.asarray(np.moveaxis(total, 0, -2) / _binomials(both)[..., None, None])


@cache
def _binomials(shape: tuple[int, ...]) -> Array:
    """Products of binomial coefficients, which turn Bernstein coefficients into those of powers."""
    weights = np.ones(shape)
    for axis, size in enumerate(shape):
        row = np.array([float(comb(size - 1, i)) for i in range(size)])
        weights *= row.reshape([-1 if k == axis else 1 for k in range(len(shape))])
    return weights


def _axis(part: _Part, modes: Array | None, P: Array | None) -> int:
    """The delta to cut: that of the largest term of the highest degree in P; without P, in d and N."""
    q = len(part.center)
    if P is None or modes is None:
        largest = np.max(part.sizes, axis=tuple(range(q)))
        rows = part.values / np.where(largest > 0.0, largest, 1.0)
        return int(np.argmax([np.max(np.abs(np.diff(rows, axis=k)), initial=0.0) for k in range(q)]))
    N, d = _at_nodes(part, len(modes), [np.array([0.5])] * q)
    A = np.linalg.solve(modes, N.reshape(modes.shape) / d.item() @ modes)
    speed = np.add.outer(*[np.linalg.norm(A, axis=1)] * 2)
    last = [np.diff(P, n=P.shape[k] - 1, axis=k) * speed for k in range(q)]
    return int(np.argmax([np.max(np.abs(term)) for term in last]))
