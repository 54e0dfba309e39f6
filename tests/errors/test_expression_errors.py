"""Errors of expressions: the grammar with its column, names, and what is not rational."""

from contextlib import suppress

import numpy as np
import pytest

from mbdlft import NotRationalError, SceneError
from mbdlft.base.expression import evaluate, parse
from tests.errors.scenes import arm, says


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        ("2 m1", 3, "expected an operator, got 'm1'."),
        ("m1 +", 5, "expected a number, a name or '(', got the end."),
        (" ", 2, "expected a number, a name or '(', got the end."),
        ("m1 * / m2", 6, "expected a number, a name or '(', got '/'."),
        ("(m1 + m2", 9, "expected ')', got the end."),
        ("sqrt(2", 7, "expected ')', got the end."),
        ("m1)", 3, "expected an operator, got ')'."),
        ("m1 ; m2", 4, "expected a number, a name, an operator or a parenthesis, got ';'."),
        ("m1 = 2", 4, "expected a number, a name, an operator or a parenthesis, got '='."),
        ("m1^m2", 4, "expected an integer power of at most 64, got 'm2'."),
        ("m1^65", 4, "expected an integer power of at most 64, got '65'."),
        ("m1**2.5", 5, "expected an integer power of at most 64, got '2.5'."),
        ("m1^(-2", 7, "expected ')', got the end."),
        ("m1^2^2", 5, "expected an operator, got '^'."),
        ("1e-400", 1, "expected zero or a number that a double can be, from 5e-324, got '1e-400'."),
        (
            "1e-999999999*m1",
            1,
            "expected zero or a number that a double can be, from 5e-324, got '1e-999999999'.",
        ),
        (
            "1e-300 [nm^9]",
            8,
            "expected zero or a number that a double can be, from 5e-324, got '[nm^9]'.",
        ),
    ],
)
def test_grammar(text, column, message):
    with says(SceneError, f"expression {text!r}, column {column}: {message} Expressions are made"):
        parse(text)


def test_a_number_has_not_too_many_digits():
    assert evaluate(parse(f"0.{'0' * 300}1e301"), {}) == 1.0
    assert evaluate(parse("0e-400"), {}) == 0.0
    with says(SceneError, "expected a number of at most 1000 characters, got '999"):
        parse("9" * 1001)


def test_unknown_function():
    with says(SceneError, "expression 'sqr(2)': unknown function 'sqr'. Did you mean 'sqrt'?"):
        parse("sqr(2)")


def test_no_code_is_run():
    with says(SceneError, "unknown function '__import__'"):
        parse("__import__('os').getcwd()")


def test_nested_too_deep():
    assert evaluate(parse("(" * 90 + "1" + ")" * 90), {}) == 1.0
    with says(SceneError, "expression '((((", "'...: nested more than 100 deep."):
        parse("(" * 101 + "1" + ")" * 101)


def test_long_sum_is_evaluated_or_refused():
    with suppress(SceneError):
        assert evaluate(parse("1" + "+1" * 3000), {}) == 3001.0


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("m11", SceneError, "unknown name 'm11'. Did you mean 'm1'? Existing: L, m1."),
        ("m1/(2 - 2)", SceneError, "division by zero in a constant."),
        ("m1*0^-1", SceneError, "division by zero in a constant."),
        ("sqrt(1 - 2)", SceneError, "sqrt of the negative number -1.0."),
        (
            "sqrt(m1)",
            NotRationalError,
            "sqrt(m1) is not rational in m1. sqrt takes constants only; declare the whole root or "
            "angle function as a parameter instead.",
        ),
        ("2*sin(m1*L)", NotRationalError, "sin((m1 * L)) is not rational in L, m1. sin takes"),
        ("cos(-m1^2)", NotRationalError, "cos(-m1^2) is not rational in m1."),
    ],
)
def test_evaluation(text, error, message):
    with says(error, message):
        evaluate(parse(text), {"m1": np.array([1.0, 2.0]), "L": 3.0})


@pytest.mark.parametrize("text", ["1e400", "m1*1e200*1e200", "-1e400", "m1/1e400"])
def test_quantity_that_is_not_finite(text):
    with says(SceneError, "body 'link1', mass"):
        arm('mass = "m1"', f'mass = "{text}"')


@pytest.mark.parametrize(
    ("text", "degree"),
    [("(m1^64)^8", 512), ("m1/(m1^64)^4", 257), ("2*m1 + (((m1^64)^64)^64)^-64", 64**4)],
)
def test_degree_of_a_quantity(text, degree):
    with says(
        SceneError,
        f"body 'link1', mass = {text!r}: products and powers make the degree {degree}, and 256 is the",
    ):
        arm('mass = "m1"', f'mass = "{text}"')


@pytest.mark.parametrize("function", ["sin", "cos", "sqrt"])
def test_function_of_a_constant_that_is_not_finite(function):
    with says(
        SceneError, f"body 'link1', mass = 'm1*{function}(1e200*1e200)': {function} of inf is"
    ):
        arm('mass = "m1"', f'mass = "m1*{function}(1e200*1e200)"')
