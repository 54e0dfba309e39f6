"""Expressions: precedence; `tests/attack/expressions.py` has values of drawn texts against Python's."""

import pytest

from mbdlft.base import expression
from mbdlft.base.errors import SceneError
from tests.close import roundoff


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1 - 2 - 3", -4.0),
        ("2 / 4 / 2", 0.25),
        ("-2^2", -4.0),
        ("2^-2", 0.25),
        ("2**3*2", 16.0),
        ("1.5e3 + .5", 1500.5),
        ("sqrt(16)*cos(0) + sin(pi/6)", 4.5),
        ("--3", 3.0),
        ("90*deg", 1.5707963267948966),
        ("2^(-1)", 0.5),
        ("(2 + 1)^0", 1.0),
    ],
)
def test_precedence(text: str, value: float) -> None:
    roundoff(expression.evaluate(expression.parse(text), expression.BUILTIN_CONSTANTS), value)


@pytest.mark.parametrize("text", ["(a^2)^3", "(-a)^2", "-a^2", "a/(b/c)", "a - (b - c)", "sin(a + 1)"])
def test_written_text_is_read_back(text: str) -> None:
    tree = expression.parse(text)
    assert expression.parse(expression.write(tree)) == tree


def test_nothing_is_run_as_code() -> None:
    for text in ("__import__('os')", "().__class__", "a if b else c", "a[0]", "lambda: 1", "a;b"):
        with pytest.raises(SceneError):
            expression.evaluate(expression.parse(text), {})
