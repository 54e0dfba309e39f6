"""The operations of SX as a table: rules that make SX of SX, such as with exact constants."""

import math
import operator
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import casadi as ca

from mbdlft.base.errors import NotRationalError, SceneError
from mbdlft.problem.sx.constants import is_constant, literal
from mbdlft.problem.sx.tapes import Rule, Rules, fold

FUNCTIONS: Mapping[str, Rule] = {
    **{name: getattr(ca, name) for name in ("sin", "cos", "tan", "asin", "acos", "atan")},
    **{name: getattr(ca, name) for name in ("sinh", "cosh", "tanh", "asinh", "acosh", "atanh")},
    **{name: getattr(ca, name) for name in ("exp", "log", "log1p", "expm1", "sqrt", "fabs")},
    **{name: getattr(ca, name) for name in ("sign", "floor", "ceil", "fmin", "fmax", "atan2")},
    **{name: getattr(ca, name) for name in ("fmod", "hypot", "copysign", "lt", "le", "eq", "ne")},
    "if_else_zero": lambda a, b: ca.if_else(a, b, 0.0),
    "and": ca.logic_and,
    "or": ca.logic_or,
    "not": ca.logic_not,
}
ARITHMETIC: Mapping[str, Rule] = {
    "assign": lambda a: a,
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "neg": operator.neg,
    "pow": operator.pow,
    "constpow": operator.pow,
    "sq": lambda a: a * a,
    "twice": lambda a: 2 * a,
    "inv": lambda a: 1 / a,
}


def sx_rules(constant: Callable[[float], Any] = ca.SX) -> Rules:
    """SX as a number system: what is folded stays; `constant` makes its constants."""
    return Rules(constant, {**FUNCTIONS, **ARITHMETIC}, _unknown)


def _unknown(operation: str, where: str, *operands: Any) -> Any:
    raise NotRationalError(f"{where}: operation {operation!r} is not supported in a DAE.")


def with_literals(expression: ca.SX) -> ca.SX:
    """An expression with the decimals that its numbers print as, not rounded when they meet others."""
    free = column_of(ca.symvar(expression))
    function = ca.Function("written", [free], [expression])
    (found,) = fold(function, sx_rules(_literal), ca.vertsplit(free))
    return ca.SX(found[0]) if found else ca.SX(1, 1)


def column_of(parts: Iterable[ca.SX]) -> ca.SX:
    """A column (n, 1) of scalars; of none, (0, 1)."""
    return ca.vertcat(ca.SX(0, 1), *parts)


def free_symbols(expression: ca.SX) -> list[ca.SX]:
    """The symbols in an expression that do not stand for constants."""
    return [s for s in ca.symvar(expression) if not is_constant(s)]


def _literal(value: float) -> ca.SX:
    if not math.isfinite(value):
        raise SceneError(f"the number {value} in an equation is not finite.")
    return ca.SX(literal(value))
