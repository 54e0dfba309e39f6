"""References of models: values and transfer functions by another computation than the LFT.

Relations are solved in doubles at all points, and in balls (50 digits) at some. With s = j omega,
G = C (s I - A)^-1 B + D; the relations J_xdot s x + J_z z + J_x x + J_u u = 0 give the same without being
solved for s x first, so rounding of A, B, C and D is not in it.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.sparse import hstack

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.parameter import to_internal
from mbdlft.exact.rounding import EPS, MOST_ROUNDINGS, eigenvalues_of
from mbdlft.problem.digits import efforts_in_digits, equations_in_digits, relations_in_digits
from mbdlft.problem.equations import Equations, split
from mbdlft.problem.linearization import Relinearized, inverse_of_efforts, relinearize, slope_function
from mbdlft.problem.needs import Need
from mbdlft.problem.relations import Complex, LinearModel, Reference
from mbdlft.problem.sparse import Entries, Matrices, dense, joined, solve, solve_scaled
from mbdlft.problem.sx.constants import in_doubles
from mbdlft.problem.sx.tapes import evaluate_many, term_sizes
from mbdlft.problem.trim import PART

_COUNT = 8  # frequencies
_FROM, _TO = 0.097, 2.137  # times the slowest and the fastest pole; no ratio that designs have
_SLOWEST = 1e-4  # of the fastest pole: slower ones, as those of free motions, ask for no frequency
_BESIDE = 1.01  # times a pole: no frequency is nearer
_REST = 1e-4  # rad/s: slower ones may be rounding of nothing
_MOST_STEPS = 4  # of refinement: one does, but where stiffnesses lie twelve orders apart
_ROUNDED = 4.0 * EPS  # of the terms of an equation: if it misses no more, it is solved
QUIET = 1e-6  # of the largest of a row over the frequencies: 120 dB below, nobody looks


def frequencies_of(A: Array) -> Array:
    """Frequencies (F,), rad/s, on a logarithmic scale around and beside the poles of A (N, n, n)."""
    poles = np.abs(eigenvalues_of(A)).ravel()
    fastest = float(np.max(poles, initial=0.0))
    if not _REST < fastest < np.inf:
        return np.logspace(-1.0, 4.0, _COUNT)
    poles = poles[poles > max(_SLOWEST * fastest, _REST)]
    frequencies = np.geomspace(_FROM * np.min(poles), _TO * fastest, _COUNT)
    for k, w in enumerate(frequencies):
        # the nearest free place, of so many that poles cannot take them all
        free = w * _BESIDE ** (2.0 * np.arange(len(poles) + 1))
        distance = np.min(np.abs(np.log(free[:, None] / poles)), axis=1)
        frequencies[k] = free[np.argmax(distance >= np.log(_BESIDE))]
    return np.asarray(frequencies)


def transfers(matrices: Array, states: int, frequencies: Array) -> Complex:
    """Transfer functions (N, F, n_y, n_u) of [A B ; C D] (N, ., .); a LinAlgError where s is a pole."""
    shift = np.eye(*matrices.shape[1:]) * (np.arange(matrices.shape[1]) < states)[:, None]
    both = matrices[:, None] - 1j * frequencies[:, None, None] * shift
    return _eliminated(both[..., :states, :], both[..., states:, :], states)


def implicit_transfers(jacobian: Matrices, sizes: tuple[int, int, int], frequencies: Array) -> Complex:
    """Transfer functions (N, F, n_y, n_u) of slopes of [residual ; outputs]; of sparse ones (F, ., .).

    Their columns are by unknown signals, the derivatives of the states first, and by known ones, the
    states first; `sizes` are the numbers of unknown and known signals and of states. A LinAlgError says
    that a frequency is a pole.
    """
    if not isinstance(jacobian, np.ndarray):
        return np.array([_implicit(jacobian, sizes, 1j * float(w)) for w in frequencies])
    return _implicit(jacobian[:, None], sizes, 1j * frequencies[:, None, None])


def _implicit(J: Matrices, sizes: tuple[int, int, int], s: Any) -> Complex:
    unknown, known, states = sizes
    by_states = J[..., unknown : unknown + states] + s * J[..., :states]
    others = J[..., [*range(states, unknown), *range(unknown + states, unknown + known)]]
    if isinstance(J, np.ndarray):
        shape = (*by_states.shape[:-1], others.shape[-1])
        both = np.concatenate([by_states, np.broadcast_to(others, shape)], axis=-1)
    else:
        both = hstack([by_states, others], format="csc")
    return _eliminated(both[..., :unknown, :], both[..., unknown:, :], unknown)


def rounded_transfers(values: Array, states: int, frequencies: Array, rounding: Array) -> Array:
    """What rounding (., .) of [A B ; C D] (N, ., .) changes transfer functions by, (N, F, n_y, n_u).

    With the resolvent R = (s I - A)^-1, to first order dG = dD + dC R B + C R (dA R B + dB); solving with
    s I - A changes that matrix by a rounding of its entries.
    """
    shift = 1j * frequencies[:, None, None] * np.eye(states) - values[:, None, :states, :states]
    inverse = np.linalg.inv(shift)
    right = np.abs(inverse @ values[:, None, :states, states:])
    left = np.abs(values[:, None, states:, :states] @ inverse)
    dA, dB = rounding[:states, :states] + EPS * np.abs(shift), rounding[:states, states:]
    dC, dD = rounding[states:, :states], rounding[states:, states:]
    return np.asarray(dD + dC @ right + left @ (dA @ right + dB))


def largest_of_rows(values: Complex, truth: Complex) -> float:
    """Largest difference of transfer functions (N, F, n_y, n_u), relative to the row of the truth.

    The size of a row is its largest entry at that frequency, and at least `QUIET` of the largest of all
    frequencies. A row that is exactly zero in the truth has no size; its entries are compared as those
    of C and D.
    """
    row_sizes = np.max(np.abs(truth), axis=-1, initial=0.0)
    size = np.maximum(row_sizes, QUIET * np.max(row_sizes, axis=1, keepdims=True, initial=0.0))
    difference = np.max(np.abs(values - truth), axis=-1, initial=0.0)
    clear = size > 0.0
    return float(np.max(difference[clear] / size[clear], initial=0.0))


def _eliminated(top: Matrices, bottom: Matrices, count: int) -> Complex:
    """Rows [K L] = `top` and [M N] = `bottom` with the first `count` columns solved for: N - M K^-1 L."""
    M, N = bottom[..., :count], dense(bottom[..., count:])
    if not count:
        return np.asarray(N, dtype=complex)
    return np.asarray(N - M @ _refined(top[..., :count], dense(top[..., count:])))


def _refined(K: Matrices, right: Array) -> Complex:
    """K^-1 right, as if entries of K and right were rounded, each relative to itself.

    Elimination rounds what it fills in: where a stiff spring holds what a weak one moves, that is larger
    by many orders. Refinement removes it, also in the same precision (Skeel 1980).
    """
    solved = solve_scaled(K, right)
    for _ in range(_MOST_STEPS):
        missed, terms = right - K @ solved, abs(K) @ np.abs(solved) + np.abs(right)
        if np.all(np.abs(missed) <= _ROUNDED * terms):
            break
        solved = solved + solve_scaled(K, missed)
    return np.asarray(solved)


NEGLIGIBLE = 1e-8  # an entry below this part of its row's size is compared with the row
_EFFECT = 1e-4  # of an effort of one: the least that an input is compared with if it does nothing
_IDLE = 1e-6  # of the stiffest spring: the least that a row of A is compared with if all of it cancels
_MIXED = 1e-4  # part of the largest entry of a column that one of rounding is compared with


def reference_of(
    equations: Equations,
    exact: Equations,
    inputs: Sequence[int],
    outputs: Sequence[int],
    need: Need,
    points: Array,
) -> Reference:
    """Nonlinear equations trimmed and linearized at points (N, n_p); `exact` ones are not rounded."""
    e, states = equations, len(equations.states)
    at = relinearize(e, inputs, outputs, points)
    matrices = at.linear.matrices
    scale, size = entry_scale(matrices, states, at.floor), np.max(np.abs(matrices), axis=0)

    @cache
    def sizes() -> Array:
        return _sizes_at(e, inputs, outputs, at).entries

    def if_cancelled() -> Array:
        coarse = entry_scale(matrices, states, at.floor, entry_sizes(e, inputs, outputs, at))
        kept: Array = need.of(coarse[None], points, sizes=True)[0]
        return kept

    def omitted() -> float:
        if need.keeps_all:
            return 0.0
        rounding = EPS * np.maximum(scale, np.max(sizes(), axis=0))
        ratio = need.omitted(matrices, rounding, points)
        if ratio > MOST_ROUNDINGS:  # doubles may have lost that it is zero
            ends = points[[0, -1]]
            ratio = need.omitted(digits().matrices(ends), rounding, ends)
        return ratio

    def trim_in_digits() -> tuple[Array, Array]:
        n, nk = (signals.numel() for signals in split(e, inputs))
        by_effort = np.abs(inverse_of_efforts(at.linear.jacobian[:, :n, n + nk :]))
        stiffness = by_effort @ np.abs(at.linear.jacobian[:, :n, n : n + states])
        scale: Array = np.maximum(trim_scale, PART * np.max(stiffness, axis=(0, 2), initial=0.0))
        return efforts_in_digits(exact, inputs, outputs, points), scale

    def transfers(some: Sequence[int], frequencies: Array) -> Complex:
        unknown, known = (signals.numel() for signals in split(e, inputs))
        return implicit_transfers(at.linear.jacobian[list(some)], (unknown, known, states), frequencies)

    digits = cache(lambda: equations_in_digits(exact, inputs, outputs))
    trim_scale = np.max(at.effort_sizes, axis=0)
    return Reference(
        values=need.of(matrices, points),
        scale=need.of(scale[None], points, sizes=True)[0],
        omitted=omitted,
        if_cancelled=if_cancelled,
        sizes=lambda: need.of(sizes(), points, sizes=True),
        least=NEGLIGIBLE * need.of(_whole(size, states, at.floor)[None], points, sizes=True)[0],
        trimmed=at.efforts[:, list(e.unknown)],
        trim_scale=np.where(trim_scale > 0, trim_scale, 1.0),
        in_digits=lambda some: need.of(digits().matrices(some), some),
        trim_in_digits=trim_in_digits,
        transfers=transfers,
        transfers_in_digits=lambda some, w: digits().transfers(points[list(some)], w),
    )


class _Counts(NamedTuple):
    """Numbers of unknown and known signals, and of states."""

    unknown: int
    known: int
    states: int


class _Sizes(NamedTuple):
    """Sizes (N, ., .) of [A B ; C D], unknowns, slopes, and of the inverse of those by the unknowns."""

    entries: Array
    solved: Array
    terms: Array
    inverse: Array


def _uncancelled(jacobian: Matrices, terms: Matrices, solved: Array, counts: _Counts) -> _Sizes:
    """Sizes if nothing cancelled, neither in slopes nor in solving (Skeel 1979), at each point."""
    n, end = counts.unknown, counts.unknown + counts.known
    inverse = np.abs(solve(jacobian[..., :n, :n], np.eye(n)))
    # rounding of the matrix itself counts too: a chain of beams adds far masses to small ones
    unknowns = inverse @ (terms[..., :n, n:end] + terms[..., :n, :n] @ np.abs(solved))
    read = terms[..., n:, n:end] + terms[..., n:, :n] @ unknowns
    entries = np.concatenate([unknowns[..., : counts.states, :], read], axis=-2)
    return _Sizes(entries, unknowns, terms, inverse)


def _sizes_at(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], at: Relinearized
) -> _Sizes:
    unknown, known = (signals.numel() for signals in split(equations, inputs))
    counts = _Counts(unknown, known, len(equations.states))
    tape = slope_function(equations, tuple(inputs), tuple(outputs))
    rows, columns = at.linear.jacobian.shape[1:]
    terms = term_sizes(tape, at.points, at.efforts).reshape(-1, columns, rows).transpose(0, 2, 1)
    return _uncancelled(at.linear.jacobian, terms, at.linear.solved, counts)


def entry_sizes(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], at: Relinearized
) -> Array:
    """Sizes of the entries of [A B ; C D] over all points if nothing cancelled, zeros included."""
    entries, solved, terms, inverse = _sizes_at(equations, inputs, outputs, at)
    unknown, _ = split(equations, inputs)
    n, states = unknown.numel(), len(equations.states)
    # pivots mix the rows: one that is exactly zero gets the rounding of the largest in the column
    mixed = _MIXED * np.max(solved, axis=(0, 1), initial=0.0)
    sizes: Array = np.maximum(np.max(entries, axis=0), mixed)
    # what an effort of one and the stiffest spring do, where a whole row or column cancels
    by_one = np.concatenate([inverse[:, :states], terms[:, n:, :n] @ inverse], axis=1)
    per_effort = np.max(by_one, axis=(0, 2), initial=0.0)[:, None]
    stiffest = float(np.max(terms[:, :n, n : n + states], initial=0.0))
    sizes[:, :states] = np.maximum(sizes[:, :states], _IDLE * stiffest * per_effort)
    sizes[:, states:] = np.maximum(sizes[:, states:], _EFFECT * per_effort)
    return sizes


def entry_scale(reference: Array, states: int, floor: float = 0.0, terms: Array | float = 0.0) -> Array:
    """What an entry of [A B ; C D] is compared with: its largest size over the points (N, ., .).

    A negligible entry of A or C is compared with its row: where the terms of a stiffness cancel only
    rounding is left; `floor` is the least size of such a row. One of B or D is compared with its
    column, since inputs have units of their own. `terms` are sizes of entries if nothing cancelled: what
    is negligible beside its own terms is compared with them.
    """
    size = np.max(np.abs(reference), axis=0)
    whole = np.maximum(_whole(size, states, floor), terms)
    scale = np.where(size > NEGLIGIBLE * whole, size, whole)
    return np.where(scale > 0, scale, 1.0)


def _whole(size: Array, states: int, floor: float) -> Array:
    """Sizes of the row of each entry of A or C, and of the column of each of B or D."""
    of_row = np.max(size[:, :states], axis=1, initial=floor, keepdims=True)
    of_column = np.max(size[:, states:], axis=0, initial=0.0, keepdims=True)
    rows, columns = size.shape[0], size.shape[1] - states
    whole = np.hstack([np.tile(of_row, (1, states)), np.tile(of_column, (rows, 1))])
    return np.where(whole > 0, whole, np.max(size, initial=0.0)).reshape(rows, states + columns)


def reference_of_relations(model: LinearModel, points: Array, owner: str) -> Reference:
    """Values [A B ; C D] of relations at physical points (N, n_p)."""
    internal = np.empty((len(points), len(model.parameters)))
    for k, parameter in enumerate(model.parameters):
        internal[:, k] = to_internal(parameter, points[:, k])
    sizes = _Counts(model.unknown.numel(), model.known.numel(), model.derivatives)
    stacked, signals = ca.vertcat(model.residual, model.output), ca.vertcat(model.unknown, model.known)
    slopes = ca.SX(ca.jacobian(stacked, signals))
    sparse = ca.sparsify(in_doubles(slopes))
    function = ca.Function("slopes", [model.p], [ca.densify(column_of_entries(sparse))])
    places, entries = Entries(sparse.sparsity()), evaluate_many(function, internal)[0][:, :, 0]
    values = joined([_solved(J, sizes, owner)[0] for J in places.parts(entries)])
    scale = entry_scale(values, sizes.states)

    @cache
    def terms() -> Array:
        both = zip(places.parts(entries), places.parts(term_sizes(function, internal)), strict=True)
        every = [_uncancelled(J, t, _solved(J, sizes, owner)[1], sizes).entries for J, t in both]
        return np.asarray(joined(every))

    digits = cache(lambda: relations_in_digits(model, slopes))

    def transfers(some: Sequence[int], frequencies: Array) -> Complex:
        slopes_of = places.parts(entries[list(some)])
        return np.asarray(joined([implicit_transfers(J, sizes, frequencies) for J in slopes_of], 4))

    return Reference(
        values=values,
        scale=scale,
        if_cancelled=lambda: np.maximum(scale, np.max(terms(), axis=0)),
        sizes=terms,
        least=NEGLIGIBLE * scale,
        trimmed=np.zeros((len(points), 0)),
        trim_scale=np.zeros(0),
        transfers=transfers,
        transfers_in_digits=lambda some, w: digits().transfers(points[list(some)], w),
        in_digits=lambda some: digits().matrices(some),
    )


def column_of_entries(matrix: ca.SX) -> ca.SX:
    """The entries (n, 1) of a sparse matrix that are not structural zeros, by columns."""
    return ca.vec(ca.SX(matrix.nz[:])) if matrix.nnz() else ca.SX(0, 1)


def _solved(jacobian: Matrices, sizes: _Counts, owner: str) -> tuple[Array, Array]:
    n = sizes.unknown
    K, right = jacobian[..., :n, :n], jacobian[..., :n, n:]
    try:
        solved = -solve(K, right)
    except np.linalg.LinAlgError:
        raise WellPosednessError(
            f"{owner}: the equations do not determine the unknowns at a point of the parameter range. "
            "Narrow the ranges."
        ) from None
    solved = solved - solve(K, right + K @ solved)  # one step of refinement
    read = jacobian[..., n:, n:] + jacobian[..., n:, :n] @ solved
    return np.concatenate([solved[..., : sizes.states, :], read], axis=-2), np.asarray(solved)
