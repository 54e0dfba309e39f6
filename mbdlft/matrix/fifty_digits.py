"""Values of a matrix problem without any LFT: in 50 digits, and what rounding of its numbers changes."""

from collections.abc import Callable, Sequence
from decimal import Context, Decimal, localcontext
from fractions import Fraction
from functools import partial
from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, WellPosednessError
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import parse_unit
from mbdlft.matrix.problem import MatrixProblem
from mbdlft.matrix.resolve import Resolved, cosine_name, entry_place, matrix_values, sine_name
from mbdlft.number.exact import precision
from mbdlft.number.operators import Operators
from mbdlft.problem.in_digits import transfers_of

_BITS = 240
_BITS_OF_DIGITS = 150  # a little less than 50 digits
_LEAST = 1e-280  # of an entry: its rounding is a float, too
_DIGITS = Context(prec=50, traps=[])  # what is not finite has its own message


class MatrixValues(NamedTuple):
    """Values of a matrix at N points.

    Attributes
    ----------
    values : array (N, rows, columns)
    sizes : array (N, rows, columns)
        Of the values if nothing cancelled in sums.
    digits : object array (N, rows, columns)
        The values before they are rounded: decimals of 50 digits.
    """

    values: Array
    sizes: Array
    digits: NDArray[np.object_]


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
        inverse = 1.0 / o.value
        return self * Sized(inverse, o.size * inverse * inverse)


def values_in_digits(
    problem: MatrixProblem, resolved: Resolved, parameters: Sequence[Parameter], points: Array
) -> MatrixValues:
    """The matrix at physical points (N, n_p), the numbers in its texts taken as decimals.

    Functions of constants and of angles have all digits, too.

    Raises
    ------
    SceneError
        An entry is too small for a float, or its terms are too large.
    WellPosednessError
        A value is not finite.
    """
    known: dict[str, Any] = dict(problem.constant_values())
    for k, p in enumerate(parameters):
        if p.is_angle:
            angle = points[:, k] * parse_unit(p.unit).factor
            known[cosine_name(p.name)], known[sine_name(p.name)] = np.cos(angle), np.sin(angle)
        else:
            known[p.name] = points[:, k]
    with localcontext(_DIGITS), np.errstate(all="ignore"):
        digits = {name: _decimals(value) for name, value in known.items()} | _PI
        for k, p in enumerate(parameters):
            if p.is_angle:
                turns = _decimals(points[:, k]) * (_PI["deg"] if p.unit == "deg" else Decimal(1))
                digits[cosine_name(p.name)] = np.array([_cosine(x) for x in turns], dtype=object)
                digits[sine_name(p.name)] = np.array([_sine(x) for x in turns], dtype=object)
        entries = matrix_values(problem, resolved, digits, _decimals, _FUNCTIONS)
        digits_of = _stacked(entries, len(points), object)
        values = digits_of.astype(float)
        parts = {name: Sized.of(v) if isinstance(v, np.ndarray) else v for name, v in known.items()}
        rows = matrix_values(problem, resolved, parts)
        sizes = [[Sized.of(entry).size for entry in row] for row in rows]
    if not np.all(np.isfinite(values)):
        k, i, j = np.argwhere(~np.isfinite(values))[0]
        raise WellPosednessError(
            f"{entry_place(problem, i, j)}: is not finite at "
            f"{', '.join(f'{p.name} = {x:g}' for p, x in zip(parameters, points[k], strict=True))}."
        )
    found = MatrixValues(values, _stacked(sizes, len(points), float), digits_of)
    _check_sizes(problem, *(np.max(np.abs(part), axis=0) for part in found[:2]))
    return found


def transfers_in_digits(
    values: MatrixValues, states: int, some: Sequence[int], frequencies: Array
) -> NDArray[np.complex128]:
    """Transfer functions (N, F, n_y, n_u) at some of the points; `frequencies` (F,) in rad/s.

    What is no more than the last of the 50 digits of its terms is exactly zero.
    """
    with precision(_BITS_OF_DIGITS):
        matrices = [
            np.array([[_ball(x) for x in row] for row in values.digits[k]], dtype=object)
            for k in some
        ]
        return transfers_of(matrices, states, frequencies)


def _ball(value: Any) -> Any:
    fraction = Fraction(value)
    return flint.arb(flint.fmpq(fraction.numerator, fraction.denominator))


def _by_arb(function: Callable[[Any], Any], value: Decimal) -> Decimal:
    """A function in 60 digits, by FLINT."""
    fraction = Fraction(value)
    with precision(_BITS):
        ball = function(flint.arb(flint.fmpq(fraction.numerator, fraction.denominator)))
        return Decimal(ball.mid().str(60, radius=False))


_cosine = partial(_by_arb, lambda x: x.cos())
_sine = partial(_by_arb, lambda x: x.sin())
_FUNCTIONS: dict[str, Callable[[Decimal], Decimal]] = {
    "cos": _cosine,
    "sin": _sine,
    "atan": partial(_by_arb, lambda x: x.atan()),
    "sqrt": partial(_by_arb, lambda x: x.sqrt()),
}
_PI = {"pi": _by_arb(lambda x: 4 * x.atan(), Decimal(1))}
_PI["deg"] = _by_arb(lambda x: x.atan() / 45, Decimal(1))


def _check_sizes(problem: MatrixProblem, largest: Array, terms: Array) -> None:
    """Raise a SceneError if an entry is too small, or its terms too large, for a float."""
    for i, j in np.ndindex(problem.shape):
        if not np.isfinite(terms[i, j]) or 0.0 < largest[i, j] < _LEAST:
            raise SceneError(
                f"{entry_place(problem, i, j)} has the size {largest[i, j]:.3g}, and its terms "
                f"{terms[i, j]:.3g}. Expected at least {_LEAST:g}, or zero, and finite terms. Choose "
                "other units."
            )


def _decimals(value: Any) -> Any:
    """A number of a text as the decimal it prints as, or an array of floats in all their digits."""
    if isinstance(value, np.ndarray):
        return np.array([Decimal(item) for item in value.tolist()], dtype=object)
    return Decimal(repr(value))


def _stacked(rows: Sequence[Sequence[Any]], count: int, kind: type) -> NDArray[Any]:
    """Entries, one number or `count` of them each, as an array (count, rows, columns) of a kind."""
    entries: list[list[NDArray[Any]]] = [
        [np.broadcast_to(np.asarray(entry, dtype=kind), count) for entry in r] for r in rows
    ]
    return np.moveaxis(np.array(entries), 2, 0)
