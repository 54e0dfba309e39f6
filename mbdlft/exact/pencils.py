"""Pencils s I - A with inputs and outputs, in exact numbers: null spaces, values s at which ranks fall.

The pencil of M = [A B; C D] is [s I - A, -B; C, D]. It has less rank than at other s at the invariant
zeros of D + C (s I - A)^-1 B. Emami-Naeini and Van Dooren (Automatica 18, 1982) leave them as eigenvalues
of a matrix: states that outputs see at once leave, then those that inputs move at once.
"""

from typing import Any

import flint
import numpy as np
from scipy.linalg import qr

from mbdlft.exact import matrices, modular
from mbdlft.exact.matrices import ExactMatrix
from mbdlft.exact.modular import Residues
from mbdlft.exact.numbers import NOTHING, TooFewBitsError
from mbdlft.exact.rounding import equilibrate

_PART = 0.75  # of the bits of coefficients, for a root


def pencil(M: ExactMatrix, n: int, residue: int, value: Any) -> ExactMatrix:
    """The pencil of n states at s, which is given as a residue and as a ball."""
    s = matrices.zeros(n, M.shape[1], M.prime)
    s.residues[range(n), range(n)] = residue
    if residue and s.known_balls is not None:
        s.known_balls[range(n), range(n)] = value
    return matrices.stacked([[s + -M[:n]], [M[n:]]])


def residues_of_pencil(M: Residues, n: int, s: int, prime: int) -> Residues:
    """The same in residues alone."""
    at = -M[:n]
    at[range(n), range(n)] += s
    return np.vstack([at % prime, M[n:]])


def invariant_zeros(M: ExactMatrix, n: int) -> ExactMatrix:
    """The matrix (k, k) whose eigenvalues are the invariant zeros of n states."""
    for _ in range(2):
        M, n = _with_full_rows(M, n)
        M = M.T
    return M[:n, :n] + -(M[:n, n:] @ M[n:, n:].solve(M[n:, :n]))


def motions_without_outputs(
    M: ExactMatrix, n: int, others: int
) -> tuple[ExactMatrix, ExactMatrix] | None:
    """The matrix of s on what n states and inputs can be while no output moves, and other outputs then.

    The others are the last rows of M. None if some states and inputs can be so at any s.
    """
    M, n = _with_full_rows(M, n, others)
    outputs = M.shape[0] - others
    if outputs != M.shape[1]:
        return None
    inputs = -M[n:outputs, n:].solve(M[n:outputs, :n])
    moved = M[:, :n] + M[:, n:] @ inputs
    return moved[:n], moved[outputs:]


def _with_full_rows(M: ExactMatrix, n: int, others: int = 0) -> tuple[ExactMatrix, int]:
    """The system of fewer states with the same finite zeros, and with rows of D that are independent.

    It has so many other outputs at the end, which take no part.
    """
    end = M.shape[0] - others
    M, beside = M[:end], M[end:]
    while True:
        C, D = M[n:, :n], M[n:, n:]
        first, dependent = independent(D.T)
        columns, _ = independent(D[first])
        factors = D[first][:, columns].T.solve(D[dependent][:, columns].T).T
        seen = C[dependent] + -(factors @ C[first])
        M = M[[*range(n), *(n + k for k in first)]]
        if not seen.residues.any():
            return matrices.stacked([[M], [beside]]), n
        S, free = null_space(seen)
        fixed = sorted(set(range(n)) - set(free))
        moved, beside = (matrices.stacked([[a[:, :n] @ S, a[:, n:]]]) for a in (M, beside))
        beyond = moved[fixed] + -(S[fixed] @ moved[free])  # the states that are zero, moved
        M, n = matrices.stacked([[moved[free]], [moved[n:]], [beyond]]), len(free)


def null_space(a: ExactMatrix) -> tuple[ExactMatrix, list[int]]:
    """Columns that span it, and the rows in which they are the identity."""
    pivots, free = independent(a)
    rows, _ = independent(a[:, pivots].T)
    basis = matrices.zeros(a.shape[1], len(free), a.prime)
    basis[pivots] = -a[rows][:, pivots].solve(a[rows][:, free])
    basis[free] = matrices.identity(len(free), a.prime)
    return basis, free


