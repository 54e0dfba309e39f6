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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, eigh

from mbdlft.base.array import Array
from mbdlft.lft.block import Block
from mbdlft.lft.box_gain import newton_step
from mbdlft.robust.evidence import Multipliers

Complex = NDArray[np.complex128]

_NEWTON, _CENTERS = 25, 80  # steps to a center; centers: far more than are needed
_CENTERED = 0.05  # Newton decrement squared at which a center is near enough
_STEP = 0.1  # of the way from the best beta^2 of the multipliers back to the one of the center
_ENOUGH = 0.1  # of the fall that the slope promises
_BLEND = 1e-2  # of the mean of D, that multipliers get with which a search starts
# weights of |X|^2/2: so that parts that do nothing are bounded; so that all are of moderate size
_SMALL, _MODERATE = 1e-8, 1e-3
_NOTHING = 1e-8  # of M: below that mu is nothing, and the forms are singular to doubles
_SHRINK = 40  # halvings of a step, to 1e-12


class Structure(NamedTuple):
    """The unknown entries of X for blocks, which zeros in M have made square."""

    size: int  # of M
    rows: NDArray[np.int64]  # (n_entries,): places of the entries of X inside blocks
    columns: NDArray[np.int64]
    # (2 n_entries, m): real and imaginary parts of these entries, of each unknown; None: they are the
    # unknowns
    basis: Array | None
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
        np.concatenate([*rows, none]),
        np.concatenate([*columns, none]),
        basis,
        np.array(inputs, dtype=np.int64),
        np.array(outputs, dtype=np.int64),
        np.array(real, dtype=bool),
    )


def _basis(kinds: Sequence[tuple[str, int, int]], count: int) -> Array:
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
    return np.array(basis).T.reshape(2 * count, -1)


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
    start: Multipliers | None = None,
    tolerance: float = 1e-4,
    enough: float = 0.0,
) -> Multipliers:
    """Multipliers with nearly the smallest beta for M (n, n), made square.

    The search starts from those of a matrix near to this one, and ends within a relative tolerance of
    beta, or at one that is small enough.
    """
    n = structure.size
    size = float(np.linalg.norm(M, 2)) if n else 0.0
    X: Complex = np.eye(n, dtype=complex)
    D: Complex = X
    G: Complex = 0.0 * X
    if size == 0.0:
        return Multipliers(0.0, D, G)
    if start is not None:
        D = start.D + _BLEND * float(np.trace(start.D).real) / n * X
        G = start.G / size
    M, enough = M / size, enough / size
    best = best_square(M, D, G)
    if best >= 1.0:
        D, G = X, 0.0 * X
        best = best_square(M, D, G)
    square = best + 0.3 * max(abs(best), 1e-3)
    smallest = (best, D, G)
    for _ in range(_CENTERS):
        if best <= max(enough, _NOTHING) ** 2:
            break
        beta = float(np.sqrt(square))
        X = _center(M, beta, D - 1j * G / beta, structure)
        before, (best, D, G) = best, _ahead(M, beta, X, structure)
        if best < smallest[0]:
            smallest = (best, D, G)
        if before - best <= tolerance * best and square - best <= 4.0 * tolerance * square:
            break
        best = max(best, 0.0)
        square = best + _STEP * (square - best)
    if enough > 0.0 and smallest[0] < enough * enough:  # well inside, so that it holds far around
        X = _center(M, enough, smallest[1] - 1j * smallest[2] / enough, structure, _MODERATE)
        smallest = (enough * enough, *_parts(X, enough))
    best, D, G = smallest
    return Multipliers(float(np.sqrt(max(best, 0.0))) * size, D, G * size)


def _ahead(M: Complex, beta: float, X: Complex, structure: Structure) -> tuple[float, Complex, Complex]:
    """The best beta^2 on the tangent of the path of centers, and D and G there."""
    U, V = M - beta * np.eye(len(M)), M + beta * np.eye(len(M))
    P, R = np.linalg.inv(_form(U, V, X)), np.linalg.inv(X + X.conj().T)
    turn = 0.5 * (X @ V - U.conj().T @ X)
    turn = turn + turn.conj().T
    PU, VP = P @ U.conj().T, V @ P
    move, _ = _newton_step(U, V, P, R, structure, PU - VP @ turn @ PU - VP)
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
    """The smallest beta^2 that D and G prove."""
    GM = 1j * G @ M
    A = M.conj().T @ D @ M + GM + GM.conj().T
    return float(eigh(0.5 * (A + A.conj().T), D, eigvals_only=True, check_finite=False)[-1])


def _form(U: Complex, V: Complex, X: Complex) -> Complex:
    """S = -(U'X V + V'X'U)/2."""
    half = U.conj().T @ X @ V
    return -0.5 * (half + half.conj().T)


def _center(M: Complex, beta: float, X: Complex, structure: Structure, small: float = _SMALL) -> Complex:
    """Minimum of tr (X + X')/2 - log det S(X) - log det(X + X') from an X where both are positive.

    A little of |X|^2 keeps parts bounded that do nothing.
    """
    U, V = M - beta * np.eye(len(M)), M + beta * np.eye(len(M))

    def objective(X: Complex) -> float:
        try:
            a = np.linalg.cholesky(_form(U, V, X))
            b = np.linalg.cholesky(X + X.conj().T)
        except np.linalg.LinAlgError:
            return np.inf
        logs = np.log(np.diagonal(a).real) + np.log(np.diagonal(b).real)
        size = float(np.trace(X).real) + 0.5 * small * float(np.sum(np.abs(X) ** 2))
        return size - 2.0 * float(np.sum(logs))

    value = objective(X)
    for _ in range(_NEWTON if np.isfinite(value) else 0):
        P, R = np.linalg.inv(_form(U, V, X)), np.linalg.inv(X + X.conj().T)
        gradient = V @ P @ U.conj().T - 2.0 * R + np.eye(len(M)) + small * X.conj().T
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
            break
    return X


def _curvature(c: Complex, uu: Complex, vv: Complex, i: NDArray[np.int64], j: NDArray[np.int64]) -> Array:
    """Second derivatives of -log det of the symmetric part of U'X V, by real and imaginary parts."""
    cross = c[np.ix_(j, i)]
    first = cross * cross.T
    second = vv[np.ix_(j, j)] * uu.T[np.ix_(i, i)]
    mixed = 0.5 * (second.imag - first.imag)
    return np.block(
        [[0.5 * (first.real + second.real), mixed], [mixed.T, 0.5 * (second.real - first.real)]]
    )


def _newton_step(
    U: Complex, V: Complex, P: Any, R: Any, structure: Structure, gradient: Complex, small: float = _SMALL
) -> tuple[Complex, float]:
    """The step of X to a center, and how much the objective falls along it.

    P and R are inverses of S and of X + X'; to first order the objective changes by Re tr(gradient dX).
    """
    i, j = structure.rows, structure.columns
    UP, VP = U @ P, V @ P
    H = _curvature(VP @ U.conj().T, UP @ U.conj().T, VP @ V.conj().T, i, j)
    H = H + 4.0 * _curvature(R, R, R, i, j)
    H[np.diag_indices(len(H))] += small
    entries = gradient.T[i, j]
    g, basis = np.concatenate([entries.real, -entries.imag]), structure.basis
    if basis is not None:
        H, g = basis.T @ H @ basis, basis.T @ g
    step = newton_step(H, g)
    of_entries = step if basis is None else basis @ step
    move = np.zeros_like(U)
    move[i, j] = of_entries[: len(i)] + 1j * of_entries[len(i) :]
    return move, float(-g @ step)
