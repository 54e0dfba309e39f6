"""Values of the nonlinear equations, and of linear relations, in 50 digits at a few points.

The instructions of the same functions as in doubles are followed in balls of FLINT, with the numbers of
the problem as they are written, and the equations are solved in balls, too. What may be zero is zero.
"""

import operator
from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.parameter import DIVISORS, Parameter, at_values
from mbdlft.exact.matrices import entries_of
from mbdlft.exact.numbers import Field, constant_of, precision
from mbdlft.problem.equations import Equations, ParameterSymbols, split
from mbdlft.problem.equations import rounded as in_doubles
from mbdlft.problem.linearization import slopes_at_rest
from mbdlft.problem.relations import LinearModel
from mbdlft.problem.sx.constants import constants_in, literal, pi_times
from mbdlft.problem.sx.tapes import fold, rules
from mbdlft.problem.trim import relations_at_rest, trim_rows

BITS = 200  # 50 digits and what solving takes

Balls = NDArray[np.object_]


class InDigits(NamedTuple):
    """Linear relations in 50 digits: slopes of [residual ; outputs] at a physical point, as balls."""

    slopes: Callable[[Array], Balls]
    parameters: Sequence[Parameter]
    unknown: int  # numbers of signals
    known: int
    states: int

    def matrices(self, points: Array) -> Array:
        """[A B ; C D] (N, ., .) at physical points (N, n_p), rounded at the end."""
        with precision(BITS):
            matrices = self._balls(points)
            values = np.array([[rounded(x) for x in matrix.ravel()] for matrix in matrices])
        return values.reshape(len(matrices), *matrices[0].shape)

    def transfers(self, points: Array, frequencies: Array) -> NDArray[np.complex128]:
        """Transfer functions (N, F, n_y, n_u) at physical points (N, n_p), frequencies (F,) in rad/s."""
        with precision(BITS):
            return transfers_of(self._balls(points), self.states, frequencies)

    def _balls(self, points: Array) -> list[Balls]:
        found = []
        for p in points:
            try:
                found.append(_state_space(self.slopes(p), self.unknown, self.known, self.states))
            except ZeroDivisionError:
                where = at_values(self.parameters, p)
                raise _singular(f" at {where}" if where else "") from None
        return found


def equations_in_digits(exact: Equations, inputs: Sequence[int], outputs: Sequence[int]) -> InDigits:
    """The exact equations of a scene, trimmed and linearized."""
    trim, tape = _tapes(exact, tuple(inputs), tuple(outputs))

    def slopes(point: Array) -> Balls:
        physical = [flint.arb(float(x)) for x in point]
        return tape.at(physical + _efforts(exact, trim, physical))[0]

    unknown, known = (signals.numel() for signals in split(exact, inputs))
    return InDigits(slopes, exact.parameters, unknown, known, len(exact.states))


def relations_in_digits(m: LinearModel, slopes: ca.SX) -> InDigits:
    """Linear relations, whose slopes by unknown and known signals are given."""
    tape = _tape(m.p, slopes)

    def at(point: Array) -> Balls:
        return tape.at([_internal(*pair) for pair in zip(m.parameters, point, strict=True)])[0]

    return InDigits(at, m.parameters, m.unknown.numel(), m.known.numel(), m.derivatives)


def nonlinear_in_digits(
    slopes: ca.SX,
    at: tuple[ca.SX, ca.SX],
    p: ca.SX,
    parameters: Sequence[Parameter],
    sizes: Sequence[int],
) -> InDigits:
    """Nonlinear equations, by their slopes at values that are functions of p, those of angles in rad.

    `at` are the symbols of the values and the values; `sizes` are numbers of unknowns, known signals and
    states.
    """
    symbols, values = at
    trim, tape = _tape(p, values), _tape(ca.vertcat(symbols, p), slopes)

    def slopes_at(point: Array) -> Balls:
        physical = [_radians(*pair) for pair in zip(parameters, point, strict=True)]
        (J,) = tape.at([*trim.at(physical)[0][:, 0], *physical])
        if not all(x.is_finite() for x in J.ravel()):
            raise ZeroDivisionError
        return J

    return InDigits(slopes_at, parameters, *sizes)


