"""Expressions of parameters and constants: their grammar, trees, values, degrees and texts.

    sum     = term (("+" | "-") term)*
    term    = factor (("*" | "/") factor)*
    factor  = ("+" | "-") factor | power
    power   = atom ("^" | "**") integer | atom
    atom    = number [unit] | name | function "(" sum ")" | "(" sum ")"
    unit    = "[" text of a unit "]"               after a number, such as 2.5 [kg/m]
    function = "sqrt" | "sin" | "cos" | "atan"    of constants only

Texts are parsed and never run as code. In an angle, even multiples of "atan" may be of parameters: see
`mbdlft.multibody.scene.quantities`. One evaluation serves every number system: floats, arrays, CasADi SX,
intervals, dimensions. Numbers are in SI units; the value of a name has the unit with which the name was
declared. ``pi`` and ``deg`` are known names.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import cache, partial, reduce
from operator import add, mul, sub, truediv
from types import MappingProxyType
from typing import Any

from mbdlft.base.errors import NotRationalError, SceneError, check_known, unknown_name
from mbdlft.base.unit import Exponents, dimension_name, in_si, parse_unit

FUNCTIONS: Mapping[str, Callable[[float], float]] = {
    name: getattr(math, name) for name in ("sqrt", "sin", "cos", "atan")
}
_OPERATIONS = {"+": add, "-": sub, "*": mul, "/": truediv}
_MAX_EXPONENT = 64  # as many factors in a product; each is a channel of a model
_MAX_DEPTH = 100  # of parentheses: each takes five calls of the thousand that Python allows
_MOST_DIGITS = 1000  # of a number: exact arithmetic carries all of them
_NOT_BLANK = re.compile(r"\S")
_TOKEN = re.compile(
    r"""(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
    |(?P<name>[^\W\d]\w*)
    |(?P<operator>\*\*|[-+*/^()])
    |(?P<unit>\[[^\]]*\])""",
    re.VERBOSE,
)


class Literal(float):
    """A double that knows how it was written: its `repr` is the text."""

    __slots__ = ("text",)
    text: str

    def __new__(cls, text: str) -> "Literal":
        made = super().__new__(cls, text)
        made.text = text
        return made

    def __repr__(self) -> str:
        return self.text

    def __reduce__(self) -> tuple[type["Literal"], tuple[str]]:
        return Literal, (self.text,)


@dataclass(frozen=True, slots=True)
class Number:
    """A literal number (SI); with the exponents of its unit if it was written with one."""

    value: float
    unit: Exponents | None = None


@dataclass(frozen=True, slots=True)
class Name:
    """A parameter or a constant."""

    name: str


@dataclass(frozen=True, slots=True)
class Binary:
    """left (+ - * /) right."""

    operator: str
    left: "Expression"
    right: "Expression"


@dataclass(frozen=True, slots=True)
class Negative:
    """-operand."""

    operand: "Expression"


@dataclass(frozen=True, slots=True)
class Power:
    """base ^ exponent, with an integer exponent."""

    base: "Expression"
    exponent: int


@dataclass(frozen=True, slots=True)
class Call:
    """A function of a constant."""

    function: str
    argument: "Expression"


Expression = Number | Name | Binary | Negative | Power | Call


@cache
def parse(source: float | str) -> Expression:
    """Parse a number or a text into an expression tree."""
    if isinstance(source, int | float):
        return Number(float(source))
    return _Parser(source).parse()


class _Parser:
    """Recursive descent over the tokens of one text."""

    def __init__(self, text: str) -> None:
        self.text, self.position, self.depth = text, 0, 0
        self.kind, self.token, self.column = "", "", 0
        self._advance()

    def parse(self) -> Expression:
        """The tree of the whole text."""
        tree = self._sum()
        if self.kind:
            raise self._error("an operator")
        return tree

    def _advance(self) -> None:
        """Read the next token; its kind is empty at the end of the text."""
        begin = _NOT_BLANK.search(self.text, self.position)
        self.column = (begin.start() if begin else len(self.text)) + 1
        if begin is None:
            self.kind, self.token = "", ""
            return
        match = _TOKEN.match(self.text, begin.start())
        if match is None or match.lastgroup is None:
            self.kind, self.token = "character", self.text[self.column - 1]
            raise self._error("a number, a name, an operator or a parenthesis")
        self.kind, self.token = match.lastgroup, match[match.lastgroup]
        self.position = match.end()

    def _error(self, expected: str) -> SceneError:
        """An error at the token that was read last."""
        got = repr(self.token) if self.token else "the end"
        return SceneError(
            f"expression {self.text!r}, column {self.column}: expected {expected}, got {got}. "
            "Expressions are made of + - * / ^ with integer powers, parentheses, names, numbers "
            f"and {', '.join(FUNCTIONS)} of constants.{self._meant()}"
        )

    def _meant(self) -> str:
        """What a name, a unit or a degree sign may stand for that no operator is before."""
        before, behind = self.text[: self.column - 1].strip(), self.text[self.column - 1 :].strip()
        if self.kind == "unit" and before:
            return " A unit stands behind a number, such as 2 [m]*name; a name has its own."
        if not _TOKEN.fullmatch(before) or not before[-1:].isdigit():
            joined = self.kind == "name" and (before[-1:].isalnum() or before[-1:] in "_)]")
            return f" A product has a sign: * before {self.token}." if joined and before else ""
        if behind in ("deg", "°"):
            return f" Degrees are written {before}*deg."
        try:
            parse_unit(behind)
        except SceneError:
            return f" A product has a sign: {before}*{behind}." if self.kind == "name" else ""
        return f" A unit stands in brackets, '{before} [{behind}]'; a product has a sign, {before}*name."

    def _sum(self) -> Expression:
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            raise SceneError(f"expression {self.text[:40]!r}...: nested more than {_MAX_DEPTH} deep.")
        tree = self._chain(("+", "-"), lambda: self._chain(("*", "/"), self._factor))
        self.depth -= 1
        return tree

    def _chain(self, operators: tuple[str, str], operand: Callable[[], Expression]) -> Expression:
        """Operands joined by operators of one rank, from the left."""
        tree = operand()
        while (operator := self.token) in operators:
            self._advance()
            tree = Binary(operator, tree, operand())
        return tree

    def _factor(self) -> Expression:
        negative = False
        while self.token in ("+", "-"):
            negative ^= self.token == "-"
            self._advance()
        tree = self._power()
        return Negative(tree) if negative else tree

    def _power(self) -> Expression:
        base = self._atom()
        if self.token not in ("^", "**"):
            return base
        self._advance()
        if parenthesis := self.token == "(":
            self._advance()
        if (sign := self.token) in ("+", "-"):
            self._advance()
        if self.kind != "number" or not self.token.isdigit() or float(self.token) > _MAX_EXPONENT:
            raise self._error(f"an integer power of at most {_MAX_EXPONENT}")
        exponent = int(f"-{self.token}" if sign == "-" else self.token)
        self._advance()
        if parenthesis:
            self._close()
        return Power(base, exponent)

    def _atom(self) -> Expression:
        kind, token = self.kind, self.token
        if kind == "number":
            self._check_size(token)
            self._advance()
            return self._with_unit(token)
        if kind == "name":
            self._advance()
            if self.token != "(":
                return Name(token)
            check_known("function", [token], FUNCTIONS, f"expression {self.text!r}")
            self._advance()
            argument = self._sum()
            self._close()
            return Call(token, argument)
        if token == "(":
            self._advance()
            tree = self._sum()
            self._close()
            return tree
        raise self._error(
            f"a number before a unit, as in 1 {token}" if kind == "unit" else "a number, a name or '('"
        )

    def _with_unit(self, token: str) -> Number:
        """A number that has been read, with the unit that may follow it."""
        if self.kind != "unit":
            return Number(Literal(token))
        try:
            unit = parse_unit(self.token[1:-1])
        except SceneError as error:
            raise SceneError(f"expression {self.text!r}, column {self.column}: {error}") from None
        text = in_si(token, unit)
        self._check_size(text)
        self._advance()
        return Number(Literal(text), unit.dimension)

    def _check_size(self, text: str) -> None:
        """Raise an error unless there is a double next to a number, and its digits are not too many."""
        if len(text) > _MOST_DIGITS:
            raise self._error(f"a number of at most {_MOST_DIGITS} characters")
        value = float(text)
        if not math.isfinite(value):
            raise self._error("a finite number")
        mantissa = re.split("[eE]", text)[0]
        if value == 0.0 and any(int(digit) for digit in mantissa if digit.isdigit()):
            raise self._error("zero or a number that a double can be, from 5e-324")

    def _close(self) -> None:
        """Read a closing parenthesis."""
        if self.token != ")":
            raise self._error("')'")
        self._advance()


BUILTIN_CONSTANTS: Mapping[str, float] = {"pi": math.pi, "deg": math.pi / 180.0}
_MAX_DEGREE = 256  # of all powers and products together: a model has as many channels


def names(expression: Expression) -> frozenset[str]:
    """Names of parameters and constants that an expression uses."""
    return frozenset(node.name for node in walk(expression) if isinstance(node, Name))


def denominators(expression: Expression) -> tuple[Expression, ...]:
    """Divisors in an expression, and bases of negative powers, but those without any name."""
    nodes = list(walk(expression))
    divisors = [node.right for node in nodes if isinstance(node, Binary) and node.operator == "/"]
    divisors += [node.base for node in nodes if isinstance(node, Power) and node.exponent < 0]
    return tuple(divisor for divisor in divisors if names(divisor))


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
            first, operations = spine(expression)
            total = degree_of(first, known)
            for operator, right in operations:
                total = (max if operator in "+-" else add)(total, degree_of(right, known))
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
    """Value of an expression in the number system of `values` (SI); a constant gives a float.

    `number` turns a literal into the number system. `functions` are those of the number system, its
    powers as "constpow", and as "unit" what makes an element of the exponents of a unit. Without them
    the functions are of constants only, powers are products, and units are no more than their factors.
    """
    match expression:
        case Number(value, unit):
            return functions["unit"](unit) if unit is not None and "unit" in functions else number(value)
        case Name(name):
            if name not in values:
                raise SceneError(unknown_name("name", name, values))
            return values[name]
        case Negative(operand):
            return -evaluate(operand, values, number, functions)
        case Binary():
            first, operations = spine(expression)
            result = evaluate(first, values, number, functions)
            for operator, right in operations:
                operand = evaluate(right, values, number, functions)
                result = _binary(operator, result, operand)
            return result
        case Power(base, exponent):
            power = functions.get("constpow") or partial(_power, unity=number(1.0))
            return power(evaluate(base, values, number, functions), exponent)
        case Call(function, argument):
            value = evaluate(argument, values, number, functions)
            if function in functions:
                return functions[function](value)
            value = float(value) if isinstance(value, Decimal) else value
            if not isinstance(value, float):
                instead = "declare the whole root or angle function as a parameter instead."
                instead = "an angle may have 2*atan of parameters." if function == "atan" else instead
                raise NotRationalError(
                    f"{function}({write(argument)}) is not rational in "
                    f"{', '.join(sorted(names(argument)))}. {function} takes constants only; {instead}"
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
            first, operations = spine(expression)
            text = write(first)
            for operator, right in operations:
                text = f"({text} {operator} {write(right)})"
            return text
        case Power(base, exponent):
            plain = not isinstance(base, Negative | Power)
            return f"{write(base) if plain else f'({write(base)})'}^{exponent}"
        case Call(function, argument):
            return f"{function}({write(argument)})"


def _binary(operator: str, left: Any, right: Any) -> Any:
    """The value of one binary operation."""
    if operator == "/" and isinstance(right, float) and right == 0.0:
        raise SceneError("division by zero in a constant.")
    return _OPERATIONS[operator](left, right)


def _power(base: Any, exponent: int, unity: Any) -> Any:
    """A power as products; `unity` is 1 in the number system."""
    if exponent < 0:
        return _binary("/", unity, _power(base, -exponent, unity))
    return reduce(mul, [base] * exponent) if exponent else unity


def with_calls(expression: Expression, replace: Callable[[Call], Expression | None]) -> Expression:
    """The expression with each call replaced by the result of `replace`, unless that is None."""
    match expression:
        case Call():
            return replace(expression) or expression
        case Binary():
            tree, operations = spine(expression)
            tree = with_calls(tree, replace)
            for operator, right in operations:
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
    operations: list[tuple[str, Expression]] = []
    while isinstance(expression, Binary):
        operations.append((expression.operator, expression.right))
        expression = expression.left
    return expression, operations[::-1]


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
