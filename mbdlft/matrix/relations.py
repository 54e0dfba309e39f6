"""The front end for matrices: from a matrix of expressions to the problem that the pipeline solves."""

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.parameter import Parameter
from mbdlft.base.samples import SEED, check_points
from mbdlft.exact.rounding import conditioning, or_one
from mbdlft.matrix.digits import transfers_in_digits, values_in_digits
from mbdlft.matrix.expressions import Resolved, check_denominators, resolve
from mbdlft.matrix.problem import MatrixProblem, matrix_to_toml
from mbdlft.matrix.symbolic import expanded_matrix, written_matrix
from mbdlft.problem.problem import Form, Nouns, Problem, Reference, Stage
from mbdlft.problem.references import NEGLIGIBLE, transfers
from mbdlft.problem.relations import LinearModel

_SCALINGS = 10  # of rows and columns; each halves the digits in which they differ


def problem_of_matrix(matrix: MatrixProblem, stage: Stage = nullcontext) -> Problem:
    """The entries of a matrix as relations, written in several ways, and its values in 50 digits."""
    parameters = tuple(sorted(matrix.parameters, key=lambda p: p.name))
    with stage("resolve"):
        resolved = resolve(matrix)
        check_denominators(matrix, resolved)
        scaled = _scaled(matrix, resolved, parameters)
        forms = tuple(_forms(matrix, resolved, scaled.factors))
    states, inputs, outputs = matrix.signals()
    return Problem(
        nouns=Nouns(
            "matrix",
            matrix.name,
            "the matrix",
            "its numbers are so different in size that double precision does not carry them",
        ),
        description=matrix.description,
        text=matrix_to_toml(matrix),
        states=states,
        inputs=inputs,
        outputs=outputs,
        parameters=parameters,
        forms=forms,
        points=scaled.points,
        reference=lambda: scaled.reference,
        row_units=scaled.rows,
        column_units=scaled.columns,
    )


class _Scaled(NamedTuple):
    """Values of a matrix, and how it is scaled."""

    points: Array  # (N, n_p), physical
    reference: Reference  # values at the points
    # rows, columns: powers of two by which rows and columns are divided
    rows: Array
    columns: Array
    factors: Array  # (rows, columns), by which entries are multiplied for that


def _scaled(matrix: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter]) -> _Scaled:
    points = check_points(parameters, SEED)
    in_balls = values_in_digits(matrix, resolved, parameters, points)
    values, terms, states = in_balls.values, in_balls.sizes, len(matrix.signals()[0])
    largest = np.max(np.abs(values), axis=0)
    rows, columns = _units(values)
    # smaller values are negligible beside what parameters change in the row and the column
    both = np.outer(rows, columns)
    least = NEGLIGIBLE * both
    scale = np.where(largest > 0.0, np.maximum(largest, least), both)
    own_scale = np.where(largest > 0.0, scale, or_one(np.max(terms, axis=0)))
    reference = Reference(
        values=values,
        scale=scale,
        omitted=0.0,
        if_cancelled=lambda: (scale, 0.0),
        conditioning=lambda: conditioning(values, terms, own_scale, least),
        trimmed=np.zeros((len(points), 0)),
        trim_scale=np.zeros(0),
        transfers=lambda some, frequencies: transfers(values[list(some)], states, frequencies),
        transfers_in_digits=lambda some, w: transfers_in_digits(in_balls, states, some, w),
    )
    factors = 1.0 / np.outer(rows, columns)
    return _Scaled(points, reference, rows, columns, factors)


def _units(values: Array) -> tuple[Array, Array]:
    """What parameters change in each row and column at most: values (N, rows, columns); Ruiz 2001."""
    change = np.max(np.abs(values - values[0]), axis=0)
    rows, columns = np.ones(len(change)), np.ones(change.shape[1])
    for _ in range(_SCALINGS):
        scaled = change / rows[:, None] / columns
        rows *= np.sqrt(or_one(np.max(scaled, axis=1)))
        columns *= np.sqrt(or_one(np.max(scaled, axis=0)))
    first, second = (np.ldexp(1.0, np.rint(np.log2(size)).astype(int)) for size in (rows, columns))
    return first, second


def _forms(matrix: MatrixProblem, resolved: Resolved, factors: Array) -> Iterator[Form]:
    """The divided matrix as it is written and expanded, from its rows and from its columns, where
    products meet in opposite orders.
    """
    for write in (written_matrix, expanded_matrix):
        form = write(matrix, resolved, factors)
        if form is None:
            continue
        for turned in (False, True):
            entries = form.matrix.T if turned else form.matrix
            known, nothing = ca.SX.sym("input", entries.shape[1]), ca.SX(0, 1)
            relations = LinearModel(
                nothing, entries @ known, nothing, known, form.q, tuple(matrix.parameters)
            )
            yield Form(relations, is_transposed=turned)
