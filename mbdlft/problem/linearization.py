"""The nonlinear equations of a scene, trimmed and linearized with numbers at every point.

The same as one straight-line program: from physical values come the efforts, then the slopes at the
equilibrium, then [A B ; C D], with linear equations eliminated by their sparsity in an order that is
chosen once. Where a pivot loses digits, the equations do not hold, or something is not a number, the
program says so, and the definition has to be asked.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError, WellPosednessError
from mbdlft.base.samples import SEED, check_points
from mbdlft.lft.program.elimination import Sparse, product, solve, sparse
from mbdlft.lft.program.tape import Operand, Pivot, Program, Tape, TooLongError, rows_of_numbers
from mbdlft.problem.equations import (
    WITH_CONSTANTS,
    Equations,
    ParameterSymbols,
    equation_function,
    given_value,
    load_value,
    physical_symbols,
    rows_of,
    split,
)
from mbdlft.problem.sx.tapes import evaluate_in_chunks, evaluate_many, fold, program_rules, term_sizes
from mbdlft.problem.trim import carried_function, relation_function, trim_efforts, trim_rows

_TAKES_PART = 0.1  # of a unit vector: a signal that is named in a message
_ROUNDS = 20  # of scaling: each takes the square root of what sizes differ by
_FLOOR = 1e-2  # of the load (and the inertia it acts on): the size below which terms have cancelled


class Relinearized(NamedTuple):
    """The nonlinear equations, trimmed and linearized at N points."""

    points: Array  # (N, n_p), physical
    efforts: Array  # (N, n_u)
    linear: "Linear"
    effort_sizes: Array  # (N, n_t), of the trim unknowns: what they would be if no terms cancelled
    floor: float  # least size that a stiffness is compared with, a fraction of the load


class Linear(NamedTuple):
    """Matrices of N points."""

    matrices: Array  # [A B ; C D] (N, ., .)
    jacobian: Array  # slopes of [residual ; outputs] by unknown, known and trim unknowns (N, ., .)
    solved: Array  # unknown by known (N, ., .)


def relinearize(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], points: Array
) -> Relinearized:
    """The nonlinear equations, trimmed and linearized at points (N, n_p)."""
    e = equations
    efforts, _ = trim_efforts(e, points)
    (jacobian,) = evaluate_many(slope_function(e, tuple(inputs), tuple(outputs)), points, efforts)
    unknown, known = split(e, inputs)
    linear = _linear(e, unknown.numel(), known.numel(), jacobian)
    n, nk = unknown.numel(), known.numel()
    symbols, effort, _, residual = _at_trim(e, tuple(inputs), tuple(outputs))
    without_unknown = ca.substitute(residual, effort, given_value(e, symbols))
    no_effort = ca.Function("load", [symbols], [ca.densify(without_unknown)])
    by_effort = np.abs(inverse_of_efforts(linear.jacobian[:, :n, n + nk :]))
    terms = (by_effort @ term_sizes(no_effort, points)[:, :, None])[:, :, 0]
    # where terms cancel already in the numbers of the scene: what the load does to the inertia
    lifted = ca.densify(load_value(e, symbols))
    (load,) = evaluate_many(ca.Function("load", [symbols], [lifted]), points)
    inertia = np.max(by_effort @ np.abs(linear.jacobian[:, :n, :n]), axis=2, initial=0.0)
    floor = _FLOOR * np.max(np.abs(load), axis=(1, 2), initial=0.0)
    sizes = np.maximum(terms, floor[:, None] * inertia)
    return Relinearized(points, efforts, linear, sizes, float(np.max(floor)))


def inverse_of_efforts(slopes: Array) -> Array:
    """Pseudoinverses (N, n_t, rows) of slopes (N, rows, n_t), whose rows and columns have many units.

    Stiffnesses of 1e9 N/m stand beside gaps of loops in meters: without powers of two on rows and
    columns what deflects by 1e-7 m falls below the rank that doubles see.
    """
    if not slopes.size:
        return np.zeros((len(slopes), slopes.shape[2], slopes.shape[1]))
    scaled = np.max(np.abs(slopes), axis=0)
    rows, columns = np.ones((len(scaled), 1)), np.ones((1, scaled.shape[1]))
    for _ in range(_ROUNDS):
        rows = rows * _power(np.max(scaled * rows * columns, axis=1, keepdims=True))
        columns = columns * _power(np.max(scaled * rows * columns, axis=0, keepdims=True))
    return np.asarray(columns.T * np.linalg.pinv(slopes * rows * columns) * rows.T)


def _power(size: Array) -> Array:
    """The power of two next to 1/sqrt(size), a step of Ruiz (2001); 1 for zero."""
    return np.exp2(np.round(-0.5 * np.log2(np.where(size > 0.0, size, 1.0))))


def linearized(
    equations: Equations, inputs: Sequence[int], outputs: Sequence[int], points: Array, efforts: Array
) -> Array:
    """[A B ; C D] (N, ., .) of the nonlinear equations at points (N, n_p) with efforts (N, n_u)."""
    e = equations
    unknown, known = (signals.numel() for signals in split(e, inputs))
    values = np.empty((len(points), len(e.states) + len(outputs), known))
    function = slope_function(e, tuple(inputs), tuple(outputs))
    for chunk, (jacobian,) in evaluate_in_chunks(function, points, efforts):
        values[chunk] = _linear(e, unknown, known, jacobian).matrices
    return values


def _linear(e: Equations, unknown: int, known: int, jacobian: Array) -> Linear:
    """Solve slopes (N, ., .) as in `slopes_at_rest` for the unknown signals, which come first."""
    try:
        solved = _solved(
            jacobian[:, :unknown, :unknown], -jacobian[:, :unknown, unknown : unknown + known]
        )
    except np.linalg.LinAlgError:
        raise WellPosednessError(
            f"scene {e.name!r}: the mass matrix is singular at a point of the parameter range: nothing "
            f"with enough inertia moves with {_idle(e, jacobian[:, :unknown, :unknown])}. Keep masses "
            "and inertias away from zero, or give the joints an actuator_inertia."
        ) from None
    read, by_unknown = (jacobian[:, unknown:, unknown : unknown + known], jacobian[:, unknown:, :unknown])
    if np.any(by_unknown):
        read = read + by_unknown @ solved
    matrices = np.concatenate([solved[:, : len(e.states)], read], axis=1)
    return Linear(matrices, jacobian, solved)


def _idle(e: Equations, matrices: Array) -> str:
    """Names of the rates that take part in what the most singular of matrices (N, n, n) does not see."""
    worst = min(matrices, key=lambda matrix: float(np.linalg.svd(matrix, compute_uv=False)[-1]))
    sizes = np.abs(np.linalg.svd(worst)[2][-1])
    taken = zip(e.x_signals, sizes, strict=False)
    return ", ".join(signal.name for signal, size in taken if size > _TAKES_PART) or "the loops"


def _solved(matrix: Array, right: Array) -> Array:
    """matrix^-1 right (N, n, k), refined once; what one equation gives, as imposed motion, is exact."""
    pattern, acted = (np.any(entries != 0.0, axis=0) for entries in (matrix, right))
    rows = np.flatnonzero(pattern.sum(axis=1) == 1)
    alone = pattern[rows].argmax(axis=1)
    pivots = matrix[:, rows, alone]
    if len(set(alone)) < len(rows) or not np.all(pivots):
        raise np.linalg.LinAlgError("singular")
    others, coupled = (np.delete(np.arange(len(pattern)), taken) for taken in (rows, alone))
    solution = np.zeros_like(right)
    # columns of zeros, as those of rates without damping, are not solved for
    used = np.flatnonzero(np.any(acted[rows], axis=0))
    solution[:, alone[:, None], used] = right[:, rows[:, None], used] / pivots[:, :, None]
    if np.any(pattern[np.ix_(others, alone)]):
        right = right - matrix[:, :, alone] @ solution[:, alone]
        used = np.arange(right.shape[2])
    else:
        used = np.flatnonzero(np.any(acted[others], axis=0))
    remaining, inner = right[:, others[:, None], used], matrix[:, others[:, None], coupled]
    inverse = np.linalg.inv(inner)
    first = inverse @ remaining
    solution[:, coupled[:, None], used] = first + inverse @ (remaining - inner @ first)
    return solution


@lru_cache(maxsize=2)  # a sweep asks for it again and again
def slope_function(
    equations: Equations, inputs: tuple[int, ...], outputs: tuple[int, ...]
) -> ca.Function:
    """(physical values, efforts) -> slopes, as in `slopes_at_rest`."""
    symbols, effort, slopes, _ = _at_trim(equations, inputs, outputs)
    return ca.Function("reference", [symbols, effort], [slopes])


@lru_cache(maxsize=2)
def _at_trim(
    equations: Equations, inputs: tuple[int, ...], outputs: tuple[int, ...]
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """`slopes_at_rest` as functions of physical values."""
    return slopes_at_rest(equations, physical_symbols(equations.parameters), inputs, outputs)


def slopes_at_rest(
    e: Equations, arguments: ParameterSymbols, inputs: tuple[int, ...], outputs: tuple[int, ...]
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Symbols of parameters and efforts; slopes by unknown, known, trim unknowns; residual at rest."""
    symbols, p, cosine, sine = arguments
    values = equation_function(e)(e.xdot, e.x, e.z, e.u, load_value(e, p), p, cosine, sine)
    stacked = ca.vertcat(values[0], rows_of(values[1], outputs))
    by = [ca.jacobian(stacked, entries) for entries in (*split(e, inputs), rows_of(e.u, e.unknown))]
    around = ca.vertcat(e.xdot, e.x, e.z)
    results = [ca.densify(ca.horzcat(*by)), ca.densify(values[0])]
    at_rest = ca.Function("at_rest", [around, e.u, symbols], results, WITH_CONSTANTS)
    effort = ca.SX.sym("effort", e.u.numel())
    slopes, residual = at_rest(ca.SX(around.numel(), 1), effort, symbols)
    return symbols, effort, slopes, residual


