"""Formulas of nonlinear functions: a text such as ``"r = a*a + b*b; sin(a)/(1 + r)"``.

Parts have names, with ``;`` behind each; the last part is the value. A text is parsed, never run as
code, and followed in any number system: numpy, CasADi, intervals.
"""

import ast
import math
import operator
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from mbdlft.base.errors import SceneError, unknown_name

Functions = Mapping[str, Callable[..., Any]]
_ARGUMENTS = {
    **dict.fromkeys(("atan2", "min", "max", "mod", "hypot", "copysign", "and_", "or_"), 2),
    "where": 3,
}  # of functions; all others have one
_LONGEST = 200_000  # characters: to parse them takes two seconds and 70 MB


def _power(base: Any, exponent: Any) -> Any:
    value = base**exponent
    if isinstance(value, complex):  # Python's; numpy and CasADi have none
        raise ArithmeticError("a root of a negative number")
    return value


_SIGNS: Mapping[type, tuple[str, Callable[..., Any]]] = {
    ast.Add: ("+", operator.add),
    ast.Sub: ("-", operator.sub),
    ast.Mult: ("*", operator.mul),
    ast.Div: ("/", operator.truediv),
    ast.Pow: ("**", _power),
    ast.Lt: ("<", operator.lt),
    ast.LtE: ("<=", operator.le),
    ast.Gt: (">", operator.gt),
    ast.GtE: (">=", operator.ge),
    ast.Eq: ("==", operator.eq),
    ast.NotEq: ("!=", operator.ne),
}
ARITHMETIC: Functions = {"neg": operator.neg, **dict(_SIGNS.values())}
# names of functions, and what they are for arrays of numpy
NUMPY: Functions = {
    **ARITHMETIC,
    **{name: getattr(np, name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")},
    **{name: getattr(np, name) for name in ("exp", "log", "log1p", "expm1", "sqrt", "sign")},
    **{name: getattr(np, f"arc{name[1:]}") for name in ("asin", "acos", "atan", "asinh", "acosh")},
    "atanh": np.arctanh,
    "atan2": np.arctan2,
    "abs": np.abs,
    "floor": np.floor,
    "ceil": np.ceil,
    "min": np.minimum,
    "max": np.maximum,
    "mod": np.fmod,
    "hypot": np.hypot,
    "copysign": np.copysign,
    "where": np.where,
    "and_": np.logical_and,
    "or_": np.logical_or,
    "not_": np.logical_not,
}


@cache
def parsed(text: str) -> tuple[tuple[str | None, ast.expr], ...]:
    """The parts of a formula with their names; the last has none."""
    if len(text) > _LONGEST:
        raise SceneError(f"a formula has {len(text)} characters, at most {_LONGEST} are read.")
    try:
        body = ast.parse(text).body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise SceneError(
            f"formula {text!r} cannot be read: {str(error) or 'it is nested too deep'}."
        ) from None
    if not body or not isinstance(body[-1], ast.Expr):
        raise SceneError(f"formula {text!r}: the last part is its value.")
    assignments: list[tuple[str | None, ast.expr]] = []
    for statement in body[:-1]:
        match statement:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                assignments.append((name, value))
            case _:
                raise SceneError(f"formula {text!r}: expected parts such as 'r = a*a'.")
    assignments.append((None, body[-1].value))
    for _, expression in assignments:
        for node in ast.walk(expression):
            _check_node(text, node)
    return tuple(assignments)


def formula_value(
    text: str,
    values: Mapping[str, Any],
    functions: Functions = NUMPY,
    assign: Callable[[str, Any], Any] = lambda name, value: value,
) -> Any:
    """The value of a formula, its names being those of `values`.

    A function ``number`` makes numbers of the number system of those in the text; `part` is told the name
    and the value of each part, and returns what stands for it from then on.
    """
    known, result = dict(values), None
    for name, expression in parsed(text):
        try:
            result = _value(text, expression, known, functions)
        except (ArithmeticError, RecursionError) as error:
            reason = "it is nested too deep" if isinstance(error, RecursionError) else error.args[-1]
            raise SceneError(f"formula {text!r} has no value: {reason}.") from None
        if name is not None:
            known[name] = assign(name, result)
    return result


def _check_node(text: str, node: ast.AST) -> None:
    if isinstance(node, ast.Constant) and isinstance(node.value, float) and math.isinf(node.value):
        raise SceneError(f"formula {text!r}: a number is larger than a double can be.")
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        name, count = node.func.id, len(node.args)
        expected = _ARGUMENTS.get(name, 1)
        if count != expected and (name in NUMPY or count == 0):
            raise SceneError(f"formula {text!r}: {name} has {count} arguments, expected {expected}.")
    allowed = (ast.BinOp, ast.Name, ast.Load, ast.Constant, ast.UnaryOp, ast.USub, ast.operator)
    if isinstance(node, (*allowed, ast.cmpop, ast.Compare, ast.Call)):
        is_number = not isinstance(node, ast.Constant) or type(node.value) in (int, float)
        is_plain = not isinstance(node, ast.Call) or (
            isinstance(node.func, ast.Name) and not node.keywords
        )
        known = not isinstance(node, ast.operator | ast.cmpop) or type(node) in _SIGNS
        if is_number and is_plain and known:
            return
    raise SceneError(
        f"formula {text!r}: {type(node).__name__} is not allowed. It has numbers, names, + - * / **, "
        "comparisons and functions."
    )


def _value(text: str, node: ast.expr, known: Mapping[str, Any], functions: Functions) -> Any:
    """The value of one part; long sums and products nest to the left, and need no recursion."""
    spine: list[tuple[str, ast.expr]] = []
    while isinstance(node, ast.BinOp):
        spine.append((_SIGNS[type(node.op)][0], node.right))
        node = node.left
    result = _single(text, node, known, functions)
    for sign, right in reversed(spine):
        result = functions[sign](result, _value(text, right, known, functions))
    return result


def _single(text: str, node: ast.expr, known: Mapping[str, Any], functions: Functions) -> Any:
    match node:
        case ast.Constant(value=int() | float() as value):
            return functions.get("number", float)(float(value))
        case ast.Name(id=name):
            if name not in known:
                raise SceneError(f"formula {text!r}: " + unknown_name("name", name, known))
            return known[name]
        case ast.UnaryOp(operand=operand):
            signs = 1
            while isinstance(operand, ast.UnaryOp):
                signs, operand = signs + 1, operand.operand
            value = _value(text, operand, known, functions)
            return functions["neg"](value) if signs % 2 else value
        case ast.Compare(left=left, ops=[sign], comparators=[right]):
            operands = [_value(text, side, known, functions) for side in (left, right)]
            return functions[_SIGNS[type(sign)][0]](*operands)
        case ast.Call(func=ast.Name(id=name), args=arguments) if name in functions:
            return functions[name](*(_value(text, a, known, functions) for a in arguments))
        case ast.Call(func=ast.Name(id=name)):
            named = [key for key in functions if key[0].isalpha()]
            raise SceneError(f"formula {text!r}: " + unknown_name("function", name, named))
    raise SceneError(f"formula {text!r}: compares more than two values.")
