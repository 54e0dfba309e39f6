"""Values of a matrix problem without any LFT: in 50 digits, and what rounding of its numbers changes."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from decimal import Context, Decimal, getcontext, localcontext
from fractions import Fraction
from functools import cache, partial
from typing import Any, NamedTuple

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import SceneError, WellPosednessError
from mbdlft.base.expression import FUNCTIONS, Call, Number, evaluate
from mbdlft.base.parameter import Parameter
from mbdlft.base.unit import parse_unit
from mbdlft.exact.numbers import precision
from mbdlft.exact.operators import Operators
from mbdlft.matrix.expressions import Resolved, cosine_name, entry_place, matrix_values, sine_name
from mbdlft.matrix.problem import MatrixProblem
from mbdlft.problem.digits import transfers_of

_BITS_OF_A_DIGIT = 3.33
_BITS_OF_DIGITS = 150  # a little less than 50 digits
_LEAST = 1e-280  # of an entry: its rounding is a float, too
_DIGITS = Context(prec=50, traps=[])  # what is not finite has its own message
_NOISE = 1e-40  # of its terms, of a value in 50 digits that may be nothing but their rounding
_MORE = Context(prec=700, traps=[])  # rounding of terms up to 1e308 is no double any more


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
        if isinstance(o.value, float) and o.value == 0.0:
            raise SceneError("division by zero in a constant.")
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
    digits = _in_digits(problem, resolved, parameters, points, _DIGITS)
    values = digits.astype(float)
    sizes = _sizes(problem, resolved, parameters, points)
    terms = _sizes(problem, resolved, parameters, points, with_constants=True)
    largest, most = (np.max(np.abs(part), axis=0) for part in (values, terms))
    lost = (largest <= _NOISE * most) & (most > 0.0) & np.isfinite(most)
    if np.any(lost):
        zero = Number(0.0)
        rest = tuple(
            tuple(entry if lost[i, j] else zero for j, entry in enumerate(row))
            for i, row in enumerate(resolved.entries)
        )
        again = _in_digits(problem, replace(resolved, entries=rest), parameters, points, _MORE)
        again[again.astype(float) == 0.0] = Decimal(0)
        digits = np.where(lost, again, digits)
        values = digits.astype(float)
    _check_sizes(problem, np.max(np.abs(values), axis=0), most)
    return MatrixValues(values, sizes, digits)


def _sizes(
    problem: MatrixProblem,
    resolved: Resolved,
    parameters: Sequence[Parameter],
    points: Array,
    *,
    with_constants: bool = False,
) -> Array:
    """Sizes (N, ., .) of the entries if nothing cancelled, also not in constants or in these only."""
    known: dict[str, Any] = dict(problem.constant_values())
    for k, p in enumerate(parameters):
        known[p.name] = points[:, k]
        if p.is_angle:
            angle = points[:, k] * parse_unit(p.unit).factor
            known[cosine_name(p.name)], known[sine_name(p.name)] = np.cos(angle), np.sin(angle)
    parts = {
        name: Sized.of(value) if with_constants or isinstance(value, np.ndarray) else value
        for name, value in known.items()
    }
    number, functions = (Sized.of, _SIZED_FUNCTIONS) if with_constants else (float, {})
    with np.errstate(all="ignore"):
        rows = matrix_values(problem, resolved, parts, number, functions)
        return _stacked(
            [[Sized.of(entry).size for entry in row] for row in rows], len(points), float
        )


def _in_digits(
    problem: MatrixProblem,
    resolved: Resolved,
    parameters: Sequence[Parameter],
    points: Array,
    context: Context,
) -> NDArray[Any]:
    """Values (N, ., .) with the digits of a context."""
    with localcontext(context):
        known = {name: _decimals(value) for name, value in problem.constant_values().items()}
        known |= _pi(context.prec)
        for k, p in enumerate(parameters):
            known[p.name] = _decimals(points[:, k])
            if p.is_angle:
                turns = known[p.name] * (known["deg"] if p.unit == "deg" else Decimal(1))
                known[cosine_name(p.name)] = np.array([_cosine(x) for x in turns], dtype=object)
                known[sine_name(p.name)] = np.array([_sine(x) for x in turns], dtype=object)
        entries = matrix_values(problem, resolved, known, _decimals, _FUNCTIONS)
        found = _stacked(entries, len(points), object)
        values = found.astype(float)
    if not np.all(np.isfinite(values)):
        k, i, j = np.argwhere(~np.isfinite(values))[0]
        raise WellPosednessError(
            f"{entry_place(problem, i, j)}: is not finite at "
            f"{', '.join(f'{p.name} = {x:g}' for p, x in zip(parameters, points[k], strict=True))}."
        )
    return found


def _sized_function(function: str, of: Sized) -> Sized:
    """A function of a constant, in its own size."""
    return Sized.of(evaluate(Call(function, Number(of.value)), {}))


_SIZED_FUNCTIONS = {function: partial(_sized_function, function) for function in FUNCTIONS}


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
    """A function in ten digits more than the context has, by FLINT."""
    digits = getcontext().prec + 10
    with precision(int(_BITS_OF_A_DIGIT * digits) + 40):
        ball = function(_ball(value))
        return Decimal(ball.mid().str(digits, radius=False))


_cosine = partial(_by_arb, lambda x: x.cos())
_sine = partial(_by_arb, lambda x: x.sin())
_FUNCTIONS: dict[str, Callable[[Decimal], Decimal]] = {
    "cos": _cosine,
    "sin": _sine,
    "atan": partial(_by_arb, lambda x: x.atan()),
    "sqrt": partial(_by_arb, lambda x: x.sqrt()),
}


@cache
def _pi(digits: int) -> dict[str, Decimal]:
    """What is known by name, in the context with so many digits."""
    with localcontext(Context(prec=digits, traps=[])):
        eighth = _by_arb(lambda x: x.atan(), Decimal(1))
        return {"pi": 4 * eighth, "deg": eighth / 45}


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
