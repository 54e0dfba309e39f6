"""Whether the units of the equations of a DAE fit: they are followed with dimensions for numbers."""

from collections.abc import Mapping
from typing import Any

import casadi as ca

from mbdlft.base.errors import SceneError
from mbdlft.base.unit import dimension_name, parse_unit
from mbdlft.dae.description import Dae
from mbdlft.dae.operations import column_of
from mbdlft.exact.operators import FUNCTIONS_OF_DIMENSIONS, Dimension
from mbdlft.problem.sx.constants import is_constant
from mbdlft.problem.sx.tapes import Rules, fold, rules


class _Any:
    """A number that may carry any unit, also times another quantity, as a literal in Modelica."""


_OPEN = _Any()
_Value = Any  # a Dimension, or _OPEN


def check_units(dae: Dae) -> None:
    """What is added, and what is the argument of a function, has units that fit; factors are no matter.

    A plain number may carry any unit, and so may a quantity in "1", whose unit is not given; one in
    "rad" or "%" is dimensionless.

    Raises
    ------
    SceneError
        They do not fit; the message names the equation.
    """
    second = Dimension(parse_unit("s").dimension)
    given = {v.symbol.element_hash(): open_unit(v.unit) for v in (*dae.variables, *dae.inputs)}
    for v in dae.variables:
        if v.derivative is not None:
            given[v.derivative.element_hash()] = _over(open_unit(v.unit), second)
    for p, symbol in zip(dae.parameters, ca.vertsplit(dae.p), strict=True):
        given[symbol.element_hash()] = open_unit(p.unit)
    parts = [(f"equation {e.place}", e.residual, e.unit) for e in (*dae.equations, *dae.initial)]
    parts += [(f"output {y.name!r}", y.expression, y.unit) for y in dae.outputs]
    for what, expression, unit in parts:
        try:
            found = dimension_of(expression, given)
            if unit is not None:
                _add(found, open_unit(unit))
        except SceneError as error:
            raise SceneError(
                f"{dae.owner}, {what}: {error} A 1 or 2 that has a unit is written d.number(1)."
            ) from None


def open_unit(unit: str) -> _Value:
    """The dimension of a unit; that of "1" is open."""
    return _OPEN if unit == "1" else Dimension(parse_unit(unit).dimension)


def dimension_of(expression: ca.SX, given: Mapping[int, _Value]) -> _Value:
    """The dimension of an expression of symbols that have some, by their hashes."""
    free = ca.symvar(expression)
    values = [_OPEN if is_constant(s) else given[s.element_hash()] for s in free]
    function = ca.Function("units", [column_of(free)], [ca.densify(expression)])
    ((found,),) = fold(function, _RULES, values)
    return found


def _add(a: _Value, b: _Value) -> _Value:
    if a is _OPEN:
        return b
    return a if b is _OPEN else a + b


def _times(a: _Value, b: _Value) -> _Value:
    return _OPEN if a is _OPEN or b is _OPEN else a * b


def _over(a: _Value, b: _Value) -> _Value:
    return _OPEN if a is _OPEN or b is _OPEN else a / b


def _twice(a: _Value) -> _Value:
    """The 2 of a dimensionless value may carry any unit, too."""
    return a if isinstance(a, Dimension) and any(a.exponents or ()) else _OPEN


def _plain(a: _Value) -> _Value:
    """The argument of a function such as exp is dimensionless, and so is its value."""
    if isinstance(a, Dimension) and any(a.exponents or ()):
        raise SceneError(
            f"a function of a value in {dimension_name(a.exponents or ())}; it takes plain numbers and "
            "angles."
        )
    return Dimension(_NONE)


def _sqrt(a: _Value) -> _Value:
    return a if a is _OPEN else FUNCTIONS_OF_DIMENSIONS["sqrt"](a)


_NONE = (0, 0, 0, 0, 0)
_SAME = {"fabs", "floor", "ceil", "assign"}
_PLAIN = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
    *("asinh", "acosh", "atanh", "exp", "log", "log1p", "expm1"),
)


def _missing(operation: str, where: str, *operands: _Value) -> _Value:
    """Nothing is known of the unit of what has no rule."""
    return _OPEN


_RULES: Rules = rules(
    lambda value: _OPEN,
    add=_add,
    mul=_times,
    div=_over,
    neg=lambda a: a,
    twice=_twice,
    sq=lambda a: _times(a, a),
    inv=lambda a: _OPEN,
    sqrt=_sqrt,
    fmin=_add,
    fmax=_add,
    if_else_zero=lambda condition, a: a,
    lt=lambda a, b: (_add(a, b), _OPEN)[1],
    le=lambda a, b: (_add(a, b), _OPEN)[1],
    missing=_missing,
    **{name: (lambda a: a) for name in _SAME},
    **{name: _plain for name in _PLAIN},
)
