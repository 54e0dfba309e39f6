"""The certificate: how small the model is, how small it could be, and how far it is from the truth.

The truth is the nonlinear equations, trimmed and linearized again with numbers at every check point.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import AnalysisError, WellPosednessError
from mbdlft.base.parameter import Parameter, to_delta
from mbdlft.base.samples import corners, random
from mbdlft.bound.degree import Bound
from mbdlft.lft.evaluate import evaluate_at
from mbdlft.lft.lft import LFT
from mbdlft.lft.triangle import values_at, vanishes
from mbdlft.number.rounding import conditioning
from mbdlft.problem.equations import Equations, split
from mbdlft.problem.needed_states import Need
from mbdlft.problem.relinearize import Reference, reference_at, slope_sizes
from mbdlft.system.model import Certificate

_RANDOM_POINTS, _MOST_CORNERS = 100, 128
ACCEPTED = 1e-5  # of an error; larger ones are refused
NEGLIGIBLE = 1e-8  # an entry below this part of its row's size is compared with the row
_EFFECT = 1e-4  # of an effort of one: the least that an input is compared with if it does nothing
_IDLE = (
    1e-6  # of the stiffest spring: the least that a row of A is compared with if all of it cancels
)
_MIXED = 1e-4  # part of the largest entry of a column that one of rounding is compared with


class Check(NamedTuple):
    """What a model was measured with: error and conditioning as in `Certificate`."""

    error: float
    points: int
    condition: float = 0.0
    sign_changes: int = 0


def certificate(
    lft: LFT,
    raw: Mapping[str, int],
    bounds: Mapping[str, Bound],
    order_bound: int,
    check: Check,
    seed: int,
    *,
    exact_bound: bool = False,
    fit_error_bound: float = 0.0,
) -> Certificate:
    """The certificate of a model; `raw` are its channels before reduction, by parameter.

    It is exact unless the equilibrium is a fit.

    A bound that the model contradicts by being smaller rests on a wrong rank: then nothing is claimed
    for that parameter, and nothing for pairs.
    """
    order = dict(lft.blocks)
    wrong = {name for name, size in order.items() if bounds[name].degree > size}
    lower = {name: 0 if name in wrong else bounds[name].degree for name in order}
    doubtful = {
        name: size if name in wrong else max(0, min(bounds[name].doubtful, size - lower[name]))
        for name, size in order.items()
    }
    contradicted = wrong or order_bound > lft.order
    return Certificate(
        order=tuple(order.values()),
        lower_bound=tuple(lower.values()),
        raw_order=tuple(raw.get(name, 0) for name in order),
        max_relative_error=check.error,
        check_points=check.points,
        condition=check.condition,
        sign_changes=check.sign_changes,
        seed=seed,
        exact=fit_error_bound == 0.0,
        fit_error_bound=fit_error_bound,
        exact_bound=exact_bound,
        doubtful=tuple(doubtful.values()),
        order_bound=sum(lower.values()) if contradicted else order_bound,
    )


def check_points(parameters: Sequence[Parameter], seed: int) -> Array:
    """Physical points (N, n_p): nominal, random, and all corners, or 128 random corners."""
    if not parameters:
        return np.zeros((1, 0))
    inside = random(parameters, _RANDOM_POINTS, seed)
    if 2 ** len(parameters) <= _MOST_CORNERS:
        outer = corners(parameters)
    else:
        sides = np.random.default_rng(seed).integers(0, 2, (_MOST_CORNERS, len(parameters)))
        outer = {p.name: np.where(sides[:, k], p.high, p.low) for k, p in enumerate(parameters)}
    columns = [np.concatenate([[p.nominal], inside[p.name], outer[p.name]]) for p in parameters]
    return np.stack(columns, axis=1)


class _Sizes(NamedTuple):
    """Sizes (N, ., .) of [A B ; C D], unknowns, slopes, and of the inverse of those by the unknowns."""

    entries: Array
    solved: Array
    terms: Array
    inverse: Array


def _sizes_at(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], at: Reference
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
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], at: Reference
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


def relative_error(values: Array, reference: Array, scale: Array) -> float:
    """Largest error of an entry of [A B ; C D] (N, ., .), relative to its scale."""
    return float(np.max(np.abs(values - reference) / scale, initial=0.0))


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


def values_at_points(
    lft: LFT, parameters: Sequence[Parameter], points: Array, owner: str, advice: str = ""
) -> Array:
    """Values (N, ., .) at physical points, once det(I - D_zw Delta) was seen to stay away from zero.

    The determinant is 1 at nominal, so a point where it is not positive means that it vanishes
    between them. To some of the points the whole line from nominal is searched.

    Raises
    ------
    WellPosednessError
        The determinant vanishes at one of the points or on the way there.
    """
    deltas = deltas_at(parameters, points)
    values, signs = values_at(lft, deltas)
    singular = (signs <= 0.0) | vanishes(lft, deltas)
    if np.any(singular):
        worst = points[int(np.argmax(singular))]
        where = ", ".join(
            f"{p.name} = {value:g} {p.unit}" for p, value in zip(parameters, worst, strict=True)
        )
        raise WellPosednessError(
            f"{owner}: the model is singular between the nominal values and {where}. Narrow the "
            f"ranges{advice}."
        )
    return values


def deltas_at(parameters: Sequence[Parameter], points: Array) -> Array:
    """Deltas (N, n_p) [1] of physical points."""
    columns = [to_delta(p, points[:, k]) for k, p in enumerate(parameters)]
    return np.stack(columns or [np.zeros(0)], axis=1).reshape(len(points), len(parameters))


def measure_error(
    equations: Equations,
    inputs: Sequence[int],
    outputs: Sequence[int],
    model: LFT,
    trim: LFT,
    seed: int,
    known: Reference | None = None,
    need: Need | None = None,
) -> tuple[float, Reference]:
    """Largest relative error of the model and its trim, and what they were compared with.

    `known` is that of another model of the same equations. The model has the states of `need`, or all;
    that the others do not matter is compared, too.

    Raises
    ------
    WellPosednessError
        The model is singular somewhere in the range.
    AnalysisError
        The error is larger than rounding can explain in a problem that is worth solving.
    """
    points = check_points(equations.parameters, seed)
    values = values_at_points(
        model,
        equations.parameters,
        points,
        f"scene {equations.name!r}",
        ", or keep masses and inertias away from zero",
    )
    at = known or reference_at(equations, inputs, outputs, points)
    reference, states = at.linear.matrices, len(equations.states)
    values = need.whole(values, reference) if need else values
    error = relative_error(values, reference, entry_scale(reference, states, at.floor))
    if not error <= ACCEPTED:  # unless an entry is nothing but rounding
        terms = entry_sizes(equations, inputs, outputs, at)
        error = relative_error(values, reference, entry_scale(reference, states, at.floor, terms))
    trimmed = evaluate_at(trim, deltas_at(equations.parameters, points))[:, :, 0]
    difference = np.max(np.abs(trimmed - at.efforts[:, list(equations.unknown)]), axis=0)
    size = np.max(at.effort_sizes, axis=0)
    trim_error = float(np.max(difference / np.where(size > 0, size, 1.0), initial=0.0))
    worst = max(error, trim_error)
    if not worst <= ACCEPTED:
        raise AnalysisError(
            f"scene {equations.name!r}: the model differs from the nonlinear equations by {worst:.1e} "
            f"of the size of an entry of {'its matrices' if error >= trim_error else 'its trim'}. "
            "Either the scene is so badly conditioned that double precision does not carry it (masses "
            "or lengths of very different size in one chain), or this is a bug: please report the scene."
        )
    return worst, at


def checked(
    equations: Equations,
    inputs: Sequence[int],
    outputs: Sequence[int],
    error: float,
    at: Reference,
    need: Need,
) -> Check:
    """The error with the conditioning of what it was measured against, of the states of `need`."""
    sizes = _sizes_at(equations, inputs, outputs, at).entries
    found = conditioning_of(need.of(at.linear.matrices), need.of(sizes), len(need.states), at.floor)
    return Check(error, len(at.points), *found)
