"""Errors of Modelica models: each names the file, the line, what is wrong, and what to try."""

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import mbdlft
from mbdlft import modelica
from mbdlft.base.errors import SceneError
from mbdlft.cli.models import check
from mbdlft.modelica.rumoca import model_of_tables
from mbdlft.modelica.sources import Sources
from tests.errors.table import refused


def text_of(declarations: str, equations: str = "x = 1;") -> str:
    return f"model M\n{declarations}\nequation\n{equations}\nend M;"


def model(text: str, table: modelica.ModelicaTable | None = None) -> object:
    return modelica.translate(modelica.flat_model(text, "m.mof"), table)


def linear(equations: str) -> object:
    declared = "Real x; input Real u; output Real y;"
    dae, report = modelica.translate(modelica.flat_model(text_of(declared, equations), "m.mof"))
    return mbdlft.linearize_dae(modelica.operating_point(dae, report))


DOUBT = """package P
  record R parameter Real r = 1; end R;
  model A parameter R data; Real x = data.r; end A;
  model M parameter R data(r=9); A a(data=data); end M;
end P;"""
BALL = """model Ball
 Real h(start=1); Real v;
equation
 der(h) = v;
 der(v) = -9.81;
 when h <= 0 then reinit(v, -0.7*pre(v)); end when;
end Ball;"""


def test_everything_that_has_no_place_is_named_with_its_line() -> None:
    text = """model M
      Integer k; discrete Real d; Boolean b; Real x; parameter Integer n = 3;
    equation
      when x > 1 then
        k = pre(k) + 1; reinit(x, 0);
      elsewhen x < -1 then d = 2; end when;
      terminate("stop");
      x = n;
    algorithm
      if x > 1 then b := true; end if;
    initial algorithm
      x := 1;
    end M;"""
    message = (
        r"m.mof: model 'M' has what no continuous model has: the Integer variable in line 2 \(k\); the "
        r"discrete Real variable in line 2 \(d\); the Boolean variable in line 2 \(b\); the event 'when' "
        r"in line 4 \(k, d, x\); the call of terminate in line 7; the algorithm in line 9 \(b\); the "
        r"initial algorithm in line 11 \(x\). Take it out"
    )
    with pytest.raises(SceneError, match=message):
        model(text)


@pytest.fixture
def file_of(tmp_path: Path) -> Callable[[str, str], Path]:
    def write(name: str, text: str) -> Path:
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


@pytest.fixture
def without_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rumoca", None)


WITH = pytest.mark.skipif(
    importlib.util.find_spec("rumoca") is None, reason="the compiler rumoca is not installed"
)


P = "parameter Real a = 2; parameter Real b = 2*a; parameter Integer n = 2; constant Real c = 3; Real x;"


