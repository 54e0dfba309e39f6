"""Matrix inequalities of `mbdlft.robust.variation`, solved by Clarabel: what it finds is checked later.

tr P_xx + tr X is fixed, and t is the largest such that the form is below -t: there is always a solution,
and t > 0 tells whether it proves anything. Goulart, Chen, Clarabel: an interior-point solver for conic
programs, arXiv 2405.12762 (2024).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mbdlft.base.array import Array
from mbdlft.robust.variation import Form, groups_of

Index = NDArray[np.int64]
_FLOOR = 1e-3  # times t: X is above this
_EDGE = 1e-6  # of the form, where the least gain is asked for
_CHUNK = 2**22  # entries of dense coefficients at once
_CALL, _OPERATION = 0.05, 2.0e-9  # units of work of a solution


class Unknowns(NamedTuple):
    """P (n + n_s, n + n_s), X (m, m), Y (m, m), up to a common factor, and t."""

    P: Array
    X: Array
    Y: Array
    t: float


class Places(NamedTuple):
    """Rows and columns (2, .) of the unknown entries, above the diagonal or on it."""

    P: Index
    X: Index
    Y: Index

    @property
    def ends(self) -> Index:
        """Where the unknowns of P, X, Y end."""
        return np.cumsum([part.shape[1] for part in self])


def places_of(form: Form) -> Places:
    """The unknown entries."""
    same = form.group[:, None] == form.group
    X, Y = (np.array(np.nonzero(np.triu(same, k))) for k in (0, 1))
    return Places(np.array(np.triu_indices(len(form.V))), X, Y)


def cost_of(form: Form) -> float:
    """Units of work of one solution: the factors of the solver, of all entries and unknowns."""
    N = form.V.shape[1]
    places = places_of(form)
    rows = 0.5 * N * (N + 1) + places.X.shape[1]
    return float(_CALL + _OPERATION * (rows**3 / 3.0 + rows**2 * places.ends[-1]))


def solved(form: Form, sizes: Array, states: int, gain: float = 0.0) -> Unknowns | None:
    """Unknowns with the form far below zero, if t > 0; None if the solver gave up.

    Parameters
    ----------
    form : Form
    sizes : array (m,)
        As `sizes_of`.
    states : int
    gain : float
        The bound of a gain, with which P, X and Y have the size that they must have; 0 for stability.
    """
    import clarabel

    places, N, own = places_of(form), form.V.shape[1], groups_of(form)
    first, count = int(places.ends[0]), int(places.ends[-1]) + 1 + bool(gain)
    parts = [_coefficients(form, sizes, places, gain)]
    parts += [_selected(group, places.X, first, parts[0].shape[1]) for group in own]
    t = [_vectors(np.eye(N)[None])[0]]
    t += [_FLOOR * _vectors(np.eye(len(group))[None])[0] for group in own]
    traces = np.zeros(count)
    on_diagonal = [
        (places.P[0] == places.P[1]) & (places.P[0] < states),
        places.X[0] == places.X[1],
    ]
    traces[: places.ends[1]] = np.concatenate(on_diagonal)
    if gain:
        traces[-2] = 1.0
    whole = sparse.hstack([sparse.vstack(parts), sparse.csc_matrix(np.concatenate(t)[:, None])])
    b = np.zeros(1 + whole.shape[0])
    b[0] = states + len(form.S)
    cost = np.zeros(count)
    cost[-1] = -1.0
    cones = [clarabel.ZeroConeT(1)]
    cones += [clarabel.PSDTriangleConeT(size) for size in (N, *map(len, own))]
    values = _solution(cost, sparse.vstack([sparse.csc_matrix(traces[None]), whole]), b, cones)
    return None if values is None else _unpacked(form, values, places, with_gain=gain > 0.0)


def least_gain(form: Form, sizes: Array, states: int) -> float:
    """Nearly the least gain for which there are unknowns, for a gain near 1; inf if none was found."""
    import clarabel

    places, N, own = places_of(form), form.V.shape[1], groups_of(form)
    first, count = int(places.ends[0]), int(places.ends[-1]) + 1
    supplied = sparse.csc_matrix(_vectors(-(form.u.T @ form.u)[None]).T)
    parts = [sparse.hstack([_coefficients(form, sizes, places, 0.0), supplied])]
    parts += [_selected(group, places.X, first, count) for group in own]
    sides = [_vectors((_EDGE * np.eye(N) + form.y.T @ form.y)[None])[0]]
    sides += [np.zeros(len(group) * (len(group) + 1) // 2) for group in own]
    cost = np.zeros(count)
    on_diagonal = [
        (places.P[0] == places.P[1]) & (places.P[0] < states),
        places.X[0] == places.X[1],
    ]
    cost[: places.ends[1]] = 0.1 * _EDGE * np.concatenate(on_diagonal)
    cost[-1] = 1.0
    cones = [clarabel.PSDTriangleConeT(size) for size in (N, *map(len, own))]
    values = _solution(cost, sparse.vstack(parts), -np.concatenate(sides), cones)
    return float(np.sqrt(values[-1])) if values is not None and values[-1] > 0.0 else float("inf")


def least_level(form: Form, sizes: Array, P: Array) -> tuple[float, Array, Array] | None:
    """Nearly the least g, with X and Y, for which y'y - g V'P V and the part of X and Y is negative.

    None if the solver gave up.
    """
    import clarabel

    places, N, own = places_of(form), form.V.shape[1], groups_of(form)
    first, count = int(places.ends[0]), int(places.ends[-1]) + 1
    level = sparse.csc_matrix(_vectors(-(form.V.T @ P @ form.V)[None]).T)
    parts = [sparse.hstack([_coefficients(form, sizes, places, 0.0)[:, first:], level])]
    parts += [_selected(group, places.X, 0, count - first) for group in own]
    sides = [_vectors((form.y.T @ form.y)[None])[0]]
    sides += [np.zeros(len(group) * (len(group) + 1) // 2) for group in own]
    cost = np.zeros(count - first)
    cost[-1] = 1.0
    cones = [clarabel.PSDTriangleConeT(size) for size in (N, *map(len, own))]
    values = _solution(cost, sparse.vstack(parts), -np.concatenate(sides), cones)
    if values is None or not values[-1] > 0.0:
        return None
    found = _unpacked(
        form, np.concatenate([np.zeros(first), values[:-1], [0.0]]), places, with_gain=False
    )
    return None if found is None else (float(values[-1]), found.X, found.Y)


def _solution(cost: Array, rows: Any, b: Array, cones: list[Any]) -> Array | None:
    """The x of the least cost with b - rows x in the cones; None if the solver gave up."""
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    nothing = sparse.csc_matrix((len(cost), len(cost)))
    solver = clarabel.DefaultSolver(nothing, cost, sparse.csc_matrix(rows), b, cones, settings)
    values = np.array(solver.solve().x)
    return values if np.all(np.isfinite(values)) else None


def _unpacked(form: Form, values: Array, places: Places, *, with_gain: bool) -> Unknowns | None:
    m, size = len(form.S), len(form.V)
    P, X, Y = np.zeros((size, size)), np.zeros((m, m)), np.zeros((m, m))
    p, x, y, rest = np.split(values, places.ends)
    parts = ((P, places.P, p, 1.0), (X, places.X, x, 1.0), (Y, places.Y, y, -1.0))
    for matrix, where, entries, sign in parts:
        matrix[where[1], where[0]] = sign * entries
        matrix[where[0], where[1]] = entries
    weight = float(rest[0]) if with_gain else 1.0
    return Unknowns(P / weight, X / weight, Y / weight, float(rest[-1])) if weight > 0.0 else None


def _coefficients(form: Form, sizes: Array, places: Places, gain: float) -> Any:
    """Derivatives of the form by the unknowns, as columns of its entries."""
    V, W, S = form.V, form.W, form.S
    Z = sizes[:, None] * (form.R + form.K @ W)

    def of_P(i: Index, j: Index) -> Array:
        return (_outer(V[i], W[j]) + _outer(V[j], W[i])) * _half(i, j)

    def of_X(i: Index, j: Index) -> Array:
        return (_outer(Z[i], Z[j]) - _outer(S[i], S[j])) * _half(i, j)

    def of_Y(i: Index, j: Index) -> Array:
        return _outer(Z[i], S[j]) - _outer(Z[j], S[i])

    made = ((of_P, places.P), (of_X, places.X), (of_Y, places.Y))
    parts = [_columns(make, where, V.shape[1]) for make, where in made]
    if gain:
        supplied = form.y.T @ form.y - gain**2 * form.u.T @ form.u
        parts.append(sparse.csc_matrix(_vectors(supplied[None]).T))
    return sparse.hstack(parts)


def _columns(make: Callable[[Index, Index], Array], where: Index, N: int) -> Any:
    """Columns of the symmetric parts of what is made for pairs of rows and columns."""
    step = max(1, _CHUNK // (N * N))
    found = [sparse.csc_matrix((N * (N + 1) // 2, 0))]
    for start in range(0, where.shape[1], step):
        part = make(*where[:, start : start + step])
        found.append(sparse.csc_matrix(_vectors(part + np.swapaxes(part, 1, 2)).T))
    return sparse.hstack(found)


def _outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None, :]


def _half(i: Index, j: Index) -> Array:
    return np.where(i == j, 0.5, 1.0)[:, None, None]


def _vectors(matrices: Array) -> Array:
    """Symmetric matrices (k, N, N) as vectors (k, N (N + 1)/2) with the same inner product."""
    columns, rows = np.tril_indices(matrices.shape[1])
    return matrices[:, rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0))


def _selected(group: Index, X: Index, first: int, count: int) -> Any:
    """Minus the entries of X of one group, of all unknowns."""
    columns, rows = np.tril_indices(len(group))
    inside = np.flatnonzero(np.isin(X[0], group))
    order = np.lexsort((X[0][inside], X[1][inside]))  # by columns, as in `_vectors`
    weights = -np.where(rows == columns, 1.0, np.sqrt(2.0))
    where = (np.arange(len(inside)), first + inside[order])
    return sparse.csc_matrix((weights, where), shape=(len(inside), count))
