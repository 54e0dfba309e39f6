"""Multipliers D and G for one complex matrix: upper bounds of the structured singular value.

det(I - M Delta) = 0 needs w = Delta M w for some w. With z = M w, each block gives z'D z - w'D w >= 0 for
D = D' > 0 that commutes with it, and a real repeated block z'G w = w'G z for G = G'. So mu(M) <= beta if

    F = M'D M + j (G M - M'G) - beta^2 D < 0.

Fan, Tits, Doyle, IEEE TAC 36 (1991). With X = D - jG/beta, one full complex matrix for a real repeated
block, this is

    S(X) = -F = -1/2 [ (M - beta)'X (M + beta) + (M + beta)'X'(M - beta) ] > 0,    X + X' > 0.

X is Hermitian for a complex repeated block and a multiple of I for a full one, which is made square by
rows or columns of zeros in M. For fixed (D, G) the best beta^2 is an eigenvalue; X moves to the
analytic center for a beta a little above it, and so on (method of centers: Boyd, El Ghaoui, Linear
Algebra and its Applications 188 (1993); Newton's method: Boyd, Vandenberghe, Convex Optimization, 9.5).
"""

from collections.abc import Sequence
from itertools import combinations_with_replacement, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import LinAlgError, eigh

from mbdlft.base.array import Array
from mbdlft.lft.block import Block
from mbdlft.lft.box_gain import newton_step
from mbdlft.robust.evidence import Multipliers

Complex = NDArray[np.complex128]

_NEWTON, _CENTERS = 5, 80  # steps to a center, which need not get there; centers: more than are needed
_CENTERED = 0.05  # Newton decrement squared at which a center is near enough
_STEP = 0.1  # of the way from the best beta^2 of the multipliers back to the one of the center
_ENOUGH = 0.1  # of the fall that the slope promises
_STUCK = 2.0  # times what is enough: above it, a start led nowhere, and another search begins without it
_BLEND = 1e-4  # of the mean of D, that multipliers get with which a search starts
# weights of |X|^2/2: so that parts that do nothing are bounded; so that all are of moderate size
_SMALL, _MODERATE = 1e-8, 1e-3
_NOTHING = 1e-8  # of M: below that mu is nothing, and the forms are singular to doubles
_PAIR = 600  # products of entries that take as long as a pair of blocks
_JUST_ABOVE = 1.001  # times a bound: where F is not singular yet
_SHRINK = 40  # halvings of a step, to 1e-12


class Structure(NamedTuple):
    """The unknown entries of X for blocks, which zeros in M have made square."""

    size: int  # of M
    sizes: tuple[int, ...]  # of the blocks
    rows: NDArray[np.int64]  # (n_entries,): places of the entries of X inside blocks
    columns: NDArray[np.int64]
    # (2 n_entries, m): real and imaginary parts of these entries, of each unknown; None: they are the
    # unknowns
    basis: Any
    inputs: NDArray[np.int64]  # where the rows of M go
    outputs: NDArray[np.int64]  # where its columns go
    real: NDArray[np.bool_]  # (size,): whether a channel belongs to a real block


def structure_of(blocks: Sequence[Block]) -> Structure:
    """The unknowns for the blocks of Delta, in their order."""
    inputs: list[int] = []
    outputs: list[int] = []
    rows: list[NDArray[np.int64]] = []
    columns: list[NDArray[np.int64]] = []
    real: list[bool] = []
    kinds: list[tuple[str, int, int]] = []  # kind, first entry, size
    start = 0
    for block in blocks:
        size = max(block.inputs, block.outputs)
        inputs += range(start, start + block.inputs)
        outputs += range(start, start + block.outputs)
        i, j = np.divmod(np.arange(size * size), max(size, 1))
        kinds.append((block.kind, sum(map(len, rows)), size))
        rows.append(start + i)
        columns.append(start + j)
        real += [block.kind == "real"] * size
        start += size
    none = np.zeros(0, dtype=np.int64)
    count = sum(map(len, rows))
    basis = None if all(kind == "real" for kind, _, _ in kinds) else _basis(kinds, count)
    return Structure(
        start,
        tuple(size for _, _, size in kinds),
        np.concatenate([*rows, none]),
        np.concatenate([*columns, none]),
        basis,
        np.array(inputs, dtype=np.int64),
        np.array(outputs, dtype=np.int64),
        np.array(real, dtype=bool),
    )


