"""The words of Modelica text: names, numbers, strings, operators, each with its line and column."""

import math
import re
from typing import NamedTuple

from mbdlft.base.errors import SceneError

_KEYWORDS = (
    "algorithm and annotation block break class connect connector constant constrainedby der "
    "discrete each else elseif elsewhen encapsulated end enumeration equation expandable "
    "extends external false final flow for function if import impure in initial inner input "
    "loop model not operator or outer output package parameter partial protected public pure "
    "record redeclare replaceable return stream then true type when while within"
)
KEYWORDS = frozenset(_KEYWORDS.split())
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

    Raises
    ------
    SceneError
        A character, a string or a comment is no word of Modelica; the message gives line and column.
    """
    found: list[Token] = []
    position, line, begin, depth = 0, first_line, 0, 0
    while position < len(text) and not (
        statement and depth == 0 and found and found[-1].text == ";"
    ):
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
        if kind == "name" and word in KEYWORDS:
            kind = "keyword"
        if kind == "operator":
            depth += (word in "([{") - (word in ")]}")
        if kind != "blank":
            found.append(Token(kind, word, line, column))
        if "\n" in word:
            line += word.count("\n")
            begin = position + word.rindex("\n") + 1
        position = match.end()
    found.append(Token("", "", line, position - begin + 1))
    return found


def _check_size(word: str, where: str) -> None:
    """Raise a SceneError unless there is a double next to a number, and its digits are not too many."""
    if len(word) > _MOST_DIGITS:
        raise SceneError(f"{where}: a number has at most {_MOST_DIGITS} characters.")
    digits = re.split("[eE]", word)[0].replace(".", "").strip("0")
    if math.isinf(float(word)) or (digits and not float(word)):
        raise SceneError(f"{where}: expected a number that a double can be, got {word}.")
