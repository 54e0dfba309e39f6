"""The nonlinear equations trimmed and linearized in 50 digits, at a few points.

The instructions of the same functions as in `relinearize` are followed in balls of FLINT, with the
numbers of the scene as they are written, and the equations are solved in balls, too.
"""

import operator
from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.unit import parse_unit
from mbdlft.exact.matrices import entries_of
from mbdlft.exact.numbers import Field, constant_of, precision
from mbdlft.problem.equations import Equations, rounded, split
from mbdlft.problem.linearization import slopes_at_trim
from mbdlft.problem.sx.constants import constants_in, literal, pi_times
from mbdlft.problem.sx.tapes import fold, rules
from mbdlft.problem.trim import relations_at_rest, trim_rows

_BITS = 200  # 50 digits and what solving takes

Balls = NDArray[np.object_]


def matrices_in_digits(
    exact: Equations, inputs: Sequence[int], outputs: Sequence[int], points: Array
) -> Array:
    """[A B ; C D] (N, ., .) of the exact equations at physical points (N, n_p), rounded at the end.

    What may be zero is zero.

    Raises
    ------
    WellPosednessError
        The equations cannot be solved at one of the points.
    """
    with precision(_BITS):
        found = [
            [_rounded(x) for x in part.ravel()] for part in _balls(exact, inputs, outputs, points)
        ]
    return np.array(found).reshape(len(points), len(exact.states) + len(outputs), -1)


def transfers_in_digits(
    exact: Equations,
    inputs: Sequence[int],
    outputs: Sequence[int],
    points: Array,
    frequencies: Array,
) -> NDArray[np.complex128]:
    """Transfer functions (N, F, n_y, n_u) of the exact equations, rounded at the end.

    `points` (N, n_p) are physical, `frequencies` (F,) in rad/s. What may be zero is zero.

    Raises
    ------
    WellPosednessError
        The equations cannot be solved at one of the points or frequencies.
    """
    with precision(_BITS):
        found = _balls(exact, inputs, outputs, points)
        return transfers_of(found, len(exact.states), frequencies)


def transfers_of(
    matrices: Sequence[Balls], states: int, frequencies: Array
) -> NDArray[np.complex128]:
    """Transfer functions (N, F, n_y, n_u) of N matrices [A B ; C D] of balls, rounded at the end.

    Raises
    ------
    WellPosednessError
        A frequency (rad/s) may be a pole.
    """
    found = []
    for rows in matrices:
        right = _matrix(rows[:states, states:], flint.acb_mat)
        read, direct = _matrix(rows[states:, :states], flint.acb_mat), rows[states:, states:]
        for w in frequencies:
            shifted = rows[:states, :states].copy()
            shifted[np.arange(states), np.arange(states)] -= flint.acb(0, float(w))
            try:
                solved = _matrix(shifted, flint.acb_mat).solve(right)
            except ZeroDivisionError:
                raise _singular() from None
            found.append([_rounded(x) for x in (direct - entries_of(read * solved)).ravel()])
    shape = (len(matrices), len(frequencies), *matrices[0][states:, states:].shape)
    return np.array(found, dtype=complex).reshape(shape)


def _rounded(x: Any) -> float | complex:
    """A ball as a number; what may be zero is zero."""
    return 0.0 if x.contains(0) else complex(x) if isinstance(x, flint.acb) else float(x)


def _balls(
    exact: Equations, inputs: Sequence[int], outputs: Sequence[int], points: Array
) -> list[Balls]:
    """[A B ; C D] of the exact equations at physical points (N, n_p)."""
    tapes = _tapes(exact, tuple(inputs), tuple(outputs))
    return [_matrices(exact, tapes, J) for J in _slopes(exact, tapes, points)]


def _slopes(exact: Equations, tapes: "_Tapes", points: Array) -> Iterator[Balls]:
    """Slopes of [residual ; outputs] by unknown and known signals, at physical points (N, n_p)."""
    for at in points:
        physical = [flint.arb(float(x)) for x in at]
        try:
            (J,) = tapes.slopes.at(physical + _efforts(exact, tapes.trim, physical))
        except ZeroDivisionError:
            raise _singular() from None
        yield J


def _singular() -> WellPosednessError:
    return WellPosednessError(
        "The equations are singular at one of the points that are checked in 50 digits."
    )