_PROBES = 16  # samples at which pivots are chosen
_SMALLEST = 5e-324  # load; without one, a residual that is not zero is infinitely large


class StraightLine(NamedTuple):
    """A program of rows of numbers, in parts."""

    program: Program  # its pivots tell, too, whether a number of the row is not finite
    row: Array  # (size,), what a row is where nothing depends on the parameters
    shape: tuple[int, int]  # of the matrices, the first part of a row, row by row
    # number of trim unknowns, the next part; then come the largest residual of the equations at rest
    # relative to the largest of their terms that the unknowns have to hold, and, where there are
    # elastic bodies, the largest load or effort, and the wrenches through these bodies
    trims: int


def straight_line(
    equations: Equations,
    inputs: Sequence[int],
    outputs: Sequence[int],
    kept: tuple[NDArray[np.intp], NDArray[np.intp]],
    longest: int,
) -> StraightLine | None:
    """The program of trim and linearization, of `kept` rows and columns; None if too long or singular."""
    tape = Tape(len(equations.parameters), longest)
    try:
        return _written(equations, tuple(inputs), tuple(outputs), kept, tape)
    except (TooLongError, NotRationalError):
        return None


def _written(
    e: Equations,
    inputs: tuple[int, ...],
    outputs: tuple[int, ...],
    kept: tuple[NDArray[np.intp], NDArray[np.intp]],
    tape: Tape,
) -> StraightLine | None:
    points = check_points(e.parameters, SEED)[:_PROBES]
    registers = list(range(tape.inputs))
    held = _trim(e, registers, points, tape)
    if held is None:
        return None
    slopes = slope_function(e, inputs, outputs)
    (values,) = evaluate_many(slopes, points, held.efforts_at)
    entries = _folded(slopes, tape, registers, held.efforts)[0]
    unknown, known = (signals.numel() for signals in split(e, inputs))
    top, bottom = entries[:unknown], entries[unknown:]
    of_known = [_between(row, unknown, unknown + known) for row in top]
    right: Sparse = [{j: tape.subtract(0.0, x) for j, x in row.items()} for row in of_known]
    solved = solve(tape, [_between(row, 0, unknown) for row in top], right, values[:, :unknown, :unknown])
    if solved is None:
        return None
    unknowns, pivots = solved
    through = product(tape, [_between(row, 0, unknown) for row in bottom], unknowns)
    read = [_between(row, unknown, unknown + known) for row in bottom]
    lower = [_sum(tape, direct, indirect) for direct, indirect in zip(read, through, strict=True)]
    matrices = [*unknowns[: len(e.states)], *lower]
    rows, columns = kept
    outcome = [matrices[i].get(j, 0.0) for i in rows.tolist() for j in columns.tolist()]
    outcome += [held.efforts[k] for k in e.unknown]
    outcome.append(tape.divide(held.residual, tape.maximum(held.load, _SMALLEST)))
    outcome += _carried(e, registers, held.efforts, tape)
    program, row = rows_of_numbers(tape, outcome, [*held.pivots, *pivots])
    return StraightLine(program, row, (len(rows), len(columns)), len(e.unknown))


