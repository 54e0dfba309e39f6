"""Values of a matrix problem without any LFT: balls of 50 digits, and what rounding changes in them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, WellPosednessError
from mbdlft.base.expression import Number
from mbdlft.base.parameter import Parameter
from mbdlft.exact.numbers import decimal, precision
from mbdlft.exact.operators import Operators
from mbdlft.matrix.expressions import Resolved, cosine_name, entry_place, matrix_values, sine_name
from mbdlft.matrix.problem import MatrixProblem
from mbdlft.problem.digits import BITS, Balls, ball, rounded, transfers_of

_MORE_BITS = 2400  # terms up to 1e308 may cancel to 1e-280, and 130 digits are left
_CLEAR = 100  # bits of an entry, of its `BITS`, that rounding of its terms has left
_LEAST = 1e-280  # of an entry: its rounding is a float, too


class MatrixValues(NamedTuple):
    """Values of a matrix at N points."""

    values: Array  # (N, rows, columns)
    sizes: Array  # (N, rows, columns), of the values if nothing cancelled in sums
    balls: Balls  # (N, rows, columns), the values before they are rounded


class Sized(Operators):
    """A value and its size; ``+ - * /`` as for numbers.

    The size of a number is its own. Sizes of terms add up; of two factors the one counts in which
    more cancelled. Rounding of all numbers changes the value by about 2.2e-16 of the size.
    """

    __slots__ = ("size", "value")
    __array_ufunc__ = None

    def __init__(self, value: Any, size: Any) -> None:
        self.value, self.size = value, size

    @staticmethod
    def of(number: Any) -> "Sized":
        """A number or array, of its own size."""
        return number if isinstance(number, Sized) else Sized(number, np.abs(number))

    def __add__(self, other: "Sized | float") -> "Sized":
        o = Sized.of(other)
        return Sized(self.value + o.value, self.size + o.size)

    def __neg__(self) -> "Sized":
        return Sized(-self.value, self.size)

    def __mul__(self, other: "Sized | float") -> "Sized":
        o = Sized.of(other)
        size = np.maximum(np.abs(self.value) * o.size, self.size * np.abs(o.value))
        return Sized(self.value * o.value, size)

    def __truediv__(self, other: "Sized | float") -> "Sized":
        o = Sized.of(other)
        if isinstance(o.value, float) and o.value == 0.0:
            raise SceneError("division by zero in a constant.")
        inverse = 1.0 / o.value
        return self * Sized(inverse, o.size * inverse * inverse)


def values_in_digits(
    problem: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter], points: Array
) -> MatrixValues:
    """The matrix at physical points (N, n_p), the numbers in its texts taken as decimals.

    Functions of constants and of angles have all digits, too. An entry that loses digits, as its terms
    cancel, is computed with more bits; if it may be zero then, it is.
    """
    balls = _in_balls(problem, resolved, parameters, points, BITS)
    lost = np.any(_bits_of(balls) < _CLEAR, axis=0)
    if np.any(lost):
        entries = tuple(
            tuple(entry if lost[i, j] else Number(0.0) for j, entry in enumerate(row))
            for i, row in enumerate(resolved.entries)
        )
        more = replace(resolved, entries=entries)
        again = _in_balls(problem, more, parameters, points, _MORE_BITS)
        balls = np.where(lost, again, balls)
    values = np.vectorize(rounded, otypes=[float])(balls)
    sizes = _sizes(problem, resolved, parameters, points)
    _check_sizes(problem, np.max(np.abs(values), axis=0), np.max(sizes, axis=0))
    return MatrixValues(values, sizes, balls)


def transfers_in_digits(
    values: MatrixValues, states: int, some: Sequence[int], frequencies: Array
) -> NDArray[np.complex128]:
    """Transfer functions (N, F, n_y, n_u) at some of the points; `frequencies` (F,) in rad/s."""
    with precision(BITS):
        return transfers_of([values.balls[k] for k in some], states, frequencies)


def _bits_of(balls: Balls) -> NDArray[np.int64]:
    """How many bits of balls are right; not above 0 where one may be zero and is not known to be."""
    bits = [min(int(x.rel_accuracy_bits()), _MORE_BITS) for x in balls.ravel()]
    return np.array(bits, dtype=np.int64).reshape(balls.shape)


def _in_balls(
    problem: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter], points: Array, bits: int
) -> Balls:
    """Values (N, ., .) with so many bits."""
    with precision(bits):
        known: dict[str, Any] = {k: ball(decimal(x)) for k, x in problem.constant_values().items()}
        known |= {"pi": flint.arb.pi(), "deg": flint.arb.pi() / 180}
        for k, p in enumerate(parameters):
            physical = np.array([flint.arb(x) for x in points[:, k].tolist()], dtype=object)
            known[p.name] = physical
            if p.is_angle:
                angles = physical * (known["deg"] if p.unit == "deg" else 1)
                known[cosine_name(p.name)] = np.array([x.cos() for x in angles], dtype=object)
                known[sine_name(p.name)] = np.array([x.sin() for x in angles], dtype=object)
        rows = matrix_values(problem, resolved, known, lambda x: ball(decimal(x)), _FUNCTIONS)
        balls = _stacked(rows, len(points), object)
    is_finite = np.vectorize(lambda x: x.is_finite() and abs(float(x)) < np.inf, otypes=[bool])(balls)
    if not np.all(is_finite):
        k, i, j = np.argwhere(~is_finite)[0]
        raise WellPosednessError(
            f"{entry_place(problem, i, j)}: is not finite at "
            f"{', '.join(f'{p.name} = {x:g}' for p, x in zip(parameters, points[k], strict=True))}."
        )
    return balls


_FUNCTIONS = {name: getattr(flint.arb, name) for name in ("cos", "sin", "atan", "sqrt")}


def _sizes(
    problem: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter], points: Array
) -> Array:
    """Sizes (N, ., .) of the entries if nothing cancelled but numbers."""
    known: dict[str, Any] = dict(problem.constant_values())
    for k, p in enumerate(parameters):
        known[p.name] = Sized.of(points[:, k])
        if p.is_angle:
            angle = points[:, k] * p.factor
            known[cosine_name(p.name)] = Sized.of(np.cos(angle))
            known[sine_name(p.name)] = Sized.of(np.sin(angle))
    with np.errstate(all="ignore"):
        rows = matrix_values(problem, resolved, known, float)
        return _stacked([[Sized.of(entry).size for entry in row] for row in rows], len(points), float)


def _check_sizes(problem: MatrixProblem, largest: Array, terms: Array) -> None:
    """Raise a SceneError if an entry is too small, or its terms too large, for a float."""
    for i, j in np.ndindex(problem.shape):
        if not np.isfinite(terms[i, j]) or 0.0 < largest[i, j] < _LEAST:
            raise SceneError(
                f"{entry_place(problem, i, j)} has the size {largest[i, j]:.3g}, and its terms "
                f"{terms[i, j]:.3g}. Expected at least {_LEAST:g}, or zero, and finite terms. Choose "
                "other units."
            )


def _stacked(rows: Sequence[Sequence[Any]], count: int, kind: type) -> NDArray[Any]:
    """Entries, one number or `count` of them each, as an array (count, rows, columns) of a kind."""
    entries: list[list[NDArray[Any]]] = [
        [np.broadcast_to(np.asarray(entry, dtype=kind), count) for entry in r] for r in rows
    ]
    return np.moveaxis(np.array(entries), 2, 0)
