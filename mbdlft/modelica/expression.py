"""Modelica text as words with line and column, and its expressions, by recursive descent over the words.

expression  = "if" expression "then" expression {"elseif" ...} "else" expression
            | logical [":" logical [":" logical]]
logical     = conjunction {"or" conjunction}
conjunction = ["not"] relation {"and" ["not"] relation}
relation    = sum [("<" | "<=" | ">" | ">=" | "==" | "<>") sum]
sum         = ["+" | "-"] term {("+" | "-" | ".+" | ".-") term}
term        = factor {("*" | "/" | ".*" | "./") factor}
factor      = primary [("^" | ".^") primary]
primary     = number | text | "true" | "false" | name ["(" arguments ")"]
            | "(" expression ")" | "{" arguments "}" | "[" arguments {";" arguments} "]"
"""

import math
import re
import sys
from collections.abc import Callable
from typing import NamedTuple, TypeVar

from mbdlft.base.errors import SceneError
from mbdlft.modelica import tree
from mbdlft.modelica.tree import Expression

_TOKEN = re.compile(
    r"""(?P<blank>[\s﻿]+|//[^\n]*|/\*.*?\*/)
    |(?P<number>\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)
    |(?P<name>[A-Za-z_]\w*|'(?:[^'\\\n]|\\.)+')
    |(?P<text>"(?:[^"\\]|\\.)*")
    |(?P<operator>:=|<=|>=|==|<>|\.\*|\./|\.\+|\.-|\.\^|/(?!\*)|[-+*^()\[\]{},;:=<>.])""",
    re.VERBOSE | re.DOTALL,
)
_MOST_DIGITS = 1000


class Token(NamedTuple):
    """A word: its kind is name, keyword, number, text, operator, or empty at the end."""

    kind: str
    text: str
    line: int
    column: int

    def __str__(self) -> str:
        return repr(self.text[:60]) if self.kind else "the end"


def tokens(text: str, source: str, first_line: int = 1, *, statement: bool = False) -> list[Token]:
    """The words of a text, without comments; the last one is the end.

    Of a `statement`, only those up to its semicolon are read.
    """
    words: list[Token] = []
    position, line, begin, depth = 0, first_line, 0, 0
    while position < len(text) and not (statement and depth == 0 and words and words[-1].text == ";"):
        match = _TOKEN.match(text, position)
        column = position - begin + 1
        if match is None or match.lastgroup is None:
            raise SceneError(
                f"{source}, line {line}, column {column}: {text[position]!r} begins no word of Modelica"
                + (", or what it begins has no end." if text[position] in "\"'/" else ".")
            )
        kind, word = match.lastgroup, match[0]
        if kind == "number":
            _check_size(word, f"{source}, line {line}, column {column}")
        if kind == "name" and word in tree.KEYWORDS:
            kind = "keyword"
        if kind == "operator":
            depth += (word in "([{") - (word in ")]}")
        if kind != "blank":
            words.append(Token(kind, word, line, column))
        if "\n" in word:
            line += word.count("\n")
            begin = position + word.rindex("\n") + 1
        position = match.end()
    words.append(Token("", "", line, position - begin + 1))
    return words


def _check_size(word: str, where: str) -> None:
    """Raise a SceneError unless there is a double next to a number, and its digits are not too many."""
    if len(word) > _MOST_DIGITS:
        raise SceneError(f"{where}: a number has at most {_MOST_DIGITS} characters.")
    digits = re.split("[eE]", word)[0].replace(".", "").strip("0")
    if math.isinf(float(word)) or (digits and float(word) < sys.float_info.min):
        raise SceneError(f"{where}: expected a number that a double can be, got {word}.")


