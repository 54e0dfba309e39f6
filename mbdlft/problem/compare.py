"""What errors of linearized mechanical equations are relative to, and how well conditioned they are."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.exact.rounding import conditioning
from mbdlft.problem.equations import Equations, split
from mbdlft.problem.in_digits import matrices_in_digits, transfers_in_digits
from mbdlft.problem.needed_states import Need
from mbdlft.problem.problem import Reference
from mbdlft.problem.relinearize import Relinearized, relinearize, slope_sizes
from mbdlft.problem.transfers import Complex, implicit_transfers
from mbdlft.problem.trim import PART

NEGLIGIBLE = 1e-8  # an entry below this part of its row's size is compared with the row
_EFFECT = 1e-4  # of an effort of one: the least that an input is compared with if it does nothing
_IDLE = (
    1e-6  # of the stiffest spring: the least that a row of A is compared with if all of it cancels
)
_MIXED = 1e-4  # part of the largest entry of a column that one of rounding is compared with


def reference_of(
    equations: Equations,
    exact: Equations,
    inputs: Sequence[int],
    outputs: Sequence[int],
    need: Need,
    points: Array,
) -> Reference:
    """The nonlinear equations, trimmed and linearized again with numbers at points (N, n_p).

    `exact` are the same equations with constants that are not rounded.

    Raises
    ------
    TrimError, WellPosednessError
        At one of the points nothing holds the equilibrium, or the accelerations cannot be solved for.
    """
    e, states = equations, len(equations.states)
    at = relinearize(e, inputs, outputs, points)
    matrices = at.linear.matrices
    scale = entry_scale(matrices, states, at.floor)

    def if_cancelled() -> tuple[Array, float]:
        terms = entry_sizes(e, inputs, outputs, at)
        coarse = entry_scale(matrices, states, at.floor, terms)
        return need.of(coarse[None])[0], need.omitted(matrices, coarse)

    def condition() -> tuple[float, int]:
        sizes = need.of(_sizes_at(e, inputs, outputs, at).entries)
        return conditioning_of(need.of(matrices), sizes, len(need.states), at.floor)

    def trim_if_cancelled() -> Array:
        n, nk = (part.numel() for part in split(e, inputs))
        by_effort = np.abs(np.linalg.pinv(at.linear.jacobian[:, :n, n + nk :]))
        stiffness = by_effort @ np.abs(at.linear.jacobian[:, :n, n : n + states])
        found: Array = np.maximum(trim_scale, PART * np.max(stiffness, axis=(0, 2), initial=0.0))
        return found

    def transfers(some: Sequence[int], frequencies: Array) -> Complex:
        unknown, known = (part.numel() for part in split(e, inputs))
        return implicit_transfers(
            at.linear.jacobian[list(some)], (unknown, known, states), frequencies
        )

    def in_digits(some: Sequence[int], frequencies: Array) -> Complex:
        return transfers_in_digits(exact, inputs, outputs, points[list(some)], frequencies)

    trim_scale = np.max(at.effort_sizes, axis=0)
    return Reference(
        values=need.of(matrices),
        scale=need.of(scale[None])[0],
        omitted=need.omitted(matrices, scale),
        if_cancelled=if_cancelled,
        conditioning=condition,
        trimmed=at.efforts[:, list(e.unknown)],
        trim_scale=np.where(trim_scale > 0, trim_scale, 1.0),
        in_digits=lambda some: need.of(matrices_in_digits(exact, inputs, outputs, some)),
        trim_if_cancelled=trim_if_cancelled,
        transfers=transfers,
        transfers_in_digits=in_digits,
    )


class _Sizes(NamedTuple):
    """Sizes (N, ., .) of [A B ; C D], unknowns, slopes, and of the inverse of those by the unknowns."""

    entries: Array
    solved: Array
    terms: Array
    inverse: Array


def _sizes_at(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], at: Relinearized
) -> _Sizes:
    """Sizes if nothing cancelled, neither in a slope nor in solving (Skeel 1979), at each point."""
    e, jacobian = equations, at.linear.jacobian
    terms = slope_sizes(e, inputs, outputs, at)
    unknown, known = split(e, inputs)
    n, nk = unknown.numel(), known.numel()
    right = terms[:, :n, n : n + nk]
    inverse = np.abs(np.linalg.inv(jacobian[:, :n, :n]))
    # rounding of the matrix itself counts too: a chain of beams adds far masses to small ones
    solved = inverse @ (right + terms[:, :n, :n] @ np.abs(at.linear.solved))
    read = terms[:, n:, n : n + nk] + terms[:, n:, :n] @ solved
    entries = np.concatenate([solved[:, : len(e.states)], read], axis=1)
    return _Sizes(entries, solved, terms, inverse)


def entry_sizes(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], at: Relinearized
) -> Array:
    """Sizes of the entries of [A B ; C D] over all points if nothing cancelled.

    A stiffness that vanishes for all parameters, or the acceleration of an imposed joint, has no
    size of its own to compare its rounding with.
    """
    entries, solved, terms, inverse = _sizes_at(equations, inputs, outputs, at)
    unknown, _ = split(equations, inputs)
    n, states = unknown.numel(), len(equations.states)
    # pivots mix the rows: one that is exactly zero gets the rounding of the largest in the column
    mixed = _MIXED * np.max(solved, axis=(0, 1), initial=0.0)
    found: Array = np.maximum(np.max(entries, axis=0), mixed)
    # what an effort of one and the stiffest spring do, where a whole row or column cancels
    by_one = np.concatenate([inverse[:, :states], terms[:, n:, :n] @ inverse], axis=1)
    one = np.max(by_one, axis=(0, 2), initial=0.0)[:, None]
    stiffest = float(np.max(terms[:, :n, n : n + states], initial=0.0))
    found[:, :states] = np.maximum(found[:, :states], _IDLE * stiffest * one)
    found[:, states:] = np.maximum(found[:, states:], _EFFECT * one)
    return found


def entry_scale(
    reference: Array, states: int, floor: float = 0.0, terms: Array | float = 0.0
) -> Array:
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


def conditioning_of(
    reference: Array, sizes: Array, states: int, floor: float = 0.0
) -> tuple[float, int]:
    """`conditioning` of [A B ; C D] (N, ., .) with the scales of `entry_scale`."""
    whole = _whole(np.max(np.abs(reference), axis=0), states, floor)
    scale = entry_scale(reference, states, floor)
    return conditioning(reference, sizes, scale, NEGLIGIBLE * whole)


def _whole(size: Array, states: int, floor: float) -> Array:
    """Sizes of the row of each entry of A or C, and of the column of each of B or D."""
    of_row = np.max(size[:, :states], axis=1, initial=floor, keepdims=True)
    of_column = np.max(size[:, states:], axis=0, initial=0.0, keepdims=True)
    rows, columns = size.shape[0], size.shape[1] - states
    whole = np.hstack([np.tile(of_row, (1, states)), np.tile(of_column, (rows, 1))])
    return np.where(whole > 0, whole, np.max(size, initial=0.0)).reshape(rows, states + columns)