def number_in_digits(value: ca.SX) -> Any:
    """An expression of constants, a scalar, as a ball."""
    with precision(BITS):
        return _tape(ca.SX(0, 1), ca.densify(value)).at([])[0][0, 0]


def _radians(parameter: Parameter, physical: float) -> Any:
    """The value of a parameter as a ball, of angles in rad."""
    value = flint.arb(float(physical))
    if not parameter.is_angle:
        return value
    return value * (flint.arb.pi() / 180 if parameter.unit == "deg" else parameter.factor)


def _internal(parameter: Parameter, physical: float) -> Any:
    """The internal value of a parameter, as a ball."""
    value = _radians(parameter, physical)
    if not parameter.is_angle:
        return value
    return ((value - parameter.reference) / DIVISORS[parameter.substitution]).tan()


def transfers_of(matrices: Sequence[Balls], states: int, frequencies: Array) -> NDArray[np.complex128]:
    """Transfer functions (N, F, n_y, n_u) of N matrices [A B ; C D] of balls, rounded at the end."""
    values = []
    for rows in matrices:
        right = _matrix(rows[:states, states:], flint.acb_mat)
        read, direct = _matrix(rows[states:, :states], flint.acb_mat), rows[states:, states:]
        for w in frequencies:
            shifted = rows[:states, :states].copy()
            shifted[np.arange(states), np.arange(states)] -= flint.acb(0, float(w))
            try:
                solved = _matrix(shifted, flint.acb_mat).solve(right)
            except ZeroDivisionError:
                raise _singular(f" at omega = {w:g} rad/s") from None
            values.append([rounded(x) for x in (direct - entries_of(read * solved)).ravel()])
    shape = (len(matrices), len(frequencies), *matrices[0][states:, states:].shape)
    return np.array(values, dtype=complex).reshape(shape)


def rounded(x: Any) -> float | complex:
    """A ball as a number; what may be zero is zero."""
    return 0.0 if x.contains(0) else complex(x) if isinstance(x, flint.acb) else float(x)


def efforts_in_digits(
    exact: Equations, inputs: Sequence[int], outputs: Sequence[int], points: Array
) -> Array:
    """Efforts (N, n) that the trim solves for at physical points (N, n_p), rounded at the end."""
    trim, _ = _tapes(exact, tuple(inputs), tuple(outputs))
    with precision(BITS):
        every = [_efforts(exact, trim, [flint.arb(float(x)) for x in point]) for point in points]
    return np.array([[rounded(efforts[k]) for k in exact.unknown] for efforts in every])


def _state_space(J: Balls, unknown: int, known: int, states: int) -> Balls:
    """[A B ; C D] of slopes of [residual ; outputs] by unknown and known signals."""
    solved = -_solved(J[:unknown, :unknown], J[:unknown, unknown : unknown + known])
    read = J[unknown:, unknown : unknown + known] + _times(J[unknown:, :unknown], solved)
    return np.concatenate([solved[:states], read])


def _singular(where: str) -> WellPosednessError:
    return WellPosednessError(f"the equations are singular{where}, in 50 digits.")


class _Tape(NamedTuple):
    """Functions of one argument and of constants, and the balls of these."""

    function: ca.Function
    constants: list[Any]

    def at(self, argument: list[Any]) -> list[Balls]:
        """Values, dense arrays."""
        results = []
        for k, values in enumerate(fold(self.function, _RULES, argument, self.constants)):
            array = np.full(self.function.size_out(k), flint.arb(0), dtype=object)
            rows, columns = self.function.sparsity_out(k).get_triplet()
            for row, column, value in zip(rows, columns, values, strict=True):
                array[row, column] = value
            results.append(array)
        return results


