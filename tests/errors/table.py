"""Errors as tables: what is asked, and class and fragments of the message that refuses it.

    > assemble(cart({})) => SceneError: body 'cart'
    mass="2*x" => unknown name 'x' … Existing
    mass="-1" => TrimError: the mass is negative
    mass="1" => accepted

The line that begins with `>` heads rows: each stands in its braces, and its class and text are before
the messages of the rows. ` … ` stands between fragments, which are in the message in this order; `=~`
has a regular expression behind it. {f|g}({x|y}) asks f(x), f(y), g(x) and g(y), and {0} and {1} are these
words in the message. A row without a message has that of its head, and one that goes on is indented. A
line that begins with `#` says why rows are there."""

import builtins
import re
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from itertools import chain, product
from types import CodeType
from typing import Any

import pytest

import mbdlft


class MessageError(Exception):
    """What a command line says as it refuses."""


_SEVERAL = re.compile(r"\{([^{}|]+(?:\|[^{}|]+)+)\}")
_CLASS = re.compile(r"([A-Z]\w*(?:Error|Warning|Exit)): ?")


def says(error: type[Exception], *texts: str) -> Any:
    """`pytest.raises` of a class with a message that has these texts, in this order."""
    return pytest.raises(error, match="(?s)" + _regex(" … ".join(texts)))


def refused(table: str) -> Callable[..., None]:
    """A test of each row; names are those of fixtures, of the file with the table, and of mbdlft."""
    rows = list(_rows(table))

    @pytest.mark.parametrize(
        ("expression", "error", "match"), [row[1:] for row in rows], ids=[row[0][:50] for row in rows]
    )
    def test(expression: str, error: str, match: str, request: pytest.FixtureRequest) -> None:
        code = compile(expression, "row", "eval")
        known = {name: _value(name, request) for name in _names(code)}
        accepted = nullcontext() if match == "accepted" else None
        with accepted or pytest.raises(_value(error, request), match=match):
            eval(code, known)

    return test


def _rows(table: str) -> Iterator[tuple[str, str, str, str]]:
    """What a row asks, the whole expression, the name of the class, and the regular expression."""
    call, head = "{}", ("SceneError", "")
    for line in re.sub(r"\n\s+", " ", table).strip().splitlines():
        asked, sign, message = (*re.split(r" ?(=[>~]) ?", line, maxsplit=1), "", "")[:3]
        if line.startswith(">"):
            call, head = asked[2:], _class_and_text(message)
        elif not line.startswith("#"):
            error, text = _class_and_text(message, head[0])
            match = text if sign == "=~" else _regex(f"{head[1]} {text}".strip(" …"))
            match = text if text == "accepted" else f"(?s){match}"
            whole = call.replace("{}", asked)
            texts = _SEVERAL.split(whole)  # and lists of words between them
            for words in product(*(re.split(r" ?\| ?", words) for words in texts[1::2])):
                told = match
                for k, word in enumerate(words):
                    told = told.replace(_regex(f"{{{k}}}"), _regex(word))
                asks = "".join(chain.from_iterable(zip(texts[::2], (*words, ""), strict=True)))
                yield " ".join([*words, asked]), asks, error, told


def _class_and_text(message: str, error: str = "SceneError") -> tuple[str, str]:
    named = _CLASS.match(message)
    return (named[1], message[named.end() :]) if named else (error, message)


def _regex(text: str) -> str:
    """The fragments in this order."""
    return ".*".join(re.escape(fragment) for fragment in text.split(" … "))


def _names(code: CodeType) -> set[str]:
    """Names in an expression and in the functions inside of it."""
    inner = (_names(c) for c in code.co_consts if isinstance(c, CodeType))
    return set(code.co_names).union(*inner)


def _value(name: str, request: pytest.FixtureRequest) -> Any:
    with suppress(pytest.FixtureLookupError):
        return request.getfixturevalue(name)
    places = (vars(request.module), vars(mbdlft), vars(builtins))
    return next((d[name] for d in places if name in d), getattr(mbdlft, name, None))