_ESCAPED = re.compile(r"\\(.)", re.DOTALL)
_ESCAPES = {"n": "\n", "t": "\t", "r": "\r"}
_DEEPEST = 60  # of parentheses and of what has them
_OR, _AND, _NOT, _RELATION, _SUM, _PRODUCT, _POWER = range(1, 8)
_STRENGTH = {
    **{"or": _OR, "and": _AND},
    **dict.fromkeys(tree.RELATIONS, _RELATION),
    **dict.fromkeys(("+", "-", ".+", ".-"), _SUM),
    **dict.fromkeys(("*", "/", ".*", "./"), _PRODUCT),
    **dict.fromkeys(("^", ".^"), _POWER),
}
_SIGNS = ("operator", "keyword")
T = TypeVar("T")


class ExpressionParser:
    """The words of a text and the place in it; reads expressions."""

    def __init__(self, text: str, source: str, first_line: int = 1, *, statement: bool = False) -> None:
        self.source = source
        self.words = tokens(text, source, first_line, statement=statement)
        self.place, self.depth = 0, 0

    @property
    def word(self) -> Token:
        return self.words[self.place]

    def is_at(self, *texts: str) -> bool:
        """Whether the word is one of these operators or keywords."""
        return self.word.kind in _SIGNS and self.word.text in texts

    def take(self) -> Token:
        """The word, and go on to the next one."""
        word = self.word
        if word.kind:
            self.place += 1
        return word

    def skip(self, text: str) -> bool:
        """Go on behind the word if it is this one."""
        is_there = self.is_at(text)
        self.place += is_there
        return is_there

    def expect(self, text: str) -> Token:
        """The word, which must be this one."""
        if not self.is_at(text):
            raise self.error(repr(text))
        return self.take()

    def not_at_end(self, expected: str) -> None:
        """Raise a SceneError if the text is at its end."""
        if not self.word.kind:
            raise self.error(expected)

    def error(self, expected: str) -> SceneError:
        word = self.word
        return SceneError(
            f"{self.source}, line {word.line}, column {word.column}: expected {expected}, got {word}."
        )

    def expression(self) -> Expression:
        """An expression, or a range such as ``1:3``."""
        self.depth += 1
        if self.depth > _DEEPEST:
            raise SceneError(
                f"{self.source}, line {self.word.line}: an expression is nested more than "
                f"{_DEEPEST} deep. Write parts of it as variables."
            )
        operand = self._if() if self.is_at("if") else self._range()
        self.depth -= 1
        return operand

    def _if(self) -> Expression:
        branches: list[tuple[Expression, Expression]] = []
        while self.is_at("if" if not branches else "elseif"):
            self.take()
            condition = self.expression()
            self.expect("then")
            branches.append((condition, self.expression()))
        self.expect("else")
        return tree.If(tuple(branches), self.expression())

    def _range(self) -> Expression:
        first = self._operation(_OR)
        if not self.skip(":"):
            return first
        second = self._operation(_OR)
        if self.skip(":"):
            return tree.Range(first, second, self._operation(_OR))
        return tree.Range(first, None, second)

    def _operation(self, least: int) -> Expression:
        """Operands with operators of this strength or more (`_STRENGTH`): precedence climbing."""
        strongest = _POWER
        if least <= _NOT and self.skip("not"):
            operand: Expression = tree.Unary("not", self._operation(_RELATION))
            strongest = _NOT
        elif least <= _SUM and self.is_at("+", "-", ".+", ".-"):
            sign = self.take().text
            operand = self._operation(_SUM + 1)
            if sign in ("-", ".-"):
                operand = tree.Unary("-", operand)
            strongest = _SUM
        else:
            operand = self._primary()
        while least <= (s := self._strength()) <= strongest:
            operand = tree.Binary(self.take().text, operand, self._operation(s + 1))
            strongest = s - 1 if s in (_RELATION, _POWER) else s  # these stand once: no a < b < c
        return operand

    def _strength(self) -> int:
        """The strength of the operator at the place; 0 if there is none."""
        return _STRENGTH.get(self.word.text, 0) if self.word.kind in _SIGNS else 0

    def _primary(self) -> Expression:
        word = self.word
        if word.kind == "number":
            return tree.Number(self.take().text)
        if word.kind == "text":
            return tree.Text(self.string())
        if self.is_at("true", "false"):
            return tree.Truth(self.take().text == "true")
        if self.skip("("):
            operand = self.expression()
            if self.is_at(","):
                raise self.error("')': a list of results of a function is not supported")
            self.expect(")")
            return operand
        if self.skip("{"):
            return self._entries()
        if self.skip("["):
            return self._matrix()
        if self.is_at("der", "initial", "end", "pure"):
            self.take()
            return self._call(word) if self.is_at("(") else tree.Reference(word.text)
        if word.kind == "name" or self.is_at("."):
            name, subscripts = self.name()
            if self.is_at("(") and not subscripts:
                return self._call(word._replace(text=name))
            return tree.Reference(name, subscripts)
        raise self.error("a number, a name or '('")

    def _entries(self) -> Expression:
        if self.skip("}"):
            return tree.Array(())
        entries = [self.expression()]
        if self.skip("for"):
            index = self.take().text
            self.expect("in")
            made = tree.Comprehension(entries[0], index, self.expression())
            self.expect("}")
            return made
        while self.skip(","):
            entries.append(self.expression())
        self.expect("}")
        return tree.Array(tuple(entries))

    def _matrix(self) -> Expression:
        rows: list[Expression] = []
        while not rows or self.skip(";"):
            row = [self.expression()]
            while self.skip(","):
                row.append(self.expression())
            rows.append(tree.Array(tuple(row)))
        self.expect("]")
        return tree.Array(tuple(rows))

    def _call(self, word: Token) -> Expression:
        def argument() -> Expression:
            if self.word.kind == "name" and self.words[self.place + 1].text == "=":
                raise self.error(f"arguments of {word.text!r} by position")
            return self.expression()

        self.expect("(")
        return tree.Call(word.text, tuple(self.listed(argument, ")")))

    def listed(self, read: Callable[[], T], end: str) -> list[T]:
        """What `read` gives between commas, up to the word `end`, which is read as well."""
        items: list[T] = []
        while not self.is_at(end):
            items.append(read())
            if not self.skip(","):
                break
        self.expect(end)
        return items

    def string(self) -> str:
        """One or several texts that are joined by ``+``."""
        text = ""
        while self.word.kind == "text":
            text += _ESCAPED.sub(lambda match: _ESCAPES.get(match[1], match[1]), self.take().text[1:-1])
            if not (self.is_at("+") and self.words[self.place + 1].kind == "text"):
                break
            self.take()
        return text

    def name(self) -> tuple[str, tuple[Expression, ...]]:
        """A name with its dots, and the subscripts behind its last part."""
        text = ""
        self.skip(".")
        while True:
            if self.word.kind != "name":
                raise self.error("a name")
            text += self.take().text.removeprefix("'").removesuffix("'")
            subscripts = self._subscripts() if self.is_at("[") else ()
            if not self.skip("."):
                return text, subscripts
            text += f"{_written(subscripts, self)}."

    def _subscripts(self) -> tuple[Expression, ...]:
        self.expect("[")
        subscripts: list[Expression] = []
        while not subscripts or self.skip(","):
            subscripts.append(tree.Range() if self.skip(":") else self.expression())
        self.expect("]")
        return tuple(subscripts)


def _written(subscripts: tuple[Expression, ...], parser: ExpressionParser) -> str:
    """Subscripts inside of a name, which are whole numbers in flat text."""
    if not subscripts:
        return ""
    if not all(isinstance(entry, tree.Number) for entry in subscripts):
        raise parser.error("whole numbers as subscripts inside of a name, as flat text has them")
    return f"[{','.join(entry.text for entry in subscripts if isinstance(entry, tree.Number))}]"
