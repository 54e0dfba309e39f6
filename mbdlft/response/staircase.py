"""Unitary reductions of state-space systems: the part that channels see, and transmission zeros.

Ranks are those of matrices whose rows and columns are of similar size, decided at the rounding of the
largest: a part that is smaller than that is taken for what rounding left.
"""

from collections.abc import Mapping
from contextlib import suppress
from fractions import Fraction
from typing import NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.arguments import arguments_checked
from mbdlft.base.array import Array, ArrayLike
from mbdlft.base.errors import AnalysisError
from mbdlft.base.reach import in_reach
from mbdlft.exact.matrices import from_rows
from mbdlft.exact.numbers import Field, in_enough_bits
from mbdlft.exact.reachable import reduced
from mbdlft.exact.rounding import eigenvalues_of, eigenvectors_of
from mbdlft.response.modes import Names, balancing, eigenpair, transfers_at, with_rounding
from mbdlft.system.model import System

_ROUNDING = 16.0 * float(np.finfo(float).eps)  # times the size of the system and its norm
_MOST_EXACT = 16  # states of a system that is reduced in exact numbers: some 7 ms of full matrices


class Plant(NamedTuple):
    """A, B, C, D of one system: (n, n), (n, nu), (ny, n), (ny, nu)."""

    A: Array
    B: Array
    C: Array
    D: Array

    @property
    def dual(self) -> "Plant":
        """The system with inputs and outputs exchanged."""
        return Plant(self.A.T, self.C.T, self.B.T, self.D.T)


@arguments_checked
def zeros(
    system: System,
    values: Mapping[str, ArrayLike] | None = None,
    *,
    outputs: Names = None,
    inputs: Names = None,
) -> tuple[NDArray[np.complex128], ...]:
    """Transmission zeros: s at which G(s) = C (s I - A)^-1 B + D loses rank, infinite ones left out.

    Modes that the inputs do not reach, or the outputs do not see, are no zeros: they are taken out first.
    Those that no entries lead to, or from, are found by the zeros of the matrices; of others ranks are
    decided at the rounding of the scaled matrices.

    Parameters
    ----------
    system : System or LFTModel
    values : mapping of names to physical values, numbers or arrays (N,); the others are nominal
    outputs, inputs : names of channels; all by default
        Zeros of one transfer: one name of each.

    Returns
    -------
    tuple of N complex arrays, rad/s, each sorted by size
        The number of zeros may differ between samples. It is empty for a G that is zero.
    """
    finite: list[NDArray[np.complex128]] = []
    for A, B, C, D in zip(*transfers_at(system, values, outputs, inputs, "zeros"), strict=True):
        plant = seen(scaled(connected(Plant(A, B, C, D)))[0])
        try:
            finite.append(_sorted(finite_zeros(plant).astype(complex), real=np.isrealobj(plant.A)))
        except np.linalg.LinAlgError:
            raise AnalysisError(
                f"model {system.name!r}: zeros: the eigenvalues of a reduced pencil were not found."
            ) from None
    return tuple(finite)


def _sorted(zeros: NDArray[np.complex128], *, real: bool) -> NDArray[np.complex128]:
    """Zeros by size; those of a real system in pairs that are equal to the last digit."""
    if real:
        upper = zeros[zeros.imag > 0.0]
        zeros = np.concatenate([zeros[zeros.imag == 0.0], upper, np.conj(upper)])
    return zeros[np.lexsort((-zeros.imag, zeros.real, np.abs(zeros)))]


