"""Errors of matrix problems: each says where, what was expected, and what to try."""

import casadi as ca
import pytest

import mbdlft
from mbdlft import Angle, Parameter, realize
from mbdlft.matrix.expressions import resolve
from mbdlft.matrix.rational import expanded_matrix
from tests.errors.table import refused

A, B = Parameter("a", 0.5, 0.3, 0.8), Parameter("b", 1.5, 1.0, 2.0)
TH = Angle("th", 30, 0, 60)
X, Y, Z, T = (ca.SX.sym(name) for name in ("a", "b", "c", "th"))
HEAD = 'format = "mbdlft-matrix/1"\nname = "m"\n'


test_messages = refused(
    r"""
realize([['x*1e-160']], [Parameter('x', 1e+160, 5e+159, 2e+160)], search=0.0)
    => parameter 'x' has the size 2e+160. Expected at most
realize([['e240']], [A], expressions={'e0': 'a'} | {f'e{k}': f'e{k - 1}*a + 1' for k in range(1, 241)},
    search=0.0)
    => StructureError: matrix 'matrix': products stand inside of each
realize(mbdlft.MatrixProblem(matrix=[['a']], parameters=[A]), [A], search=0.0)
    => a MatrixProblem has its own parameters and fields
> realize({}, [A, B], search=0.0) => SceneError:
[] => matrix 'matrix': the matrix is empty. Give it at least one row and one column.
[["+".join(f"{k}*a^{k%5}" for k in range(200_000))]]
    => matrix 'matrix' has 599999 operations, and 200000 is the most. Write a part
[["+".join(f"{k}*a^{k%5}" for k in range(50_000))]]
    => entry (0, 0) has 149999 operations, and 50000 is the most. Collect equal powers
[["a"], *[[0]] * 100_000] => matrix 'matrix' has 100001 entries, and 100000 is the most. Leave out
[[]] => the matrix is empty
"a" => expected rows of numbers or expressions, got 'a'
["a", "b"] => expected rows of numbers or expressions
[["a", 1], ["b"]] => row 1 has 1 entries, row 0 has 2
[["a", None]] => entry (0, 1): expected a finite number or an expression, got None
[["a", {float("nan")|True|10**400}]] => entry (0, 1): expected a finite number
[["1" * 400 + "*a"]] =~ column 1: expected a finite number, got '1+'
[["a^" + "9" * 5000]] =~ column 3: expected an integer power of at most 64, got '9+\.\.\.9+'
[["a"], ["aa + 1"]] => entry (1, 0) = 'aa + 1': unknown name 'aa'. Did you mean 'a'
[["a*"]] => entry (0, 0) = 'a*': expression 'a*', column 3: expected a number
[["tan(a)"]] => entry (0, 0) = 'tan(a)': expression 'tan(a)': unknown function
> realize([["a", {}]], [A, B, TH], expressions={"shared": "a + 1"}, search=0.0) => NotRationalError:
    matrix 'matrix', entry (0, 1) = …
"1 + sqrt(a + b)" => sqrt((a + b)) is not rational in a, b
"sin(a)" => sin(a) is not rational in a
"sin(th + a)" => is not rational in a, th
"sqrt(th)" => is not rational in th
"a*th" => the angle 'th' stands outside of sin and cos
"sin(0.5*th)" => an angle parameter can be multiplied by an integer only
"sin(17*th)" => each angle is one more rotation, and 16 is the most
"sin(shared)" => is not rational in a
> realize([[{}]], [A, B, TH], expressions={"shared": "4*b - 5"}, search=0.0) => WellPosednessError:
"1/(a - 0.5)"
    => matrix 'matrix', entry (0, 0): … the denominator (a - 0.5) vanishes in the range, near a = 0.5
"1/(a - 0.6)" => matrix 'matrix', entry (0, 0): … vanishes in the range, near a = 0.6
"1/(a*b - 1)"
    =~ matrix 'matrix', entry \(0, 0\): .*vanishes in the range, near a = 0.[5-8]\d*, b = 1.\d*\. Narrow
"(a - 0.7)^(-2)" => matrix 'matrix', entry (0, 0): … vanishes in the range, near a = 0.7
"1/(a - a)" => matrix 'matrix', entry (0, 0): … vanishes in the range, near a =
"1/(sin(th) - 0.5)" => matrix 'matrix', entry (0, 0): … vanishes in the range, near th =
"1/shared"
    => matrix 'matrix', entry (0, 0): … the denominator shared vanishes in the range, near b = 1.25
> realize([[{}]], [A, B, TH], expressions={'shared': '(a^64)^4'}, search=0.0) => SceneError: entry (0,
"(a^64)^8" => 0) = '(a^64)^8': products and powers make the degree 512, and 256 is
"((((a^64)^64)^64)^64)"
    => 0) = '((((a^64)^64)^64)^64)': products and powers make the degree 16777216, and 256 is
"1/(shared*b)" => 0) = '1/(shared*b)': products and powers make the degree 257, and 256 is
"cos(16*th)^17" => 0) = 'cos(16*th)^17': products and powers make the degree 272, and 256 is
> realize([["a", {}]], [A, B, TH], search=0.0) => SceneError: matrix 'matrix', entry (0, 1) …
"1e308*a*1e308" => has the size inf. Expected at most 1e+150: the square
"(1e10*a)^31" => has the size … e+306
"1e200 + a" => has the size 1e+200
"1e308*a + 1e308*b" => has the size inf
"1/(1e-200*a)" => : the denominator (1e-200 * a) has the size 8e-201. Expected at least
"1/(1e200*a)" => : the denominator (1e200 * a) has the size 8e+199. Expected at most
"sin(th)*1e160" => has the size … e+159
"1e-310*a*b" => has the size … e-310, and its terms … Expected at least 1e-280, or zero
"a + (1e160*a - 1e160*a)*1e160" => has the size … , and its terms inf
> realize([[{}]], [Parameter("a", 1e9 + 0.5, 1e9, 1e9 + 1)], search=0.0) => WellPosednessError:
# A range that is narrow beside its ends.
"1/((a - 1e9)^2 - (a - 1e9) + 1)" => accepted
"1/(a - 1e9 - 0.3)" => vanishes in the range, near a = 1e
> realize({}, search=0.0) => SceneError:
ca.vertcat(X, Y + ca.sqrt(X * Y)), [A, B]
    => NotRationalError: entry (1, 0): sqrt is not  … (parameters: a, b)
ca.horzcat(X, ca.sin(Y)), [A, B] => NotRationalError: entry (0, 1): sin is not  … (parameters: b)
X * T, [A, TH] => NotRationalError: the angle 'th' stands outside of sin and cos
X * Z, [A, B] => unknown symbol 'c'
X * Z, [A, B], symbols={"d": Z} => unknown parameter 'd'
X * ca.SX.sym("a"), [A, B] => two symbols are named 'a'
ca.vertcat(X, ca.SX(1) / 0), [A, B] => the constant inf is not a finite number
ca.SX(0, 2), [A] => the matrix is empty
X, [A], expressions={} => expressions belong to rows of texts
> realize(X, [A], symbols={}, search=0.0) => SceneError: matrix 'matrix': symbols: expected SX symbols by
    the names of parameters
[X]
X
{"a": "a"}
{3: X}
{"a": X + 1}
{"a": ca.MX.sym("a")}
> realize([["a", "b"], ["1", "2"]], [A, B], {}, search=0.0) => SceneError:
states=3 => 3 states do not fit into a matrix of 2 rows and 2 columns
states={-1|1.0} => states: expected a number of at least 0, or names, got {0}
states="x" => states: expected a number of at least 0, or names, got 'x'
states=True => states: expected a number of at least 0, or names, got True
states=[1] => states: expected a list of names, got [1]
states=10**400 => 0 states do not fit into a matrix of 2 rows and 2 columns
states=["a\0b"] => 'a\x00b' has the character '\x00', which cannot be printed
inputs=["a\nb", "c"] => 'a\nb' has the character '\n', which cannot be printed
name="m\t" => 'm\t' has the character '\t', which cannot be printed
description="a\0" => 'a\x00' has the character '\x00', which cannot be printed
states=["x", "x"] => state 'x' is given twice
inputs=["f"] => inputs: expected 2 names, one for each column beside the states, got 1
states=1, outputs=["f", "g"] => outputs: expected 1 names, one for each row
inputs=["f", "f"] => input 'f' is given twice
constants={"a": 1.0} => parameter, constant or expression 'a' is given twice
constants={"c": "1"} => constant 'c': expected a finite number
constants={"c": 10**400} => constant 'c': expected a finite number
expressions="x" => expressions: expected numbers or expressions by name, got 'x'
expressions={"e": 10**400} => expression 'e': expected a finite number or an expres
expressions={"e": None} => expression 'e': expected a finite number or an expression
expressions={"e": "f", "f": "a"} => 'f' is not known here; an expression uses only
expressions={"pi": "a"} => 'pi' cannot name a parameter, constant or expression
gravity=[0, 0, 1] => matrix 'matrix': unknown key 'gravity'
symbols={} => symbols belong to an SX matrix
> mbdlft.matrix_from_toml({}) => SceneError:
'name = "m"' => the line format = 'mbdlft-matrix/1' is missing
'format = "mbdlft-scene/1"' => format: expected 'mbdlft-matrix/1', got 'mbdlft-scene/1'
HEAD => matrix 'm': 'matrix' is missing
HEAD + 'matrx = [["a"]]' => unknown key 'matrx'. Did you mean 'matrix'
HEAD + 'matrix = [["a"]]\n[parameters]\na = { low = 1 }' => line 5: parameter 'a': 'nominal'
HEAD + "matrix = [[1]" => not valid TOML
HEAD + 'matrix = [["a"], [1, 2]]' => row 1 has 2 entries, row 0 has 1
HEAD + f"matrix = [[{'9' * 5000}]]" => not valid TOML: Exceeds the limit
HEAD + "matrix = " + "[" * 5000 => not valid TOML: maximum recursion depth
HEAD + 'matrix = [["1"]]\nstates = 300000000' => 300000000 states do not fit into a matrix of 1
HEAD + 'matrix = [["1"]]\ninputs = ["a\\u0000"]' => the character '\x00'
"""
)


