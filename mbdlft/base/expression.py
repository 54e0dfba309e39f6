"""Expressions of parameters and constants: their values, names and degrees, and their texts.

One evaluation serves every number system: floats, arrays, CasADi SX, intervals, dimensions.
Numbers are in SI units; the value of a name has the unit with which the name was declared. ``pi`` and
``deg`` are known names.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from decimal import Decimal
from types import MappingProxyType
from typing import Any

from mbdlft.base.errors import NotRationalError, SceneError, unknown_name
from mbdlft.base.grammar import FUNCTIONS as FUNCTIONS
from mbdlft.base.grammar import Binary as Binary
from mbdlft.base.grammar import Call as Call
from mbdlft.base.grammar import Expression as Expression
from mbdlft.base.grammar import Name as Name
from mbdlft.base.grammar import Negative as Negative
from mbdlft.base.grammar import Number as Number
from mbdlft.base.grammar import Power as Power
from mbdlft.base.grammar import parse as parse
from mbdlft.base.unit import dimension_name

BUILTIN_CONSTANTS: Mapping[str, float] = {"pi": math.pi, "deg": math.pi / 180.0}
_MAX_DEGREE = 256  # of all powers and products together: a model has as many channels


def names(expression: Expression) -> frozenset[str]:
    """Names of parameters and constants that an expression uses."""
    return frozenset(node.name for node in walk(expression) if isinstance(node, Name))


def denominators(expression: Expression) -> tuple[Expression, ...]:
    """Divisors in an expression, and bases of negative powers, but those without any name."""
    divisors: list[Expression] = []
    for node in walk(expression):
        if isinstance(node, Binary) and node.operator == "/" and names(node.right):
            divisors.append(node.right)
        if isinstance(node, Power) and node.exponent < 0 and names(node.base):
            divisors.append(node.base)
    return tuple(divisors)


def degree_of(expression: Expression, known: Mapping[str, int]) -> int:
    """The number of factors of the longest product in an expression; a division counts as a factor, too.

    `known` are the degrees of names; a name that is not in it, such as a constant, has the degree 0.
    """
    match expression:
        case Name(name):
            return known.get(name, 0)
        case Negative(operand):
            return degree_of(operand, known)
        case Power(base, exponent):
            return abs(exponent) * degree_of(base, known)
        case Binary():
            first, rest = spine(expression)
            total = degree_of(first, known)
            for operator, right in rest:
                degree = degree_of(right, known)
                total = max(total, degree) if operator in "+-" else total + degree
            return total
        case _:
            return 0


def check_degree(expression: Expression, known: Mapping[str, int]) -> None:
    """Raise a SceneError if the degree of an expression, as in `degree_of`, is too high."""
    degree = degree_of(expression, known)
    if degree > _MAX_DEGREE:
        raise SceneError(
            f"products and powers make the degree {degree}, and {_MAX_DEGREE} is the most. "
            "Declare a power, or another part, as a parameter."
        )


def evaluate(
    expression: Expression,
    values: Mapping[str, Any],
    number: Callable[[float], Any] = lambda value: value,
    functions: Mapping[str, Callable[..., Any]] = MappingProxyType({}),
) -> Any:
    """Value of an expression in the number system of `values`; a constant gives a float.

    Parameters
    ----------
    expression : Expression
    values : mapping
        For each name a value with ``+ - * /`` (float, array, SX, interval, ...), in SI units.
    number : function
        Turns a literal number into one of the number system; by default it stays a float.
    functions : mapping
        Functions of the number system, its powers as "constpow", and as "unit" what makes an element of
        the exponents of the unit of a number. Without them the functions are of constants only, powers
        are products, and units are no more than their factors.

    Raises
    ------
    SceneError
        A name is unknown, or a constant is divided by zero.
    NotRationalError
        The argument of sqrt, sin, cos or atan is not a constant.
    """
    match expression:
        case Number(value, unit):
            has_unit = unit is not None and "unit" in functions
            return functions["unit"](unit) if has_unit else number(value)
        case Name(name):
            if name not in values:
                raise SceneError(unknown_name("name", name, values))
            return values[name]
        case Negative(operand):
            return -evaluate(operand, values, number, functions)
        case Binary():
            first, rest = spine(expression)
            result = evaluate(first, values, number, functions)
            for operator, right in rest:
                operand = evaluate(right, values, number, functions)
                result = _binary(operator, result, operand)
            return result
        case Power(base, exponent):
            value = evaluate(base, values, number, functions)
            power = functions.get("constpow")
            return power(value, exponent) if power else _power(value, exponent, number(1.0))
        case Call(function, argument):
            value = evaluate(argument, values, number, functions)
            if function in functions:
                return functions[function](value)
            if isinstance(value, Decimal):
                value = float(value)
            if not isinstance(value, float):
                raise NotRationalError(
                    f"{function}({write(argument)}) is not rational in "
                    f"{', '.join(sorted(names(argument)))}. {function} takes constants only; "
                    + (
                        "an angle may have 2*atan of parameters."
                        if function == "atan"
                        else "declare the whole root or angle function as a parameter instead."
                    )
                )
            if not math.isfinite(value):
                raise SceneError(f"{function} of {value} is not a number.")
            if function == "sqrt" and value < 0:
                raise SceneError(f"sqrt of the negative number {value}.")
            return number(FUNCTIONS[function](value))


def write(expression: Expression) -> str:
    """Text of an expression, with all parentheses."""
    match expression:
        case Number(value, unit):
            return repr(value) if unit is None else f"{value!r} [{dimension_name(unit)}]"
        case Name(name):
            return name
        case Negative(operand):
            return f"-{write(operand)}"
        case Binary():
            first, rest = spine(expression)
            text = write(first)
            for operator, right in rest:
                text = f"({text} {operator} {write(right)})"
            return text
        case Power(base, exponent):
            plain = not isinstance(base, Negative | Power)
            return f"{write(base) if plain else f'({write(base)})'}^{exponent}"
        case Call(function, argument):
            return f"{function}({write(argument)})"


def _binary(operator: str, left: Any, right: Any) -> Any:
    """The value of one binary operation."""
    if operator == "+":
        return left + right
    if operator == "-":
        return left - right
    if operator == "*":
        return left * right
    if isinstance(right, float) and right == 0.0:
        raise SceneError("division by zero in a constant.")
    return left / right


def _power(base: Any, exponent: int, one: Any) -> Any:
    """A power as products; `one` is 1 in the number system."""
    if exponent < 0:
        return _binary("/", one, _power(base, -exponent, one))
    result = one
    for k in range(exponent):
        result = base if k == 0 else result * base
    return result


def with_calls(expression: Expression, replace: Callable[[Call], Expression | None]) -> Expression:
    """The expression with each call replaced by the result of `replace`, unless that is None."""
    match expression:
        case Call():
            return replace(expression) or expression
        case Binary():
            tree, rest = spine(expression)
            tree = with_calls(tree, replace)
            for operator, right in rest:
                tree = Binary(operator, tree, with_calls(right, replace))
            return tree
        case Negative(operand):
            return Negative(with_calls(operand, replace))
        case Power(base, exponent):
            return Power(with_calls(base, replace), exponent)
        case _:
            return expression


def spine(expression: Expression) -> tuple[Expression, list[tuple[str, Expression]]]:
    """The first operand of a chain of binary operators, and the operators with their right operands.

    Long sums are trees that nest to the left; a loop over the chain needs no recursion.
    """
    rest: list[tuple[str, Expression]] = []
    while isinstance(expression, Binary):
        rest.append((expression.operator, expression.right))
        expression = expression.left
    return expression, rest[::-1]


def walk(expression: Expression) -> Iterator[Expression]:
    """Yield all nodes of an expression."""
    pending = [expression]
    while pending:
        node = pending.pop()
        yield node
        match node:
            case Binary(_, left, right):
                pending += [right, left]
            case Negative(child) | Power(child, _) | Call(_, child):
                pending.append(child)
            case _:
                pass