def scaled(plant: Plant) -> tuple[Plant, Array, Array]:
    """The system with states, inputs and outputs scaled by powers of 2 towards similar sizes.

    Poles and zeros stay. Inputs and outputs without any effect stay as they are.

    Returns
    -------
    the system, and what its outputs (ny, 1) and its inputs (nu,) are multiplied with
    """
    A, B, C, D = plant
    n = len(A)
    all_rows, all_columns = np.ones((len(D), 1)), np.ones(D.shape[1])
    for _ in range(4):
        size = max(float(np.max(np.abs(A), initial=0.0)), np.finfo(float).tiny)
        size = size if n and np.any(A) else 1.0
        columns = _power(size, np.max(np.abs(np.vstack([B, D])), axis=0, initial=0.0))
        B, D, all_columns = B * columns, D * columns, all_columns * columns
        rows = _power(size, np.max(np.abs(np.hstack([C, D])), axis=1, initial=0.0))[:, None]
        C, D, all_rows = C * rows, D * rows, all_rows * rows
        # states as if every output fed every input: B and C count, too
        loop = np.block(
            [[np.abs(A), np.sum(np.abs(B), axis=1, keepdims=True)],
             [np.sum(np.abs(C), axis=0, keepdims=True), np.zeros((1, 1))]]
        )  # fmt: skip
        scale = balancing(loop)
        scale = scale[:n] / scale[n]
        A, B, C = A * (scale / scale[:, None]), B / scale[:, None], C * scale
    return Plant(A, B, C, D), all_rows, all_columns


def connected(plant: Plant) -> Plant:
    """The states that inputs reach and outputs see along entries that are not zero: the same transfer."""
    A, B, C, D = plant
    leads = A != 0.0
    reached = in_reach(leads, np.any(B != 0.0, axis=1))
    read = in_reach(leads.T, np.any(C != 0.0, axis=0))
    kept = np.flatnonzero(reached & read)
    return Plant(A[np.ix_(kept, kept)], B[kept], C[:, kept], D)


def exactly_seen(plant: Plant) -> Plant:
    """The part of a real system that channels see, in exact numbers; of many states the system.

    It is the smallest LFT in 1/s, whose coordinates are states of the system.
    """
    n, whole = len(plant.A), np.block([[plant.A, plant.B], [plant.C, plant.D]])
    if n > _MOST_EXACT or not np.isrealobj(whole):
        return plant

    def smallest() -> Plant:
        field = Field()
        rows = [
            {j: field.rational(Fraction(x)) for j, x in enumerate(row) if x} for row in whole.tolist()
        ]
        exact, (size,) = reduced(from_rows(rows, whole.shape[1], field.prime), [n])
        if size == n:
            return plant
        M = exact.values()
        return Plant(M[:size, :size], M[:size, size:], M[size:, :size], M[size:, size:])

    with suppress(AnalysisError):  # of more digits than any system that was seen
        return in_enough_bits(smallest, "the system")
    return plant


def without_one(plant: Plant, poles: NDArray[np.complex128]) -> Plant | None:
    """The system without the first of its poles, and its conjugate, that channels do not see; None: all.

    A simple pole has the residue (C v)(u'B)/(u'v): it is not seen if balls do not tell one of both from
    0. Where u'B = 0 states stay in the directions across u, and the other way round.
    """
    import scipy.linalg  # here because it is slow to import

    A, B, C, D = plant
    values, U, V = eigenvectors_of(A)
    dual = np.conj(A.T), np.conj(B.T), np.conj(values), U
    for pole in poles[poles.imag >= 0.0] if np.isrealobj(A) else poles:
        k = int(np.argmin(np.abs(values - pole)))
        for a, read, eigenvalues, v in (dual, (A, C, values, V)):
            pair = eigenpair(a, complex(eigenvalues[k]), v[:, k])
            if pair is None:
                continue
            along = with_rounding(read) * flint.acb_mat(len(A), 1, pair[:-1])
            if all(entry.contains(0) for entry in along.entries()):
                w = v[:, k] / np.linalg.norm(v[:, k])
                rows = np.array([w.real, w.imag]) if np.isrealobj(A) else np.conj(w)[None]
                Z = scipy.linalg.null_space(rows[: 1 + (values[k].imag != 0.0)])
                Zh = np.conj(Z.T)
                return Plant(Zh @ A @ Z, Zh @ B, C @ Z, D)
    return None