def test_denominator_that_intervals_cannot_decide_is_accepted() -> None:
    """(a - b)^2 + a b - a b + ... is positive, though intervals of its terms overlap."""
    text = "1/(a^2 - 2*a*b + b^2 + 0.0001 + (a - b)*(b - a) + 0.5*(a - b)^2)"
    model = realize([[text]], [A, B], search=0.0)
    assert model.certificate.max_relative_error < 1.0


def test_degree_that_is_possible() -> None:
    assert realize([["(a^8)^8"]], [A], search=0.0).lft.order == 64


@pytest.mark.parametrize(
    ("text", "expanded"),
    [("(a + b)^8*a^8", True), ("(1e10*a)^31", True), ("(a^64)^2", True), ("(a^64)^2*b", False)],
)
def test_what_cannot_be_expanded(text: str, expanded: bool) -> None:
    """A degree above 128; coefficients beyond the floats are fractions."""
    problem = mbdlft.MatrixProblem(matrix=[[text]], parameters=[A, B])
    form = expanded_matrix(problem, resolve(problem), ca.SX.sym("q", 2))
    assert (form is not None) == expanded


def test_description_of_several_lines() -> None:
    assert mbdlft.MatrixProblem(matrix=[["1"]], description="one\n\ttwo").description[3] == "\n"
