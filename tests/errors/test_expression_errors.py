"""Errors of expressions: the grammar with its column, names, and what is not rational."""

from contextlib import suppress

import numpy as np
import pytest

import mbdlft
from mbdlft import AnalysisError, MatrixProblem, Parameter, SceneError, exact_lower_bound
from mbdlft.base.expression import evaluate, parse
from mbdlft.exact import numbers
from tests.errors.scenes import arm
from tests.errors.table import refused

test_messages = refused(
    r"""
parse("sqr(2)") => expression 'sqr(2)': unknown function 'sqr'. Did you mean 'sqrt'?
parse("__import__('os').getcwd()") => unknown function '__import__'
> parse({}) => SceneError:
"2 m1" => expression '2 m1', column 3: expected an operator, got 'm1'. Expressions are made
"m L^2" => column 3: expected an operator, got 'L'. Expressions are made
"(m + M) L" => A product has a sign: * before L.
"m*L^2 [m^2]"
    => A unit stands behind a number, such as 2 [m]*name; a name has its own.
"m1 +"
    => expression 'm1 +', column 5: expected a number, a name or '(', got the end. Expressions are made
" " => expression ' ', column 2: expected a number, a name or '(', got the end. Expressions are made
"m1 * / m2"
    => expression 'm1 * / m2', column 6: expected a number, a name or '(', got '/'. Expressions are made
"(m1 + m2" => expression '(m1 + m2', column 9: expected ')', got the end. Expressions are made
"sqrt(2" => expression 'sqrt(2', column 7: expected ')', got the end. Expressions are made
"m1)" => expression 'm1)', column 3: expected an operator, got ')'. Expressions are made
"m1 ; m2"
    => expression 'm1 ; m2', column 4: expected a number, a name, an operator or a parenthesis, got ';'.
        Expressions are made
"m1 = 2"
    => expression 'm1 = 2', column 4: expected a number, a name, an operator or a parenthesis, got '='.
        Expressions are made
"m1^m2"
    => expression 'm1^m2', column 4: expected an integer power of at most 64, got 'm2'. Expressions are
        made
"m1^65"
    => expression 'm1^65', column 4: expected an integer power of at most 64, got '65'. Expressions are
        made
"m1**2.5"
    => expression 'm1**2.5', column 5: expected an integer power of at most 64, got '2.5'. Expressions
        are made
"m1^(-2" => expression 'm1^(-2', column 7: expected ')', got the end. Expressions are made
"m1^2^2" => expression 'm1^2^2', column 5: expected an operator, got '^'. Expressions are made
"1e-400"
    => expression '1e-400', column 1: expected zero or a number that a double can be, from 5e-324, got
        '1e-400'. Expressions are made
"1e-999999999*m1"
    => expression '1e-999999999*m1', column 1: expected zero or a number that a double can be, from
        5e-324, got '1e-999999999'. Expressions are made
"1e-300 [nm^9]"
    => expression '1e-300 [nm^9]', column 8: expected zero or a number that a double can be, from
        5e-324, got '[nm^9]'. Expressions are made
"9" * 1001 => expected a number of at most 1000 characters, got '999
"(" * 101 + "1" + ")" * 101 => expression '(((( … '...: nested more than 100 deep.
> evaluate(parse({}), {"m1": np.array([1.0, 2.0]), "L": 3.0}) => SceneError:
"m11" => unknown name 'm11'. Did you mean 'm1'? Existing: L, m1.
"m1/(2 - 2)" => division by zero in a constant.
"m1*0^-1" => division by zero in a constant.
"sqrt(1 - 2)" => sqrt of the negative number -1.0.
"sqrt(m1)"
    => NotRationalError: sqrt(m1) is not rational in m1. sqrt takes constants only; declare the whole
        root or angle function as a parameter instead.
"2*sin(m1*L)" => NotRationalError: sin((m1 * L)) is not rational in L, m1. sin takes
"cos(-m1^2)" => NotRationalError: cos(-m1^2) is not rational in m1.
> arm('mass = "m1"', 'mass = "' + {} + '"') => SceneError: body 'link1', mass
"{1e400|m1*1e200*1e200|-1e400|m1/1e400}"
> arm('mass = "m1"', 'mass = "' + {} + '"') => SceneError: body 'link1',
"(m1^64)^8" => mass = '(m1^64)^8': products and powers make the degree 512, and 256 is the
"m1/(m1^64)^4" => mass = 'm1/(m1^64)^4': products and powers make the degree 257, and 256 is the
"2*m1 + (((m1^64)^64)^64)^-64"
    => mass = '2*m1 + (((m1^64)^64)^64)^-64': products and powers make the degree 16777216, and 256 is
        the
> arm('mass = "m1"', 'mass = "m1*' + {} + '(1e200*1e200)"') => SceneError: body 'link1',
"{sin|cos|sqrt}" => mass = 'm1*{0}(1e200*1e200)': {0} of inf is
"""
)


def test_what_is_just_allowed():
    assert evaluate(parse(f"0.{'0' * 300}1e301"), {}) == 1.0
    assert evaluate(parse("0e-400"), {}) == 0.0
    assert evaluate(parse("(" * 90 + "1" + ")" * 90), {}) == 1.0


def test_long_sum_is_evaluated_or_refused():
    with suppress(SceneError):
        assert evaluate(parse("1" + "+1" * 3000), {}) == 3001.0


# Numbers that are too near to zero for the bits that balls may have ---------------------------------

# sqrt(2) in 130 digits: balls of 384 bits cannot tell it from the root
ROOT = (
    "1.4142135623730950488016887242096980785696718753769480731766797379907324784621070388503875"
    "343276415727350138462309122970249248360558"
)
NEAR = MatrixProblem(matrix=[[f"(sqrt(2) - {ROOT})*a"]], parameters=[Parameter("a", 0.5, 0.3, 0.8)])


def test_more_bits_tell_numbers_from_zero() -> None:
    assert exact_lower_bound(NEAR) == {"a": 1}


def test_numbers_that_cannot_be_told_from_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numbers, "MOST_BITS", 384)
    message = (
        r"matrix 'matrix': numbers that are not zero cannot be told from zero in 384 bits\. .*"
        "make equal what is meant to be equal"
    )
    with pytest.raises(AnalysisError, match=message) as found:
        exact_lower_bound(NEAR)
    assert isinstance(found.value, mbdlft.MbdlftError)