def seen(plant: Plant) -> Plant:
    """The part of a scaled system that its inputs reach and its outputs see: the same transfer."""
    return reached(reached(plant).dual).dual


def reached(plant: Plant) -> Plant:
    """The part of a scaled system that its inputs reach (staircase; Van Dooren 1981, section III)."""
    A, B, C, D = plant
    tolerance = _tolerance(plant)
    n, Q, done = len(A), np.eye(len(A), dtype=A.dtype), 0
    T, step = A, B
    while done < n:
        U, values, _ = np.linalg.svd(step)
        rank = int(np.sum(values > tolerance))
        if rank == 0:
            break
        Q = np.hstack([Q[:, :done], Q[:, done:] @ U])
        T = np.conj(Q.T) @ A @ Q
        step = T[done + rank :, done : done + rank]
        done += rank
    kept = Q[:, :done]
    return Plant(np.conj(kept.T) @ A @ kept, np.conj(kept.T) @ B, C @ kept, D)


def finite_zeros(plant: Plant) -> Array:
    """Finite zeros of a scaled system: s at which [A - s I, B; C, D] loses rank.

    Emami-Naeini and Van Dooren, Automatica 18 (1982), section 3: rows of outputs in which no input stands
    name states that are zero at a zero; these are taken out, then the same is done with inputs. What is
    left has an invertible D, and n finite zeros.
    """
    import scipy.linalg  # here because it is slow to import

    tolerance = _tolerance(plant)
    once = _without_infinite(plant, tolerance)
    A, B, C, D = _without_infinite(once.dual, tolerance).dual
    n, m = len(A), D.shape[1]
    if not n:
        return np.zeros(0, dtype=complex)
    if not m:
        return eigenvalues_of(A).astype(complex)
    _, _, V = scipy.linalg.svd(np.hstack([C, D]), check_finite=False)
    null = np.conj(V[m:].T)  # of [C D], so that [A B] null x = s [I 0] null x
    top = np.hstack([A, B]) @ null
    eigenvalues: Array = scipy.linalg.eigvals(top, null[:n], check_finite=False)
    return eigenvalues[np.isfinite(eigenvalues)]


def _without_infinite(plant: Plant, tolerance: float) -> Plant:
    """A system of the same finite zeros whose D has full row rank."""
    A, B, C, D = plant
    while True:
        U, values, _ = np.linalg.svd(D, full_matrices=True)
        rank = int(np.sum(values > tolerance))
        if rank == len(D):
            return Plant(A, B, C, D)
        C, D = np.conj(U.T) @ C, np.conj(U.T) @ D
        silent, C, D = C[rank:], C[:rank], D[:rank]
        _, values, V = np.linalg.svd(silent, full_matrices=True)
        count = int(np.sum(values > tolerance))
        if count == 0:
            return Plant(A, B, C, D)
        kept, zero = np.conj(V[count:].T), np.conj(V[:count].T)
        C, D = (np.vstack([C @ kept, np.conj(zero.T) @ A @ kept]), np.vstack([D, np.conj(zero.T) @ B]))
        A, B = np.conj(kept.T) @ A @ kept, np.conj(kept.T) @ B


def _tolerance(plant: Plant) -> float:
    """The size of what is rounding in a scaled system."""
    norm = float(np.sqrt(sum(float(np.linalg.norm(matrix)) ** 2 for matrix in plant)))
    return float(_ROUNDING * (len(plant.A) + max(plant.D.shape)) * norm)


def _power(size: float, values: Array) -> Array:
    """Powers of 2 near size / values; 1 for zeros."""
    with np.errstate(divide="ignore"):
        exponents = np.round(np.log2(size / values))
    return np.exp2(np.where(np.isfinite(exponents), exponents, 0.0))
