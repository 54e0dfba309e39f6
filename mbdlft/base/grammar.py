"""Expression trees and their grammar; texts are parsed and never run as code.

    sum     = term (("+" | "-") term)*
    term    = factor (("*" | "/") factor)*
    factor  = ("+" | "-") factor | power
    power   = atom ("^" | "**") integer | atom
    atom    = number [unit] | name | function "(" sum ")" | "(" sum ")"
    unit    = "[" text of a unit "]"               after a number, such as 2.5 [kg/m]
    function = "sqrt" | "sin" | "cos" | "atan"    of constants only

In an angle, even multiples of "atan" may be of parameters: see `mbdlft.multibody.scene.quantities`.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

from mbdlft.base.errors import SceneError, unknown_name
from mbdlft.base.unit import Exponents, in_si, parse_unit

FUNCTIONS: Mapping[str, Callable[[float], float]] = {
    "sqrt": math.sqrt,
    "sin": math.sin,
    "cos": math.cos,
    "atan": math.atan,
}
_MAX_EXPONENT = 64
_MAX_DEPTH = 100
_MOST_DIGITS = 1000
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[^\W\d]\w*)|(?P<operator>\*\*|[-+*/^()])|(?P<unit>\[[^\]]*\]))"
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
    """Parse a number or a text into an expression tree.

    Raises
    ------
    SceneError
        The text is not an expression of the grammar; the message gives the column.
    """
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
        rest = self.text[self.position :]
        self.column = self.position + len(rest) - len(rest.lstrip()) + 1
        if not rest.strip():
            self.kind, self.token = "", ""
            return
        match = _TOKEN.match(self.text, self.position)
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
        """What a name or a degree sign right behind a number may stand for."""
        before, rest = self.text[: self.column - 1].strip(), self.text[self.column - 1 :].strip()
        if not _TOKEN.fullmatch(before) or not before[-1:].isdigit():
            return ""
        if rest in ("deg", "°"):
            return f" Degrees are written {before}*deg."
        try:
            parse_unit(rest)
        except SceneError:
            return f" A product has a sign: {before}*{rest}." if self.kind == "name" else ""
        return (
            f" A unit stands in brackets, '{before} [{rest}]'; a product has a sign, {before}*name."
        )

    def _sum(self) -> Expression:
        self.depth += 1
        if self.depth > _MAX_DEPTH:
            raise SceneError(
                f"expression {self.text[:40]!r}...: nested more than {_MAX_DEPTH} deep."
            )
        tree = self._term()
        while self.token in ("+", "-"):
            operator = self.token
            self._advance()
            tree = Binary(operator, tree, self._term())
        self.depth -= 1
        return tree

    def _term(self) -> Expression:
        tree = self._factor()
        while self.token in ("*", "/"):
            operator = self.token
            self._advance()
            tree = Binary(operator, tree, self._factor())
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
        parenthesis = self.token == "("
        if parenthesis:
            self._advance()
        sign = -1 if self.token == "-" else 1
        if self.token in ("+", "-"):
            self._advance()
        if self.kind != "number" or not self.token.isdigit() or float(self.token) > _MAX_EXPONENT:
            raise self._error(f"an integer power of at most {_MAX_EXPONENT}")
        exponent = sign * int(self.token)
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
            if token not in FUNCTIONS:
                raise SceneError(
                    f"expression {self.text!r}: " + unknown_name("function", token, FUNCTIONS)
                )
            self._advance()
            argument = self._sum()
            self._close()
            return Call(token, argument)
        if token == "(":
            self._advance()
            tree = self._sum()
            self._close()
            return tree
        raise self._error("a number, a name or '('")

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