@lru_cache(maxsize=2)  # for matrices, and again for transfers
def _tapes(exact: Equations, inputs: tuple[int, ...], outputs: tuple[int, ...]) -> tuple[_Tape, _Tape]:
    """Parameters to the relations of the trim, and parameters and efforts to slopes at rest."""
    symbols = physical_in_digits(exact)
    trim = _tape(symbols[0], relations_at_rest(exact, symbols))
    parameters, effort, slopes, _ = slopes_at_rest(exact, symbols, inputs, outputs)
    return trim, _tape(ca.vertcat(parameters, effort), slopes)


def _tape(argument: ca.SX, expressions: ca.SX | Sequence[ca.SX]) -> _Tape:
    results = [expressions] if isinstance(expressions, ca.SX) else expressions
    sparse = [ca.sparsify(e) for e in results]
    constants, numbers = constants_in(ca.veccat(*sparse))
    field = Field(numbers)
    function = ca.Function("digits", [argument, constants], sparse)
    with precision(BITS):
        return _Tape(function, [field.of(number).ball for number in numbers])


def physical_in_digits(exact: Equations) -> ParameterSymbols:
    """Symbols of physical values, and arguments p, cosine, sine: the factors of units not rounded."""
    p = ca.SX.sym("p", len(exact.parameters))
    angles = ca.SX(p.numel(), 1)
    for k, parameter in enumerate(exact.parameters):
        if parameter.is_angle:
            unit = parameter.factor
            is_deg = parameter.unit == "deg"
            angles[k] = p[k] * (pi_times(Fraction(1, 180)) if is_deg else literal(unit))
    return ParameterSymbols(p, p, ca.cos(angles), ca.sin(angles))


def _efforts(exact: Equations, trim: _Tape, physical: list[Any]) -> list[Any]:
    """Trim values of u."""
    offset, matrix, known = trim.at(physical)
    rows, unknown = list(trim_rows(in_doubles(exact))), list(exact.unknown)
    efforts = [x for (x,) in known]
    if unknown:
        solution = -_solved(matrix[rows], offset[rows])
        for k, (value,) in zip(unknown, solution, strict=True):
            efforts[k] = value
    return efforts


def ball(value: Fraction) -> Any:
    """The ball around a fraction, in the bits of the context."""
    return flint.arb(flint.fmpq(value.numerator, value.denominator))


def _decided(compare: Callable[[Any, Any], bool]) -> Callable[[Any, Any], Any]:
    """One or zero by the middles of two balls."""
    return lambda a, b: flint.arb(int(compare(a.mid(), b.mid())))


_METHODS = (
    *("sin", "cos", "tan", "sinh", "cosh", "tanh", "asin", "acos", "atan", "asinh", "acosh", "atanh"),
    *("exp", "expm1", "log", "log1p", "sqrt"),
)
_OTHERS: dict[str, Callable[..., Any]] = {
    **{name: operator.methodcaller(name) for name in _METHODS},
    **{name: _decided(getattr(operator, name)) for name in ("lt", "le", "eq", "ne")},
    **{"pow": operator.pow, "constpow": operator.pow, "fabs": abs},
    **{
        "not": lambda a: flint.arb(int(a == 0)),
        "and": operator.mul,
        "or": lambda a, b: b if a == 0 else a,
    },
    "if_else_zero": lambda a, b: a if a == 0 else b,
    "sign": lambda a: flint.arb(int(a.mid() > 0) - int(a.mid() < 0)),
    "fmin": lambda a, b: a if a.mid() <= b.mid() else b,
    "fmax": lambda a, b: a if a.mid() >= b.mid() else b,
}
_RULES = rules(
    lambda value: ball(constant_of(value)),
    add=operator.add,
    mul=operator.mul,
    div=operator.truediv,
    **_OTHERS,
)


def _solved(matrix: Balls, right: Balls) -> Balls:
    return entries_of(_matrix(matrix).solve(_matrix(right)))


def _times(a: Balls, b: Balls) -> Balls:
    if 0 in a.shape:
        return np.full((len(a), b.shape[1]), flint.arb(0), dtype=object)
    return entries_of(_matrix(a) * _matrix(b))


def _matrix(a: Balls, kind: Any = flint.arb_mat) -> Any:
    n, m = a.shape
    return kind(n, m, a.ravel().tolist())