def _carried(e: Equations, registers: list[int], efforts: Sequence[Operand], tape: Tape) -> list[Operand]:
    """The largest load or effort, and the wrenches through elastic bodies, if there are any."""
    if not e.carried_by:
        return []
    carried, loads = _folded(carried_function(e), tape, registers, efforts)
    largest: Operand = 0.0
    for value in [*efforts, *(load.get(0, 0.0) for load in loads)]:
        largest = tape.maximum(largest, tape.size(value))
    return [largest, *(value.get(0, 0.0) for value in carried)]


class _Held(NamedTuple):
    """The equilibrium: efforts (n_u,), the largest residual and load, pivots, efforts at probes."""

    efforts: list[Operand]
    residual: Operand
    load: Operand
    pivots: list[Pivot]
    efforts_at: Array


def _trim(e: Equations, registers: list[int], points: Array, tape: Tape) -> _Held | None:
    """The efforts that hold the equilibrium, as `trim.balance` has them."""
    relations, unknown = relation_function(e), list(e.unknown)
    offset_at, matrix_at, given_at = evaluate_many(relations, points)
    offset, matrix, known_efforts = _folded(relations, tape, registers)
    efforts: list[Operand] = [row.get(0, 0.0) for row in known_efforts]
    efforts_at, pivots = given_at[:, :, 0].copy(), list[Pivot]()
    if unknown:
        rows = list(trim_rows(e))
        minus = [{0: tape.subtract(0.0, offset[k][0])} if offset[k] else {} for k in rows]
        solved = solve(tape, [matrix[k] for k in rows], minus, matrix_at[:, rows])
        if solved is None:
            return None
        values, pivots = solved
        for k, constant in zip(unknown, values, strict=True):
            efforts[k] = constant.get(0, 0.0)
        efforts_at[:, unknown] = -np.linalg.solve(matrix_at[:, rows], offset_at[:, rows])[:, :, 0]
    acting = [{0: efforts[k]} for k in unknown]
    balanced = product(tape, matrix, acting) if unknown else [{} for _ in offset]
    residual: Operand = 0.0
    load: Operand = 0.0
    for constant, balancing in zip(offset, balanced, strict=True):
        total = _sum(tape, constant, balancing).get(0, 0.0)
        residual = tape.maximum(residual, tape.size(total))
        load = tape.maximum(load, tape.size(constant.get(0, 0.0)))
    return _Held(efforts, residual, load, pivots, efforts_at)


def _folded(function: ca.Function, tape: Tape, *arguments: Sequence[Operand]) -> list[Sparse]:
    """Results of a function on a tape, as sparse rows."""
    results = []
    for k, result in enumerate(fold(function, program_rules(tape), *arguments)):
        rows, columns = function.size_out(k)
        places = zip(*function.sparsity_out(k).get_triplet(), strict=True)
        dense: list[list[Operand]] = [[0.0] * columns for _ in range(rows)]
        for (i, j), value in zip(places, result, strict=True):
            dense[i][j] = value
        results.append(sparse(dense))
    return results


def _between(row: dict[int, Operand], start: int, stop: int) -> dict[int, Operand]:
    return {j - start: value for j, value in row.items() if start <= j < stop}


def _sum(tape: Tape, a: dict[int, Operand], b: dict[int, Operand]) -> dict[int, Operand]:
    return {j: tape.add(a.get(j, 0.0), b.get(j, 0.0)) for j in sorted(a.keys() | b.keys())}
