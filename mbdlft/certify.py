"""The certificate: how small the model is, how small it could be, and how far it is from the truth.

The truth is the nonlinear equations, trimmed and linearized again with numbers at every check point.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import casadi as ca
import numpy as np

from mbdlft.analyze.sample import corners, random
from mbdlft.equations import (
    Equations,
    equation_function,
    given_value,
    load_value,
    physical_symbols,
    split,
)
from mbdlft.errors import AnalysisError, WellPosednessError
from mbdlft.lft.bound import Bound
from mbdlft.lft.evaluate import chunks, evaluate_at
from mbdlft.lft.lft import LFT, Array
from mbdlft.lft.model import Certificate
from mbdlft.many import evaluate_in_chunks, evaluate_many
from mbdlft.need import Need
from mbdlft.parameter import Parameter, to_delta
from mbdlft.trim import term_sizes, trim_efforts

_RANDOM_POINTS, _MOST_CORNERS = 100, 128
_FLOOR = 1e-2  # of the load (and the inertia it acts on): the size below which terms have cancelled
ACCEPTED = 1e-5  # of an error; larger ones are refused
_NEGLIGIBLE = 1e-8  # an entry below this part of its row's size is compared with the row
_EFFECT = 1e-4  # of an effort of one: the least that an input is compared with if it does nothing
_IDLE = (
    1e-6  # of the stiffest spring: the least that a row of A is compared with if all of it cancels
)
_MIXED = 1e-4  # part of the largest entry of a column that one of rounding is compared with
_LINES = 32  # points to which the line from nominal is searched for singularities
_FEWEST_LINES = 4
_CHEAP = 256  # order up to which so many lines cost less than all the rest of the check
_REAL = 1e-6  # an eigenvalue with a smaller relative imaginary part may be a double real one


def certificate(
    lft: LFT,
    raw: LFT,
    bounds: Mapping[str, Bound],
    order_bound: int,
    check: tuple[float, int],
    seed: int,
    *,
    exact_bound: bool = False,
    fit_error_bound: float = 0.0,
) -> Certificate:
    """The certificate of a model; `check` is its error and the number of points.

    It is exact unless the equilibrium is a fit.

    A bound that the model contradicts by being smaller rests on a wrong rank: then nothing is claimed
    for that parameter, and nothing for pairs.
    """
    order, raw_order = dict(lft.blocks), dict(raw.blocks)
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
        raw_order=tuple(raw_order.get(name, 0) for name in order),
        max_relative_error=check[0],
        check_points=check[1],
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


def reference_matrices(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], points: Array
) -> tuple[Array, Array, Array, float]:
    """The nonlinear equations, trimmed and linearized at points (N, n_p).

    Returns
    -------
    [A B ; C D] (N, ., .)
    trimmed unknowns (N, n_t)
    sizes of the unknowns (N, n_t): what they would be if no terms cancelled
    a part of the largest load: no stiffness is compared with anything smaller

    Raises
    ------
    WellPosednessError
        The accelerations cannot be solved for at one of the points.
    """
    e = equations
    efforts, _ = trim_efforts(e, points)
    (jacobian,) = evaluate_many(_slope_function(e, tuple(inputs), tuple(outputs)), points, efforts)
    unknown, known = split(e, inputs)
    n, nk = unknown.numel(), known.numel()
    matrices = np.empty((len(points), len(e.states) + len(outputs), nk))
    _state_space(e, n, jacobian, matrices)
    symbols, effort, _, residual = _at_trim(e, tuple(inputs), tuple(outputs))
    given = ca.substitute(residual, effort, given_value(e, symbols))
    no_effort = ca.Function("load", [symbols], [ca.densify(given)])
    by_effort = np.abs(np.linalg.pinv(jacobian[:, :n, n + nk :]))
    terms = (by_effort @ term_sizes(no_effort, points)[:, :, None])[:, :, 0]
    # where terms cancel already in the numbers of the scene: what the load does to the inertia
    lifted = ca.densify(load_value(e, symbols))
    (load,) = evaluate_many(ca.Function("load", [symbols], [lifted]), points)
    inertia = np.max(by_effort @ np.abs(jacobian[:, :n, :n]), axis=2, initial=0.0)
    floor = _FLOOR * np.max(np.abs(load), axis=(1, 2), initial=0.0)
    sizes = np.maximum(terms, floor[:, None] * inertia)
    return matrices, efforts[:, list(e.unknown)], sizes, float(np.max(floor))


def linearized(
    equations: Equations,
    inputs: Sequence[int],
    outputs: Sequence[int],
    points: Array,
    efforts: Array,
) -> Array:
    """The nonlinear equations, linearized at points (N, n_p) with their efforts (N, n_u).

    Returns
    -------
    [A B ; C D] (N, ., .)

    Raises
    ------
    WellPosednessError
        The accelerations cannot be solved for at one of the points.
    """
    e = equations
    function = _slope_function(e, tuple(inputs), tuple(outputs))
    n = split(e, inputs)[0].numel()
    values = np.empty((len(points), len(e.states) + len(outputs), len(e.states) + len(inputs)))
    for part, (jacobian,) in evaluate_in_chunks(function, points, efforts):
        _state_space(e, n, jacobian, values[part])
    return values


def _state_space(e: Equations, n: int, jacobian: Array, values: Array) -> None:
    """Write [A B ; C D] (N, ., .) of slopes (N, ., .) as in `_at_trim`, by n unknown signals first."""
    states, known = len(e.states), values.shape[2]
    try:
        solved = _solved(jacobian[:, :n, :n], -jacobian[:, :n, n : n + known])
    except np.linalg.LinAlgError:
        raise WellPosednessError(
            f"scene {e.name!r}: the mass matrix is singular at a point of the parameter range. Keep "
            "masses and inertias away from zero."
        ) from None
    values[:, :states] = solved[:, :states]
    values[:, states:] = jacobian[:, n:, n : n + known]
    by_unknown = jacobian[:, n:, :n]
    if np.any(by_unknown):
        values[:, states:] += by_unknown @ solved


def _solved(matrix: Array, right: Array) -> Array:
    """matrix^-1 right (N, n, k), refined once; unknowns that one equation gives alone are taken from it.

    The acceleration of an imposed coordinate is exactly its input, whatever stiffness is beside it.
    """
    pattern, acted = (np.any(part != 0.0, axis=0) for part in (matrix, right))
    rows = np.flatnonzero(pattern.sum(axis=1) == 1)
    alone = pattern[rows].argmax(axis=1)
    pivots = matrix[:, rows, alone]
    if len(set(alone)) < len(rows) or not np.all(pivots):
        raise np.linalg.LinAlgError("singular")
    others, coupled = (np.delete(np.arange(len(pattern)), taken) for taken in (rows, alone))
    found = np.zeros_like(right)
    # columns of zeros, as those of rates without damping, are not solved for
    used = np.flatnonzero(np.any(acted[rows], axis=0))
    found[:, alone[:, None], used] = right[:, rows[:, None], used] / pivots[:, :, None]
    if np.any(pattern[np.ix_(others, alone)]):
        right = right - matrix[:, :, alone] @ found[:, alone]
        used = np.arange(right.shape[2])
    else:
        used = np.flatnonzero(np.any(acted[others], axis=0))
    rest, own = right[:, others[:, None], used], matrix[:, others[:, None], coupled]
    inverse = np.linalg.inv(own)
    first = inverse @ rest
    found[:, coupled[:, None], used] = first + inverse @ (rest - own @ first)
    return found


@lru_cache(maxsize=2)  # a sweep asks for it again and again
def _slope_function(
    equations: Equations, inputs: tuple[int, ...], outputs: tuple[int, ...]
) -> ca.Function:
    """(physical values, efforts) -> slopes, as in `_at_trim`."""
    symbols, effort, slopes, _ = _at_trim(equations, inputs, outputs)
    return ca.Function("reference", [symbols, effort], [slopes])


@lru_cache(maxsize=2)
def _at_trim(
    equations: Equations, inputs: tuple[int, ...], outputs: tuple[int, ...]
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Symbols of the parameters and the efforts, and as their functions, at rest: slopes, residual.

    The slopes are those of [residual ; chosen outputs] by unknown, known and trim unknowns.
    """
    e = equations
    symbols, p, cosine, sine = physical_symbols(e.parameters)
    values = equation_function(e)(e.xdot, e.x, e.z, e.u, load_value(e, p), p, cosine, sine)
    stacked = ca.vertcat(values[0], values[1][list(outputs)])
    by = [ca.jacobian(stacked, part) for part in (*split(e, inputs), e.u[list(e.unknown)])]
    around = ca.vertcat(e.xdot, e.x, e.z)
    found = [ca.densify(ca.horzcat(*by)), ca.densify(values[0])]
    at_rest = ca.Function("at_rest", [around, e.u, symbols], found)
    effort = ca.SX.sym("effort", e.u.numel())
    slopes, residual = at_rest(ca.SX(around.numel(), 1), effort, symbols)
    return symbols, effort, slopes, residual