test_messages = refused(
    r"""
model_of_tables(TABLES | {'new_table': [1]}, 'M', Sources([], {}))
    => the table 'new_table' of the compiler is not known here; give flat text
model_of_tables(TABLES | {'is_partial': True}, 'M', Sources([], {})) => model 'M' is partial
model_of_tables(TABLES | {'structured_equations': [HALF]}, 'M', Sources([], {}))
    => a loop that is written out in part
model_of_tables(TABLES | {'equations': [{'residual': nested(3000), 'span': None}]}, 'M', Sources([], {}))
    => an expression is nested too deep
model_of_tables(TABLES | {'equations': [{'residual': {'Strange': {}}, 'span': None}]}, 'M', Sources([],
    {}))
    => the expression 'Strange'
model_of_tables(TABLES | {'equations': [{'residual': {'Binary': {'op': 'Bad', 'lhs': 1}}, 'span':
    None}]}, 'M', Sources([], {}))
    => the expression 'Binary' of the compiler is not known
model_of_tables(TABLES | {'equations': [{'residual': {'Binary': {'op': 'Add', 'lhs': {'Binary': {'op':
    'Bad', 'lhs': NUMBER, 'rhs': NUMBER}}, 'rhs': NUMBER}}, 'span': None}]}, 'M', Sources([], {}))
    => the operator 'Bad' of the compiler is not known
model_of_tables(TABLES | {'equations': [{'residual': {'VarRef': {'name': {'name': 'x'}, 'subscripts':
    [{'Odd': 1}]}}, 'span': None}]}, 'M', Sources([], {}))
    => the subscript 'Odd'
model_of_tables(TABLES | {'equations': [{'residual': {'Literal': {'value': {'Real': float('inf')}}},
    'span': None}]}, 'M', Sources([], {}))
    => the number inf is not finite
> modelica_table_from_toml('format = "mbdlft-modelica/1"\n' + {}) => SceneError:
"model = 3" => model: expected a text, got 3
"check_units = 1" => check_units: expected true or false, got 1
"parameters = 3" => parameters: expected a table, got 3
"[parameters]\na = 3" =~ parameter 'a': expected a table such as { low = 1, high = 2 }
"[values]\na = 'x'" => values: 'a': expected a number, got 'x'
"[linearize]\ninputs = []" => linearize: unknown key 'inputs'
"[linearize]\noutputs = 'y'" => linearize: outputs: expected a list of names, got 'y'
"[trim]\nfrei = []" => trim: unknown key 'frei'. Did you mean 'free'
"[trim]\npoint = 'begin'" => trim: point: expected equilibrium or start, got 'begin'
"[trim]\nat = 3" => trim: at: expected a table of values by name, got 3
"[trim]\nat = { a = true }" => trim: at: 'a': expected a number or the name of a parameter
"extra = 3" => unknown key 'extra'
"a = " => not valid TOML
> load_modelica({}) => SceneError:
tmp_path / "none.mof" => none.mof: cannot be read
file_of("m.txt", text_of("Real x;")) => m.txt: expected a Modelica file: .mo, or .mof for flat
file_of("m.mof", text_of("Real x;")), model="N" => m.mof: the model is 'M', and not 'N'
> {} => SceneError:
(without_compiler, load_modelica(file_of("m.mo", text_of("Real x;"))))
    => m.mo: … rumoca: pip install 'mbdlft[modelica]'. Flat
load_modelica_table(file_of("t.toml", "model = 3"))
    => t.toml: the line format = 'mbdlft-modelica/1' is missing
check(Path("arm.toml"), None, "M") => AnalysisError: --model M: it is for Modelica models
check(Path("arm.toml"), vary=["m=2%"]) => AnalysisError: --vary m=2%: it is for Modelica models
check(file_of("m.mof", text_of("Real x;")), vary=["m=2"])
    => --vary m=2: expected NAME=20% or NAME=LOW:HIGH, such as spring.c=100:400
check(file_of("m.mof", text_of("Real x;")), vary=["m=2%"]) => m.mof: unknown parameter 'm'
check(file_of("m.mof", text_of("Real x;")), at="begin")
    => --at: expected equilibrium or start, got 'begin'
model(text_of("".join(f"Integer k{i};" for i in range(20)))) => m.mof … (k11); and 8 more
> model({}) => SceneError: m.mof …
"" => line 1, column 1: expected a model, such as 'model motor', got the end.
"Real x;" => expected a model, such as 'model motor', got 'Real'
"model M\n Real x" => line 2, column 8: expected ';', got the end
"model M\n Real x = $;\nend M;" => line 2, column 11: '$' begins no word of Modelica.
'model M "abc' => line 1, column 9: '"' begins no word of Modelica, or … has no end
"model M\n/* abc\n" => line 2, column 1: '/' begins no word
"model M\n Real x;\nend N;" => line 3, column 5: expected 'end M;', got 'N'
"model M\nend M;\nmodel N end N;" => line 3, column 1: expected the end of the text
"model M\n Resistor R;\nend M;"
    => line 2: 'Resistor' is no type of flat text. Flat text has declarations of Real, Integer, Boolean
        and String, and equations.
"model M\n extends N;\nend M;" => line 2, column 2: expected a declaration, 'equation'
"model M\n Real x if true;\nend M;" => line 2, column 9: expected no condition
"model M\n Real x(2=3);\nend M;" => line 2, column 9: expected the name of an attribute
"model M\n Real x(a.b=3);\nend M;" => expected '=' behind an attribute: Flat text has
"model M\n Real a[i].b;\nend M;" => expected whole numbers as subscripts inside of a name
text_of("Real x;", "connect(a, b);") => line 4: connect is no equation of flat text
"model M /* over\ntwo\nthree */\n x" => line 4: 'x' is no type
text_of("Real x;", "x + 1;") => line 4, column 6: expected '=', got ';'
text_of("Real x;", "x = ;") => line 4, column 5: expected a number, a name or '('
text_of("Real x;", "x = 2^3^4;") => line 4, column 8: expected ';', got '^'
text_of("Real x;", "x = f(a=1);") => expected arguments of 'f' by position
text_of("Real x;", "(x, y) = f(1);") => a list of results of a function is not supported
text_of("Real x;", "for i in 1:2, j in 1:2 loop x = 1; end for;") => one index for each
text_of("Real x;", f"x = {'(' * 99}1{')' * 99};") => nested more than 60 deep
text_of("Real x;", "if true then\n" * 400) => a choice is nested too deep
text_of("Real x = {1e999|1e-999};") => expected a number that a double can be, got {0}
text_of(f"Real x = {'1' * 2000};") => a number has at most 1000 characters
> model(text_of("Real x; Real r[2]; input Real u;", {})) => SceneError: m.mof …
"x = y;" => line 4: 'x = y': 'y' is not declared
"x = foo(1, 2);" => line 4: … : the function foo of 2 arguments is not supported
"x = pre(x);" => line 4: … : pre() makes or sees events
"x = floor(x);" => floor of what is no number makes events
"x = 1/0;" => line 4: 'x = 1 / 0': division by zero
"x = sqrt(-1);" => sqrt of the negative number -1
"x = log(0);" => log of 0 is not a number
"x = 10^(10^9);" => the power 1e+09 is too large
"x = (1/3)^999 * 1.123456789012345678901234567^999;" => the power 999 of a number of
f"x = {'*'.join(['x'] * 2000)};" => a product has at most 1000 factors
"x = {1};" => line 4: … : x is to be equal to an array of 1
"r = {1, 2, 3};" => line 4: … : an array of 2 is to be equal to an array of 3
"r = {1, 2} + 1;" => an array + a number; write .+
"r = 1/{1, 2};" => / by an array; write ./ for that of its entries
"x = 1e308*31.4;" => line 4: 'x = 1e308 * 31.4': no double is near a number, which is about 10^309.5
"x = 1e-300*1e-300;" => no double is near a number, which is about 10^-600.0
"r = {1, 2} + {1, 2, 3};" => arrays of 2 and 3 entries do not fit
"x = {1, 2}*{1, 2, 3};" => a row of 2 times a column of 3 entries
"x = {}*{};" => a row of 0 times a column of 0 entries
"r = {1, 2}*{{1, 2}, {3}};" => the rows of a matrix have different sizes
'x = if "a" == true then 1 else 2;' => expected a number, got the text 'a'
"x = size(r, x);" => size does not take an array of 2, x
"r[3] = 1;" => 'r' has 2 entries, and no entry 3
"r[1, 1] = 1;" => 'r' has more subscripts than dimensions
"r[1.5] = 1;" => expected a whole number, got 1.5
"r[:] = :;" => expected a number, a name or
"x = r[x];" => expected a number, got x
"x = cross({1}, {2});" => cross does not take an array of 1, an array of 1
"x = sum(zeros(1e6));" => zeros of 1000000 entries
"x = true;" => expected a number, got true
'x = "a";' => expected a number, got the text 'a'
"x = if 1 then 2 else 3;" => expected a condition, got 1
"for i in 3 loop x = i; end for;" => for i: expected a range such as 1:3, got 3
"for i in 1:1e9 loop x = i; end for;" => a range has at most 10000 entries
"if x > 0 then x = 1; else x = 2; x = 3; end if;" => have 1 and 2 equations
'assert(1 > 2, "too much");' => line 4: assert(1 > 2) does not hold. too much
"der(x) = -x + time;" => line 4: 'der(x) = (-x) + time' depends on time. A variable
"{x = if time > 1 then r[1] else 0|2*x = time};" => depends on time
"x = time; r[1] = der(x);" => der(x) is that of an input. Take the derivative
"r[1] = der(x*time);" => der of a function of time is not supported
"x = der(u);" => der(u) is that of an input
> model(text_of({})) => SceneError:
"Real x; Real x;" => m.mof … line 2: variable 'x': it is declared twice
"Real x[2]; Real 'x[1]';" => m.mof … 'x[1]' is declared twice
"Real x; parameter Real a = 1; parameter Real a = 2;" => m.mof … parameter 'a': it is declared twice
"Real x; Real y[400, 400];" => m.mof … 'y': an array has at most 100000 entries, got 160000
"Real x; Real y[-1];" => m.mof … variable 'y': expected a size from 0 to 10000, got -1
"Real x(start=x);" => m.mof … line 2: variable 'x': 'x' is not declared
"Real x; Real y(start=2*x);" => m.mof … variable 'y': start: it depends on the variable x
"Real x; parameter Real a;" => m.mof … line 2: parameter 'a': it has no value. Give it one there
"Real x; parameter Real a(fixed=false) = 1;" => m.mof … initial equations give its value
"Real x; parameter Real a = time;" => m.mof … parameter 'a': its value depends on time
"Real x; parameter Integer n = 3/2;" => m.mof … parameter 'n': expected a whole number, got 1.5
"Real x; parameter Real a = b;" => m.mof … parameter 'a': 'b' is not declared
"Real x; parameter Real a = a;" => m.mof … its value depends on itself: a -> a. Give one
"Real x; parameter Real a = b;\nparameter Real b = 2*c;\nparameter Real c = a;"
    =~ ^m.mof.*line \d: parameter '[abc]': its value depends on itself: (. -> ){3}.\.
"Real x; parameter Real a(min=1, max=2) = 2;" => m.mof … its value 2 is not inside of its range
"Real x; parameter Real a=1 annotation(mbdlft(percent=-5));" => m.mof … parameter 'a': … is not a range
"Real x; constant Real a=1 annotation(mbdlft(percent=5));" => m.mof … it is a constant
'Real x; parameter Real a(unit="deg")=1 annotation(mbdlft(low=0, high=2, substitution="half-angle"));'
    => m.mof … a substitution is for an angle in rad
"Real x; parameter Real a.b(min=1,max=3,nominal=2)=2; parameter Real a_b(min=1,max=3)=2;"
    => m.mof … two parameters would have the name a_b
'Real x(unit="m"); Real v(unit="s") = x;' => m.mof … line 2: 'v = x': the left side is in s, the right
'Real x(unit="m") = sin(x);' => m.mof … sin of a value in m; it takes plain numbers and angles
'Real x(unit="m"); Real y(unit="s") = y + x;' => m.mof … s and m are added or compared; units do not fit
'Real x(unit="km"); Real y(unit="m") = x;' => m.mof … 'y = x': the left side is in m, the right side in km
'Real x(unit="deg"); Real y = sin(x);' => m.mof … sin of a value in deg; it takes plain numbers and angles
'Real x(unit="s"); Real y = if x > z then 1 else 2; Real z(unit="ms") = 3;'
    => m.mof … s and ms are added or compared; units do not fit
'Real x; Real y(unit="m"); parameter Real k(unit="N/m")=1; Real f(unit="N.m") = k*y;'
    => m.mof … the left side is in kg m^2 s^-2, the right side in kg m s^-2; units do not fit
> linear({}) => TrimError: model 'M' …
"der(x) = u - x; y = log(x);" => no equilibrium was found; … 'y = log(x)' (line 4) (inf)
"der(x) = u - x; y = if x == 0 then 1 else x;" => jumps from 1 to 0 … where x == 0 switches
> linear({}) => SceneError: m.mof …
"der(x) = u - x; y = x; assert(x > 5, \"small\");" => TrimError: assert(x > 5) does not hold. small
"der(der(x)) = u - x; y = x;" => line 4: 'der(der(x)) = u - x': der of a derivative: write v = der(x)
> model(text_of({})) => SceneError: …
"Real x; Integer n = 1.5;" => n is of type Integer, and its equation gives 3/2
"Real x; Boolean b = 1;" => b is of type Boolean, and its equation gives 1
"Real x; Integer n = true;" => n is of type Integer, and its equation gives
"Real x; Real z = 5e-324;" => m.mof, line 2, column 18: expected a number that a double can be
> model(text_of(P), modelica_table_from_toml('format = "mbdlft-modelica/1"\n' + {})) => SceneError:
    m.mof …
"[parameters]\naa = { low = 1, high = 3 }" => unknown parameter 'aa'. Did you mean 'a'
"[values]\naa = 3" => unknown parameter 'aa'
"[parameters]\nb = { low = 1, high = 3 }\na = { low = 1, high = 3 }" => 'b': … only a number
"[parameters]\nn = { low = 1, high = 3 }" => 'n': it is of type Integer
"[values]\nn = 3" => 'n': the table gives a value to it; that is for numbers of type Real
"[parameters]\nc = { low = 1, high = 4 }" => constant 'c': it is a constant
"[parameters]\na = { low = 3, high = 4 }" => 'a': … the nominal must lie strictly inside
"[parameters]\na = { lo = 3 }" => unknown key 'lo'. Did you mean 'low'
"[linearize]\noutputs = ['y']" => outputs: unknown variable 'y'
"""
)