def _basis(kinds: Sequence[tuple[str, int, int]], count: int) -> Any:
    """Columns of real and imaginary parts of entries, one for each real unknown."""
    basis = []

    def add(*places: tuple[int, float]) -> None:
        column = np.zeros(2 * count)
        for place, value in places:
            column[place] = value
        basis.append(column)

    for kind, first, size in kinds:
        at = first + np.arange(size * size).reshape(size, size)
        if kind == "full":
            add(*((int(at[i, i]), 1.0) for i in range(size)))
        elif kind == "real":
            for place in at.ravel():
                add((int(place), 1.0))
                add((count + int(place), 1.0))
        else:
            for i in range(size):
                add((int(at[i, i]), 1.0))
                for j in range(i):
                    add((int(at[i, j]), 1.0), (int(at[j, i]), 1.0))
                    add((count + int(at[i, j]), 1.0), (count + int(at[j, i]), -1.0))
    return sparse.csr_array(np.array(basis).reshape(-1, 2 * count).T)


def fits(multipliers: Multipliers, blocks: Sequence[Block]) -> bool:
    """Whether D and G have the structure of the blocks, exactly: then F < 0 says something about mu."""
    D, G, start = multipliers.D, multipliers.G, 0
    size = sum(max(block.inputs, block.outputs) for block in blocks)
    if D.shape != (size, size) or G.shape != D.shape:
        return False
    if not all(np.array_equal(X, X.conj().T) and np.all(np.isfinite(X)) for X in (D, G)):
        return False
    outside = np.array([D, G])
    for block in blocks:
        size = max(block.inputs, block.outputs)
        block_rows = slice(start, start + size)
        inner, turned = D[block_rows, block_rows], G[block_rows, block_rows]
        if block.kind != "real" and np.any(turned):
            return False
        if block.kind == "full" and size and np.any(inner != inner[0, 0] * np.eye(size)):
            return False
        outside[:, block_rows, block_rows] = 0.0
        start += size
    return not np.any(outside)


def squared(M: Complex, structure: Structure) -> Complex:
    """M (n_z, n_w) with rows and columns of zeros that make its full blocks square."""
    square = np.zeros((structure.size, structure.size), dtype=complex)
    square[np.ix_(structure.inputs, structure.outputs)] = M
    return square


def upper_bound(
    M: Complex,
    structure: Structure,
    *,
    starts: Sequence[Multipliers] = (),
    tolerance: float = 1e-4,
    enough: float = 0.0,
) -> Multipliers:
    """Multipliers with nearly the smallest beta for M (n, n), made square, or several (k, n, n) at once.

    The search starts from the best of those of matrices near to these, or their mean, and ends within a
    relative tolerance of beta, or at one that is small enough. Where they lead nowhere, it begins again.
    """
    found = _searched(M, structure, starts, tolerance, enough)
    if not (starts and 0.0 < _STUCK * enough < found.beta):
        return found
    again = _searched(M, structure, (), tolerance, enough)
    return min(found, again, key=lambda each: each.beta)


def _searched(
    M: Complex, structure: Structure, starts: Sequence[Multipliers], tolerance: float, enough: float
) -> Multipliers:
    M = M if M.ndim == 3 else M[None]
    n = structure.size
    size = float(np.max(np.linalg.norm(M, 2, axis=(1, 2)))) if n else 0.0
    one: Complex = np.eye(n, dtype=complex)
    if size == 0.0:
        return Multipliers(0.0, one, 0.0 * one)
    M, enough = M / size, enough / size
    pairs = [(one, 0.0 * one)]
    for start in starts:
        of_mean = float(np.trace(start.D).real) / n
        pairs.append((start.D / of_mean + _BLEND * one, start.G / (size * of_mean)))
    if len(starts) > 1:
        pairs.append(tuple(np.sum(parts, axis=0) for parts in zip(*pairs[1:], strict=True)))
    best, D, G = min(((best_square(M, *pair), *pair) for pair in pairs), key=lambda each: each[0])
    square = best + 0.3 * max(abs(best), min(enough * enough or 1.0, 1e-3))
    smallest = (best, D, G)
    for _ in range(_CENTERS):
        if best <= max(enough, _NOTHING) ** 2:
            break
        beta = float(np.sqrt(square))
        X, is_centered = _center(M, beta, D - 1j * G / beta, structure)
        before, (best, D, G) = best, _ahead(M, beta, X, structure)
        if best < smallest[0]:
            smallest = (best, D, G)
        is_near = square - best <= 4.0 * tolerance * square
        if is_centered and is_near and before - best <= tolerance * best:
            break
        best = max(best, 0.0)
        square = best + _STEP * (square - best)
    if enough > 0.0 and smallest[0] < enough * enough:  # well inside, so that it holds far around
        X, _ = _center(M, enough, smallest[1] - 1j * smallest[2] / enough, structure, _MODERATE)
        smallest = (enough * enough, *_parts(X, enough))
    best, D, G = smallest
    return Multipliers(float(np.sqrt(max(best, 0.0))) * size, D, G * size)