def entry_sizes(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], points: Array
) -> Array:
    """Sizes of the entries of [A B ; C D] if nothing cancelled, neither in a slope nor in solving.

    A stiffness that vanishes for all parameters, or the acceleration of an imposed joint, has no
    size of its own to compare its rounding with.
    """
    e = equations
    efforts, _ = trim_efforts(e, points)
    symbols, effort, slopes, _ = _at_trim(e, tuple(inputs), tuple(outputs))
    both = ca.vertcat(symbols, effort)
    known_points = np.hstack([points, efforts])
    (jacobian,) = evaluate_many(ca.Function("slopes", [both], [slopes]), known_points)
    tape = ca.Function("slopes", [both], [ca.vec(slopes.T)])
    terms = term_sizes(tape, known_points).reshape(jacobian.shape)
    unknown, known = split(e, inputs)
    n, nk = unknown.numel(), known.numel()
    matrix, right = jacobian[:, :n, :n], terms[:, :n, n : n + nk]
    # rounding of the matrix itself counts too: a chain of beams adds far masses to small ones
    first = np.abs(_solved(matrix, jacobian[:, :n, n : n + nk]))
    inverse = np.abs(np.linalg.inv(matrix))
    solved = inverse @ (right + terms[:, :n, :n] @ first)
    # pivots mix the rows: one that is exactly zero gets the rounding of the largest in the column
    mixed = _MIXED * np.max(solved, axis=(0, 1), initial=0.0)
    read = terms[:, n:, n : n + nk] + terms[:, n:, :n] @ solved
    states = len(e.states)
    sizes = np.max(np.concatenate([solved[:, :states], read], axis=1), axis=0)
    found: Array = np.maximum(sizes, mixed)
    # what an effort of one and the stiffest spring do, where a whole row or column cancels
    by_one = np.concatenate([inverse[:, :states], terms[:, n:, :n] @ inverse], axis=1)
    one = np.max(by_one, axis=(0, 2), initial=0.0)[:, None]
    stiffest = float(np.max(terms[:, :n, n : n + states], initial=0.0))
    found[:, :states] = np.maximum(found[:, :states], _IDLE * stiffest * one)
    found[:, states:] = np.maximum(found[:, states:], _EFFECT * one)
    return found


