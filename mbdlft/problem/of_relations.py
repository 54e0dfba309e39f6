"""Values of linear relations without any LFT: solved in doubles at many points, in balls at some."""

import operator
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import flint
import numpy as np

from mbdlft.base.array import Array
from mbdlft.base.errors import WellPosednessError
from mbdlft.base.parameter import Parameter, to_internal
from mbdlft.base.unit import parse_unit
from mbdlft.exact.matrices import entries_of
from mbdlft.exact.numbers import Field, constant_of, precision
from mbdlft.exact.rounding import conditioning
from mbdlft.problem.compare import NEGLIGIBLE, entry_scale
from mbdlft.problem.in_digits import Balls, transfers_of
from mbdlft.problem.linearize import LinearModel
from mbdlft.problem.problem import Reference
from mbdlft.problem.sx.constants import constants_in, in_doubles
from mbdlft.problem.sx.evaluate import evaluate_many
from mbdlft.problem.sx.fold import fold, rules
from mbdlft.problem.sx.sizes import term_sizes
from mbdlft.problem.transfers import Complex, implicit_transfers

_TOGETHER = 16  # points at a time: matrices of many equations are large
_BITS = 200  # 50 digits and what solving takes


def reference_of_relations(model: LinearModel, points: Array, owner: str) -> Reference:
    """Values [A B ; C D] of relations at physical points (N, n_p).

    Raises
    ------
    WellPosednessError
        The relations do not determine the unknown signals at one of the points.
    """
    internal = _internal_values(model, points)
    sizes = _Sizes(model.unknown.numel(), model.known.numel(), model.derivatives)
    slopes = _slopes(model)
    sparse = ca.sparsify(in_doubles(slopes))
    function = ca.Function("slopes", [model.p], [ca.densify(column_of_entries(sparse))])
    rows, columns = sparse.sparsity().get_triplet()

    entries = evaluate_many(function, internal)[0][:, :, 0]

    def spread(some: Array) -> Array:
        found = np.zeros((len(some), *slopes.shape))
        found[:, rows, columns] = some
        return found

    parts = [slice(k, k + _TOGETHER) for k in range(0, len(points), _TOGETHER)]
    values = np.concatenate([_solved(spread(entries[part]), sizes, owner)[0] for part in parts])
    scale = entry_scale(values, sizes.states)

    @cache
    def terms() -> Array:
        sums, found = term_sizes(function, internal), []
        for part in parts:
            jacobian, size = spread(entries[part]), spread(sums[part])
            found.append(_uncancelled(jacobian, size, sizes, owner))
        return np.concatenate(found)

    def coarse() -> tuple[Array, float]:
        return np.maximum(scale, np.max(terms(), axis=0)), 0.0

    def condition() -> tuple[float, int]:
        return conditioning(values, terms(), scale, NEGLIGIBLE * scale)

    def in_digits(some: Array) -> Array:
        return _in_digits(model, slopes, some, sizes).reshape(len(some), *values.shape[1:])

    def transfers_in_digits(some: Sequence[int], frequencies: Array) -> Complex:
        with precision(_BITS):
            found = list(_balls(model, slopes, points[list(some)], sizes))
            return transfers_of(found, sizes.states, frequencies)

    def transfers(some: Sequence[int], frequencies: Array) -> Complex:
        jacobian = spread(entries[list(some)])
        return implicit_transfers(jacobian, (*sizes[:2], sizes.states), frequencies)

    return Reference(
        values=values,
        scale=scale,
        omitted=0.0,
        if_cancelled=coarse,
        conditioning=condition,
        trimmed=np.zeros((len(points), 0)),
        trim_scale=np.zeros(0),
        transfers=transfers,
        transfers_in_digits=transfers_in_digits,
        in_digits=in_digits,
    )


def _internal_values(model: LinearModel, points: Array) -> Array:
    """Internal values (N, n_p) of physical ones."""
    found = np.empty((len(points), len(model.parameters)))
    for k, parameter in enumerate(model.parameters):
        found[:, k] = to_internal(parameter, points[:, k])
    return found


def _in_digits(model: LinearModel, slopes: ca.SX, points: Array, sizes: "_Sizes") -> Array:
    """[A B ; C D] in 50 digits, rounded at the end."""
    with precision(_BITS):
        return np.array(
            [[_rounded(x) for x in m.ravel()] for m in _balls(model, slopes, points, sizes)]
        )