def _ahead(M: Complex, beta: float, X: Complex, structure: Structure) -> tuple[float, Complex, Complex]:
    """The best beta^2 on the tangent of the path of centers, and D and G there."""
    U, V = M - beta * np.eye(len(X)), M + beta * np.eye(len(X))
    P, R = np.linalg.inv(_form(U, V, X)), np.linalg.inv(X + X.conj().T)
    turn = 0.5 * (X @ V - _adjoint(U) @ X)
    turn = turn + _adjoint(turn)
    PU, VP = P @ _adjoint(U), V @ P
    move, _ = _newton_step(U, V, P, R, structure, np.sum(PU - VP @ turn @ PU - VP, axis=0))
    D, G = _parts(X, beta)
    smallest = (best_square(M, D, G), D, G)
    length = beta - float(np.sqrt(max(smallest[0], 0.0)))
    while length < beta:
        D, G = _parts(X - length * move, beta - length)
        try:
            best = best_square(M, D, G)
        except LinAlgError:
            break
        if best >= smallest[0]:
            break
        smallest = (best, D, G)
        length *= 2.0
    return smallest


def _parts(X: Complex, beta: float) -> tuple[Complex, Complex]:
    """D and G of X = D - jG/beta."""
    return 0.5 * (X + X.conj().T), 0.5j * beta * (X - X.conj().T)


def best_square(M: Complex, D: Complex, G: Complex) -> float:
    """The smallest beta^2 that D and G prove of M (n, n), or of several (k, n, n)."""
    GM = 1j * G @ M
    half = 0.5 * _adjoint(M) @ D @ M + GM
    squares = (half + _adjoint(half)).reshape(-1, *D.shape)
    return max(float(eigh(A, D, eigvals_only=True, check_finite=False)[-1]) for A in squares)


def energies_of(M: Complex, D: Complex, G: Complex) -> Array:
    """Parts (n,) of channels in the beta of M (n, n) with multipliers: what smaller deltas take off it.

    To first order, log beta^2 falls by the part of a channel in their sum, times the logarithm by which
    |z|^2 falls there: z'D z of the w that make F nearly singular, with weights that are a dual solution.
    """
    beta = float(np.sqrt(max(best_square(M, D, G), _NOTHING**2))) * _JUST_ABOVE
    eye = np.eye(len(M))
    P = np.linalg.inv(_form(M - beta * eye, M + beta * eye, D - 1j * G / beta))
    return np.asarray(np.diagonal(D @ M @ P @ _adjoint(M)).real)


def _adjoint(M: Complex) -> Complex:
    return np.asarray(np.conj(np.swapaxes(M, -1, -2)))


def _form(U: Complex, V: Complex, X: Complex) -> Complex:
    """S = -(U'X V + V'X'U)/2 of each matrix (..., n, n)."""
    half = _adjoint(U) @ X @ V
    return -0.5 * (half + _adjoint(half))


def _center(
    M: Complex, beta: float, X: Complex, structure: Structure, small: float = _SMALL
) -> tuple[Complex, bool]:
    """Minimum of tr (X + X')/2 - sum log det S(X) - log det(X + X') from an X where all are positive.

    A little of |X|^2 keeps parts bounded that do nothing. It ends after some steps; also whether it is
    near the minimum.
    """
    U, V = M - beta * np.eye(len(X)), M + beta * np.eye(len(X))

    def objective(X: Complex) -> float:
        try:
            factors = np.linalg.cholesky(np.concatenate([_form(U, V, X), (X + X.conj().T)[None]]))
        except np.linalg.LinAlgError:
            return np.inf
        logs = np.log(np.diagonal(factors, axis1=1, axis2=2).real)
        size = float(np.trace(X).real) + 0.5 * small * float(np.sum(np.abs(X) ** 2))
        return size - 2.0 * float(np.sum(logs))

    value = objective(X)
    for _ in range(_NEWTON if np.isfinite(value) else 0):
        P, R = np.linalg.inv(_form(U, V, X)), np.linalg.inv(X + X.conj().T)
        gradient = np.sum(V @ P @ _adjoint(U), axis=0) - 2.0 * R + np.eye(len(X)) + small * X.conj().T
        move, fall = _newton_step(U, V, P, R, structure, gradient, small)
        length = 1.0 if fall < 0.5 else 1.0 / (1.0 + np.sqrt(fall))
        for _ in range(_SHRINK):
            new = X + length * move
            new_value = objective(new)
            if new_value <= value - _ENOUGH * length * fall:
                break
            length *= 0.5
        else:
            break
        X, value = new, new_value
        if fall < _CENTERED:
            return X, True
    return X, False