def relative_error(
    values: Array, reference: Array, states: int, floor: float, terms: Array | float = 0.0
) -> float:
    """Largest error of an entry of [A B ; C D], relative to its largest size over the points (N, ., .).

    A negligible entry of A or C is compared with its row: where the terms of a stiffness cancel only
    rounding is left; `floor` is the least size of such a row. One of B or D is compared with its
    column, since inputs have units of their own. `terms` are sizes of entries if nothing cancelled: what
    is negligible beside its own terms is compared with them.
    """
    size = np.max(np.abs(reference), axis=0)
    of_row = np.max(size[:, :states], axis=1, initial=floor, keepdims=True)
    of_column = np.max(size[:, states:], axis=0, initial=0.0, keepdims=True)
    rows, columns = size.shape[0], size.shape[1] - states
    whole = np.hstack([np.tile(of_row, (1, states)), np.tile(of_column, (rows, 1))])
    whole = np.where(whole > 0, whole, np.max(size, initial=0.0)).reshape(rows, states + columns)
    whole = np.maximum(whole, terms)
    scale = np.where(size > _NEGLIGIBLE * whole, size, whole)
    return float(np.max(np.abs(values - reference) / np.where(scale > 0, scale, 1.0), initial=0.0))


def check_well_posed(
    lft: LFT, parameters: Sequence[Parameter], points: Array, owner: str, advice: str = ""
) -> Array:
    """Deltas (N, n_p) of the points, once det(I - D_zw Delta) was seen to stay away from zero.

    The determinant is 1 at nominal, so a point where it is not positive means that it vanishes
    between them. To some of the points the whole line from nominal is searched.

    Raises
    ------
    WellPosednessError
        The determinant vanishes at one of the points or on the way there.
    """
    deltas = np.stack(
        [to_delta(p, points[:, k]) for k, p in enumerate(parameters)] or [np.zeros(0)], axis=1
    ).reshape(len(points), len(parameters))
    spread = np.repeat(deltas, [block.size for block in lft.blocks], axis=1)
    singular = np.zeros(len(points), dtype=bool)
    for part in chunks(len(points), lft.order):
        signs, _ = np.linalg.slogdet(np.eye(lft.order) - lft.M11[None] * spread[part, None, :])
        singular[part] = signs <= 0
    # an eigenvalue of D_zw Delta that is real and >= 1: det vanishes on the line from nominal, even
    # where it does not change its sign
    affordable = int(_LINES * (_CHEAP / max(lft.order, 1)) ** 3)
    count = min(_LINES, max(_FEWEST_LINES, affordable))
    lines = np.unique(np.linspace(0, len(points) - 1, count).astype(int))
    for part in chunks(len(lines), lft.order):
        eigenvalues = np.linalg.eigvals(lft.M11[None] * spread[lines[part], None, :])
        real = np.abs(eigenvalues.imag) <= _REAL * np.abs(eigenvalues)
        singular[lines[part]] |= np.any(real & (eigenvalues.real >= 1.0), axis=1)
    if np.any(singular):
        worst = points[int(np.argmax(singular))]
        where = ", ".join(
            f"{p.name} = {value:g} {p.unit}" for p, value in zip(parameters, worst, strict=True)
        )
        raise WellPosednessError(
            f"{owner}: the model is singular between the nominal values and {where}. Narrow the "
            f"ranges{advice}."
        )
    return deltas


