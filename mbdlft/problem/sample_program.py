"""Trim and linearization of nonlinear equations at a sample, as one straight-line program.

From physical values come the efforts, then the slopes at the equilibrium, then [A B ; C D]: the
definitions of `trim` and `relinearize`, with linear equations eliminated by their sparsity in an order
that is chosen once. Where a pivot loses digits, the equations do not hold, or something is not a number,
the program says so, and the definition has to be asked.
"""

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import NotRationalError
from mbdlft.base.samples import SEED, check_points
from mbdlft.lft.program.elimination import Sparse, product, solve, sparse
from mbdlft.lft.program.tape import Operand, Pivot, Program, Tape, TooLongError, rows_of_numbers
from mbdlft.problem.equations import Equations, split
from mbdlft.problem.linearization import slope_function
from mbdlft.problem.sx.evaluation import evaluate_many, program_rules
from mbdlft.problem.sx.tapes import fold
from mbdlft.problem.trim import carried_function, relation_function, trim_rows

_PROBES = 16  # samples at which pivots are chosen


class StraightLine(NamedTuple):
    """A program of rows of numbers, in parts."""

    program: Program  # its pivots tell, too, whether a number of the row is not finite
    row: Array  # (size,), what a row is where nothing depends on the parameters
    shape: tuple[int, int]  # of the matrices, the first part of a row, row by row
    # number of trim unknowns, the next part; then come the largest residual of the equations at
    # rest and the largest of their terms that the unknowns have to hold, the largest load or
    # effort, and the wrenches through elastic bodies
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
    right: Sparse = [_shifted(row, unknown, unknown + known, tape) for row in top]
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
    outcome += [held.residual, held.load, *_carried(e, registers, held.efforts, tape)]
    program, row = rows_of_numbers(tape, outcome, [*held.pivots, *pivots])
    return StraightLine(program, row, (len(rows), len(columns)), len(e.unknown))


def _carried(e: Equations, registers: list[int], efforts: Sequence[Operand], tape: Tape) -> list[Operand]:
    """The largest load or effort, and the wrenches through elastic bodies, if there are any."""
    if not e.carried_by:
        return [0.0]
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


def _shifted(row: dict[int, Operand], start: int, stop: int, tape: Tape) -> dict[int, Operand]:
    """The right sides: minus the slopes by known signals."""
    return {j: tape.subtract(0.0, value) for j, value in _between(row, start, stop).items()}


def _sum(tape: Tape, a: dict[int, Operand], b: dict[int, Operand]) -> dict[int, Operand]:
    return {j: tape.add(a.get(j, 0.0), b.get(j, 0.0)) for j in sorted(a.keys() | b.keys())}
