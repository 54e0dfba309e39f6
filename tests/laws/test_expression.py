"""Laws of expressions: the parser agrees with Python's own arithmetic on exact fractions."""

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbdlft.base import expression
from tests.close import roundoff

VALUES = {"a": Fraction(3, 7), "b": Fraction(-5, 2), "c": Fraction(11, 4)}

atoms = st.one_of(
    st.sampled_from(list(VALUES)).map(expression.Name),
    st.integers(1, 9).map(lambda n: expression.Number(float(n))),
)
trees: st.SearchStrategy[expression.Expression] = st.recursive(
    atoms,
    lambda inner: st.one_of(
        st.builds(expression.Binary, st.sampled_from("+-*/"), inner, inner),
        st.builds(expression.Negative, inner),
        st.builds(expression.Power, inner, st.integers(1, 3)),
    ),
    max_leaves=12,
)


def text_of(tree: expression.Expression, spaces: str) -> str:
    """A text with as few parentheses as precedence needs, written independently of `write`."""
    match tree:
        case expression.Number(value):
            return str(int(value))
        case expression.Name(name):
            return name
        case expression.Negative(operand):
            return f"(-{_guard(operand, spaces)})"
        case expression.Power(base, exponent):
            return f"{_guard(base, spaces)}^{exponent}"
        case expression.Binary(operator, left, right):
            return f"({text_of(left, spaces)}{spaces}{operator}{spaces}{text_of(right, spaces)})"
    raise AssertionError(tree)


def _guard(tree: expression.Expression, spaces: str) -> str:
    inner = text_of(tree, spaces)
    return inner if isinstance(tree, expression.Name | expression.Number) else f"({inner})"


@given(trees, st.sampled_from(["", " ", "  "]))
def test_value_is_that_of_python(tree: expression.Expression, spaces: str) -> None:
    text = text_of(tree, spaces)
    python = text.replace("^", "**")
    for digit in "0123456789":
        python = python.replace(f"**{digit}", f"**#{digit}")
    exact = {name: value for name, value in VALUES.items()}
    try:
        expected = eval("".join(_fractions(python)), {"Fraction": Fraction, **exact})
    except ZeroDivisionError:
        return
    assert expression.names(expression.parse(text)) <= set(VALUES)
    # on fractions too: the same tree in another number system; numbers of the text are floats
    actual = expression.evaluate(_exact(expression.parse(text)), VALUES)
    assert actual == expected


def _exact(tree: expression.Expression) -> expression.Expression:
    """The tree with its numbers as fractions."""
    match tree:
        case expression.Number(value):
            return expression.Number(Fraction(value))  # type: ignore[arg-type]
        case expression.Binary(operator, left, right):
            return expression.Binary(operator, _exact(left), _exact(right))
        case expression.Negative(operand):
            return expression.Negative(_exact(operand))
        case expression.Power(base, exponent):
            return expression.Power(_exact(base), exponent)
    return tree


def _fractions(text: str) -> list[str]:
    """Numbers as exact fractions; exponents, marked with #, as they are."""
    parts, k = [], 0
    while k < len(text):
        if text[k] == "#":
            parts.append(text[k + 1])
            k += 2
        elif text[k].isdigit():
            parts.append(f"Fraction({text[k]})")
            k += 1
        else:
            parts.append(text[k])
            k += 1
    return parts


@given(trees)
def test_written_text_is_read_back(tree: expression.Expression) -> None:
    assert expression.parse(
        expression.write(expression.parse(expression.write(tree)))
    ) == expression.parse(expression.write(tree))


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
    from mbdlft.base.expression import BUILTIN_CONSTANTS

    roundoff(expression.evaluate(expression.parse(text), BUILTIN_CONSTANTS), value)


def test_nothing_is_run_as_code() -> None:
    from mbdlft.base.errors import SceneError

    for text in ("__import__('os')", "().__class__", "a if b else c", "a[0]", "lambda: 1", "a;b"):
        with pytest.raises(SceneError):
            expression.evaluate(expression.parse(text), {})