class _Tape(NamedTuple):
    """Functions of one argument and of constants, and the balls of these."""

    function: ca.Function
    constants: list[Any]

    def at(self, argument: list[Any]) -> list[Balls]:
        """Values, dense arrays."""
        found = []
        for k, values in enumerate(fold(self.function, _RULES, argument, self.constants)):
            array = np.full(self.function.size_out(k), flint.arb(0), dtype=object)
            rows, columns = self.function.sparsity_out(k).get_triplet()
            for row, column, value in zip(rows, columns, values, strict=True):
                array[row, column] = value
            found.append(array)
        return found


class _Tapes(NamedTuple):
    """Parameters to the relations of the trim, and parameters and efforts to slopes at rest."""

    trim: _Tape
    slopes: _Tape
    unknown: int
    known: int


@lru_cache(maxsize=2)  # for matrices, and again for transfers
def _tapes(exact: Equations, inputs: tuple[int, ...], outputs: tuple[int, ...]) -> _Tapes:
    symbols = physical_in_digits(exact)
    trim = _tape(symbols[0], relations_at_rest(exact, symbols))
    slopes = _tape(*slopes_at_trim(exact, symbols, inputs, outputs))
    unknown, known = (part.numel() for part in split(exact, inputs))
    return _Tapes(trim, slopes, unknown, known)


def _tape(argument: ca.SX, expressions: ca.SX | Sequence[ca.SX]) -> _Tape:
    parts = [expressions] if isinstance(expressions, ca.SX) else expressions
    sparse = [ca.sparsify(e) for e in parts]
    constants, numbers = constants_in(ca.veccat(*sparse))
    field = Field(numbers)
    function = ca.Function("digits", [argument, constants], sparse)
    return _Tape(function, [field.of(number).ball for number in numbers])


def physical_in_digits(exact: Equations) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Symbols of physical values, and arguments p, cosine, sine: the factors of units not rounded."""
    p = ca.SX.sym("p", len(exact.parameters))
    angles = ca.SX(p.numel(), 1)
    for k, parameter in enumerate(exact.parameters):
        if parameter.is_angle:
            unit = parse_unit(parameter.unit).factor
            is_deg = parameter.unit == "deg"
            angles[k] = p[k] * (pi_times(Fraction(1, 180)) if is_deg else literal(unit))
    return p, p, ca.cos(angles), ca.sin(angles)


def _matrices(exact: Equations, tapes: _Tapes, J: Balls) -> Balls:
    """[A B ; C D] at one point, of the slopes there."""
    unknown, known = tapes.unknown, tapes.known
    try:
        solved = -_solved(J[:unknown, :unknown], J[:unknown, unknown : unknown + known])
    except ZeroDivisionError:
        raise _singular() from None
    read = J[unknown:, unknown : unknown + known] + _times(J[unknown:, :unknown], solved)
    return np.concatenate([solved[: len(exact.states)], read])


def _efforts(exact: Equations, trim: _Tape, physical: list[Any]) -> list[Any]:
    """Trim values of u."""
    offset, matrix, given = trim.at(physical)
    rows, unknown = list(trim_rows(rounded(exact))), list(exact.unknown)
    found = [x for (x,) in given]
    if unknown:
        solution = -_solved(matrix[rows], offset[rows])
        for k, (value,) in zip(unknown, solution, strict=True):
            found[k] = value
    return found


def _ball(value: float) -> Any:
    fraction = constant_of(value)
    return flint.arb(flint.fmpq(fraction.numerator, fraction.denominator))


_RULES = rules(
    _ball,
    add=operator.add,
    mul=operator.mul,
    div=operator.truediv,
    sin=lambda x: x.sin(),
    cos=lambda x: x.cos(),
    sqrt=lambda x: x.sqrt(),
)


def _solved(matrix: Balls, right: Balls) -> Balls:
    return entries_of(_matrix(matrix).solve(_matrix(right)))


def _times(left: Balls, right: Balls) -> Balls:
    if 0 in left.shape:
        return np.full((len(left), right.shape[1]), flint.arb(0), dtype=object)
    return entries_of(_matrix(left) * _matrix(right))


def _matrix(a: Balls, kind: Any = flint.arb_mat) -> Any:
    n, m = a.shape
    return kind(n, m, a.ravel().tolist())