def _curvature(c: Complex, uu: Complex, vv: Complex, structure: Structure) -> Array:
    """Second derivatives of -log det of the symmetric parts of U'X V, by real and imaginary parts.

    Of all matrices (k, n, n) together: sums of c_jp c_qi and of v_jq u_pi for entries ij and pq of X.
    """
    i, j = structure.rows, structure.columns
    if len(structure.sizes) ** 2 * _PAIR > len(c) * len(i) ** 2:
        rows = j[:, None]
        cross = c[:, rows, i]
        first = np.sum(cross * np.swapaxes(cross, 1, 2), axis=0)
        second = np.sum(vv[:, rows, j] * np.swapaxes(uu, 1, 2)[:, i[:, None], i], axis=0)
    else:
        first, second = _by_pairs(c, uu, vv, structure.sizes)
    N = len(i)
    H = np.empty((2 * N, 2 * N))
    H[:N, :N] = 0.5 * (first.real + second.real)
    H[N:, N:] = 0.5 * (second.real - first.real)
    H[:N, N:] = 0.5 * (second.imag - first.imag)
    H[N:, :N] = H[:N, N:].T
    return H


def _by_pairs(c: Complex, uu: Complex, vv: Complex, sizes: Sequence[int]) -> tuple[Complex, Complex]:
    """Both sums of `_curvature`, as products of what pairs of blocks have of the matrices."""
    starts, entries = (np.cumsum([0, *(size**power for size in sizes)]) for power in (1, 2))
    first, second = (np.empty((entries[-1], entries[-1]), dtype=complex) for _ in range(2))
    parts = zip(sizes, _slices(starts), _slices(entries), strict=True)
    for (s, B, rows), (t, D, columns) in combinations_with_replacement(parts, 2):
        jp_qi, pi_jq = (
            a.reshape(len(c), -1).T @ b.reshape(len(c), -1)
            for a, b in ((c[:, B, D], c[:, D, B]), (uu[:, D, B], vv[:, B, D]))
        )
        first[rows, columns] = jp_qi.reshape(s, t, t, s).transpose(3, 0, 1, 2).reshape(s * s, t * t)
        second[rows, columns] = pi_jq.reshape(t, s, s, t).transpose(1, 2, 0, 3).reshape(s * s, t * t)
        first[columns, rows] = first[rows, columns].T
        second[columns, rows] = second[rows, columns].conj().T
    return first, second


def _slices(ends: NDArray[np.int64]) -> list[slice]:
    return [slice(a, b) for a, b in pairwise(ends.tolist())]


def _newton_step(
    U: Complex, V: Complex, P: Any, R: Any, structure: Structure, gradient: Complex, small: float = _SMALL
) -> tuple[Complex, float]:
    """The step of X to a center, and how much the objective falls along it.

    P and R are inverses of S and of X + X'; to first order the objective changes by Re tr(gradient dX).
    """
    i, j = structure.rows, structure.columns
    UP, VP = U @ P, V @ P
    c, uu, vv = (
        np.concatenate([each, 2.0 * R[None]])
        for each in (VP @ _adjoint(U), UP @ _adjoint(U), VP @ _adjoint(V))
    )
    H = _curvature(c, uu, vv, structure)
    H[np.diag_indices(len(H))] += small
    entries = gradient.T[i, j]
    g, basis = np.concatenate([entries.real, -entries.imag]), structure.basis
    if basis is not None:
        H, g = (basis.T @ (basis.T @ H).T).T, basis.T @ g
    step = newton_step(H, g)
    of_entries = step if basis is None else basis @ step
    move = np.zeros_like(R)
    move[i, j] = of_entries[: len(i)] + 1j * of_entries[len(i) :]
    return move, float(-g @ step)
