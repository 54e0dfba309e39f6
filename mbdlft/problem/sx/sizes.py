"""Sizes of terms as a number system: what the results of a function would be if nothing cancelled."""

from typing import Any

import casadi as ca
import numpy as np

from mbdlft.base.array import Array
from mbdlft.exact.operators import FUNCTIONS_OF_DOUBLES
from mbdlft.problem.sx.fold import Rule, fold, rules

Pair = tuple[Any, Any]  # a value and its size: numbers (N,), or one for all points


def term_sizes(tape: ca.Function, *points: Array) -> Array:
    """Sizes (N, entries) of the dense result of a function if nothing cancelled: |a| + |b| for a + b.

    The arguments are columns, each (N, rows); the columns of a result stand one below the other. A root
    has the root of the size; another function of a number has the size of its own value.
    """
    arguments = [[_of_itself(x) for x in np.ascontiguousarray(part.T)] for part in points]
    found = np.empty((tape.numel_out(0), len(points[0])))
    for row, (_, size) in zip(found, fold(tape, _SIZES, *arguments)[0], strict=True):
        row[:] = size
    return found.T


def _of_itself(value: Any) -> Pair:
    return value, np.abs(value)


def _function(values: Rule) -> Rule:
    return lambda *pairs: _of_itself(values(*(value for value, _ in pairs)))


_SIZES = rules(
    lambda value: _of_itself(np.float64(value)),
    add=lambda x, y: (x[0] + y[0], x[1] + y[1]),
    neg=lambda x: (-x[0], x[1]),
    mul=lambda x, y: (x[0] * y[0], x[1] * y[1]),
    div=lambda x, y: (x[0] / y[0], x[1] * y[1] / (y[0] * y[0])),
    **{name: _function(values) for name, values in FUNCTIONS_OF_DOUBLES.items()}
    | {
        "fabs": lambda x: (np.abs(x[0]), x[1]),
        "sqrt": lambda x: (np.sqrt(x[0]), np.sqrt(x[1])),
    },
)