TABLES = {
    "is_partial": False,
    "variables": {},
    **{key: [] for key in ("equations", "initial_equations", "assert_equations", "algorithms")},
    **{key: [] for key in ("initial_algorithms", "when_chains", "structured_equations")},
    **{key: [] for key in ("initial_structured_equations", "initial_assert_equations")},
    "model_description": None,
    "functions": {},
}
HALF = {
    **{"interiors_materialized": False, "first_equation_index": 0, "equations_per_point": 2},
    **{"domain": {"binders": []}, "template": {"body": []}, "span": None},
}
NUMBER = {"Literal": {"value": {"Integer": 1}}}


def nested(depth: int) -> dict[str, Any]:
    inner: dict[str, Any] = NUMBER
    for _ in range(depth):
        inner = {"Unary": {"op": "Minus", "rhs": inner}}
    return inner


test_messages_of_the_compiler = WITH(
    refused(
        r"""
> load_modelica(file_of({})) => SceneError:
"m.mo", "model M\n Real x; Real y;\nequation\n x = 1;\nend M;"
    => m.mo: the compiler rumoca does not take it:  … unbalanced
"m.mo", "model M\n Real x;\nequation\n der(x) = -(x;\nend M;"
    => m.mo, line 4, column 14: the … unexpected `;`.
"ball.mo", BALL => ball.mo: model 'Ball' … the event 'when' in line 6 (v)
> {} => SceneError:
load_modelica(file_of("p.mo", DOUBT), ModelicaTable(values={"data.r": 3}), model="P.M")
    => p.mo, line 4: the compiler does not say whether 'a.data.r' is 'data.r' or … extends M(c = p)
"""
    )
)


@WITH
def test_parameters_that_have_chosen_equations_cannot_stay(tmp_path: Path) -> None:
    file = tmp_path / "m.mo"
    file.write_text(
        "model M\n parameter Real p(min=1, max=3) = 2;\n Real x; Real y;\nequation\n"
        " if p > 2.5 then x = 1; y = 2; else y = x; x = 3; end if;\nend M;"
    )
    with pytest.raises(SceneError, match=r"m.mo, line 5: equations are chosen by the value of 'p'"):
        modelica.load_modelica(file)
    with pytest.raises(SceneError, match="'p', which cannot stay or change then"):
        modelica.load_modelica(file, modelica.ModelicaTable(parameters={"p": False}, values={"p": 2.7}))
    dae, _ = modelica.load_modelica(file, modelica.ModelicaTable(parameters={"p": False}))
    assert [str(e.residual) for e in dae.equations] == ["(y-x)", "(x-3)"]