def column_of_entries(matrix: ca.SX) -> ca.SX:
    """The entries (n, 1) of a sparse matrix that are not structural zeros, by columns."""
    return ca.vec(ca.SX(matrix.nz[:])) if matrix.nnz() else ca.SX(0, 1)


class _Sizes(NamedTuple):
    unknown: int
    known: int
    states: int


def _slopes(model: LinearModel) -> ca.SX:
    stacked = ca.vertcat(model.residual, model.output)
    return ca.SX(ca.jacobian(stacked, ca.vertcat(model.unknown, model.known)))


def _solved(jacobian: Array, sizes: _Sizes, owner: str) -> tuple[Array, Array]:
    n = sizes.unknown
    try:
        solved = -np.linalg.solve(jacobian[:, :n, :n], jacobian[:, :n, n:])
    except np.linalg.LinAlgError:
        raise WellPosednessError(
            f"{owner}: the equations do not determine the unknowns at a point of the parameter range. "
            "Narrow the ranges."
        ) from None
    # one step of refinement
    solved = solved - np.linalg.solve(
        jacobian[:, :n, :n], jacobian[:, :n, n:] + jacobian[:, :n, :n] @ solved
    )
    read = jacobian[:, n:, n:] + jacobian[:, n:, :n] @ solved
    return np.concatenate([solved[:, : sizes.states], read], axis=1), np.asarray(solved)


def _uncancelled(jacobian: Array, terms: Array, sizes: _Sizes, owner: str) -> Array:
    """Sizes of [A B ; C D] if nothing cancelled, neither in slopes nor in solving."""
    n = sizes.unknown
    _, solved = _solved(jacobian, sizes, owner)
    inverse = np.abs(np.linalg.inv(jacobian[:, :n, :n]))
    own = inverse @ (terms[:, :n, n:] + terms[:, :n, :n] @ np.abs(solved))
    read = terms[:, n:, n:] + terms[:, n:, :n] @ own
    return np.concatenate([own[:, : sizes.states], read], axis=1)


def _balls(model: LinearModel, slopes: ca.SX, points: Array, sizes: _Sizes) -> Iterator[Balls]:
    """[A B ; C D] at physical points, in balls."""
    sparse = ca.sparsify(slopes)
    constants, numbers = constants_in(sparse)
    field = Field(numbers)
    function = ca.Function("digits", [model.p, constants], [sparse])
    given = [field.of(number).ball for number in numbers]
    rows, columns = function.sparsity_out(0).get_triplet()
    n = sizes.unknown
    for point in points:
        p = [_internal(q, x) for q, x in zip(model.parameters, point, strict=True)]
        J = np.full(sparse.shape, flint.arb(0), dtype=object)
        for row, column, value in zip(
            rows, columns, fold(function, _RULES, p, given)[0], strict=True
        ):
            J[row, column] = value
        try:
            solved = -entries_of(_matrix(J[:n, :n]).solve(_matrix(J[:n, n:])))
        except ZeroDivisionError:
            raise WellPosednessError(
                "The equations are singular at one of the points that are checked in 50 digits."
            ) from None
        read = (
            J[n:, n:] + entries_of(_matrix(J[n:, :n]) * _matrix(solved))
            if len(J) > n
            else J[n:, n:]
        )
        yield np.concatenate([solved[: sizes.states], read])


def _internal(parameter: Parameter, physical: float) -> Any:
    """The internal value of a parameter, as a ball."""
    ball = flint.arb(float(physical))
    if not parameter.is_angle:
        return ball
    radians = ball * (
        flint.arb.pi() / 180 if parameter.unit == "deg" else parse_unit(parameter.unit).factor
    )
    return (
        (radians - parameter.reference) / (2 if parameter.substitution == "half-angle" else 4)
    ).tan()


def _rounded(x: Any) -> float:
    return 0.0 if x.contains(0) else float(x)


def _matrix(a: Balls) -> Any:
    n, m = a.shape
    return flint.arb_mat(n, m, a.ravel().tolist())


def _ball(value: float) -> Any:
    fraction = constant_of(value)
    return flint.arb(flint.fmpq(fraction.numerator, fraction.denominator))


_RULES = rules(_ball, add=operator.add, mul=operator.mul, div=operator.truediv)