def independent(a: ExactMatrix) -> tuple[list[int], list[int]]:
    """Columns that are independent, as far from dependent as doubles tell, and the others."""
    if 0 in a.shape:
        return [], [*range(a.shape[1])]
    if not matrices.carries_values():
        chosen = modular.pivot_columns(a.residues, a.prime)
        return chosen, sorted(set(range(a.shape[1])) - set(chosen))
    rough = matrices.rough_values(a)
    rows, columns = equilibrate(rough[None])
    order = qr(rows[:, None] * rough * columns, mode="r", pivoting=True)[1]
    chosen = order[modular.pivot_columns(a.residues[:, order], a.prime)].tolist()
    return sorted(chosen), sorted(set(order.tolist()) - set(chosen))


def eigenvalues(a: ExactMatrix) -> tuple[list[int], list[Any], list[Any]]:
    """Eigenvalues as residues, and as balls: the `roots` of the minimal polynomial."""
    return roots(with_single_roots(minimal_polynomial(a)))


def roots(p: ExactMatrix) -> tuple[list[int], list[Any], list[Any]]:
    """Roots of a polynomial, all single, as residues, and as balls: real ones, and those above the axis.

    Which are the same is not known. Those that are not residues are left out. A TooFewBitsError where
    balls do not tell roots apart.
    """
    zeros = int(np.flatnonzero(p.residues[:, 0])[0])
    residues = p.residues[zeros:, 0].tolist()
    of_residues = [int(root) for root, _ in flint.nmod_poly(residues, p.prime).roots()]
    of_residues += [0] * zeros
    if not matrices.carries_values():
        return of_residues, [], []
    balls = p.balls[zeros:, 0].tolist()
    bits = min([flint.ctx.prec, *(x.rel_accuracy_bits() for x in balls)])
    try:
        tol = flint.arb(2) ** -int(_PART * bits)  # as a double it would be 0.0
        values = flint.acb_poly(balls).roots(tol=tol) if len(balls) > 1 else []
    except ValueError:
        raise TooFewBitsError("the roots of a polynomial are not told apart.") from None
    real = [x.real for x in values if x.imag.contains(0)]
    return of_residues, [NOTHING] * zeros + real, [x for x in values if x.imag > 0]


def factors(a: Residues, prime: int) -> list[tuple[tuple[int, ...], int]]:
    """Those of the characteristic polynomial, and how often: low degrees first, without highest ones."""
    every = flint.nmod_mat(len(a), len(a), a.ravel().tolist(), prime).charpoly().factor()[1]
    some = ((tuple(map(int, factor.coeffs()))[:-1], times) for factor, times in every)
    return sorted(some, key=lambda pair: (len(pair[0]), pair[0]))


def minimal_polynomial(a: ExactMatrix) -> ExactMatrix:
    """Its coefficients (degree + 1, 1), the highest last, by the powers of a matrix on a column."""
    if not len(a.residues):
        return matrices.identity(1, a.prime)
    start = np.random.default_rng(0).integers(1, 1000, (len(a.residues), 1)).astype(float)
    powers = [matrices.of_integers(start, a.prime)]
    while True:
        span = matrices.stacked([powers])
        if len(independent(span)[0]) < len(powers):
            break
        powers.append(a @ powers[-1])
    before, last = span[:, : len(powers) - 1], powers[-1]
    rows, _ = independent(before.T)
    return matrices.stacked([[-before[rows].solve(last[rows])], [matrices.identity(1, a.prime)]])


def with_single_roots(p: ExactMatrix) -> ExactMatrix:
    """A polynomial with the same roots, each once: p / gcd(p, p'), which is u of p' u = p v."""
    d, prime = len(p.residues) - 1, p.prime
    slope = matrices.of_integers(np.diag(np.arange(1.0, d + 1.0)), prime) @ p[1:]
    first, second = (flint.nmod_poly(x.residues[:, 0].tolist(), prime) for x in (p, slope))
    m = d - first.gcd(second).degree()
    if m == d:
        return p
    shifted = [(slope, k) for k in range(m + 1)] + [(-p, k) for k in range(m)]
    whole = matrices.zeros(d + m, len(shifted), prime)
    for column, (x, k) in enumerate(shifted):
        whole[k : k + len(x.residues), column] = x[:, 0]
    return null_space(whole)[0][: m + 1]