def measure_error(
    equations: Equations,
    inputs: Sequence[int],
    outputs: Sequence[int],
    model: LFT,
    trim: LFT,
    seed: int,
    need: Need | None = None,
) -> tuple[float, int]:
    """Largest relative error of the model and its trim, and the number of points it was taken over.

    The model has the states of `need`, or all; that the others do not matter is compared, too.

    Raises
    ------
    WellPosednessError
        The model is singular somewhere in the range.
    AnalysisError
        The error is larger than rounding can explain in a problem that is worth solving.
    """
    points = check_points(equations.parameters, seed)
    deltas = check_well_posed(
        model,
        equations.parameters,
        points,
        f"scene {equations.name!r}",
        ", or keep masses and inertias away from zero",
    )
    reference, efforts, sizes, floor = reference_matrices(equations, inputs, outputs, points)
    states = len(equations.states)
    values = evaluate_at(model, deltas)
    values = need.whole(values, reference) if need else values
    error = relative_error(values, reference, states, floor)
    if not error <= ACCEPTED:  # unless an entry is nothing but rounding
        terms = entry_sizes(equations, inputs, outputs, points)
        error = relative_error(values, reference, states, floor, terms)
    difference = np.max(np.abs(evaluate_at(trim, deltas)[:, :, 0] - efforts), axis=0)
    size = np.max(sizes, axis=0)
    trim_error = float(np.max(difference / np.where(size > 0, size, 1.0), initial=0.0))
    worst = max(error, trim_error)
    if not worst <= ACCEPTED:
        raise AnalysisError(
            f"scene {equations.name!r}: the model differs from the nonlinear equations by {worst:.1e} "
            f"of the size of an entry of {'its matrices' if error >= trim_error else 'its trim'}. "
            "Either the scene is so badly conditioned that double precision does not carry it (masses "
            "or lengths of very different size in one chain), or this is a bug: please report the scene."
        )
    return worst, len(points)
