"""Laws of Modelica text: it is read as the language says, and no digit is lost when it is written."""

from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from mbdlft.base.errors import SceneError
from mbdlft.base.unit import parse_unit
from mbdlft.dae import Dae, DaeTrim, reduce_index, trim
from mbdlft.modelica import ModelicaTable, flat_model, flat_text, operating_point, translate, tree
from mbdlft.modelica.evaluation import Evaluator, unit_of
from mbdlft.modelica.expression import ExpressionParser
from mbdlft.modelica.lookup import of_tables
from mbdlft.modelica.tree import Array, Binary, Call, Expression, If, Number, Reference, Unary, write
from mbdlft.problem.sx.constants import in_doubles
from tests.close import SIMULATED, exact, roundoff, target
from tests.errors.table import refused
from tests.modelica import FLAT

VALUES: dict[str, Any] = {"a": Fraction(3, 7), "b": Fraction(-5, 2), "v": (Fraction(2), Fraction(5))}


def parsed(text: str) -> Expression:
    return ExpressionParser(text, "text").expression()


def value(text: str) -> Any:
    return Evaluator(VALUES.get, lambda x: x).value(parsed(text))


atoms = st.one_of(
    st.sampled_from(["a", "b"]).map(Reference),
    st.integers(1, 9).map(lambda n: Number(str(n))),
    st.decimals("0.001", "99.9", places=3).map(lambda d: Number(str(d))),
)
numbers: st.SearchStrategy[Expression] = st.recursive(
    atoms,
    lambda inner: st.one_of(
        st.builds(Binary, st.sampled_from("+-*/"), inner, inner),
        st.builds(lambda e: Unary("-", e), inner),
        st.builds(lambda e, n: Binary("^", e, Number(str(n))), inner, st.integers(1, 3)),
        st.builds(
            lambda o, a, b, c: If(((Binary(o, a, b), c),), a),
            st.sampled_from(["<", "<=", ">", ">=", "==", "<>"]),
            *(inner, inner, inner),
        ),
        st.builds(lambda a, b: Call("max", (a, b)), inner, inner),
    ),
    max_leaves=12,
)


def by_python(e: Expression) -> Fraction:
    """The value by the arithmetic of Python on fractions."""
    match e:
        case Number(text):
            return Fraction(text)
        case Reference(name):
            return VALUES[name]
        case Unary(_, operand):
            return -by_python(operand)
        case Call(_, (a, b)):
            return max(by_python(a), by_python(b))
        case If(((Binary(o, a, b), then),), otherwise):
            x, y = by_python(a), by_python(b)
            holds = {"<": x < y, "<=": x <= y, ">": x > y, ">=": x >= y, "==": x == y, "<>": x != y}
            return by_python(then if holds[o] else otherwise)
        case Binary("^", a, Number(text)):
            return by_python(a) ** int(text)
        case Binary(operator, a, b):
            x, y = by_python(a), by_python(b)
            return {"+": x + y, "-": x - y, "*": x * y}[operator] if operator != "/" else x / y
    raise AssertionError(e)


@given(numbers)
def test_what_is_written_is_read_again_with_the_same_exact_value(e: Expression) -> None:
    again = parsed(write(e))
    assert write(again) == write(e)
    try:
        expected = by_python(e)
    except ZeroDivisionError:
        with pytest.raises(SceneError, match="division by zero"):
            value(write(e))
        return
    assert value(write(e)) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-2^2", -4),
        ("2 - 3 - 4", -5),
        ("2/4/2", Fraction(1, 4)),
        ("2/4*2", 1),
        ("-a + b*2", Fraction(-3, 7) - 5),
        ("2^(-1)", Fraction(1, 2)),
        ("0.1*0.7", Fraction(7, 100)),
        ("1e-3 + 1.5E2", Fraction(150001, 1000)),
        ("if a > 0 and not b > 0 then 1 elseif true then 2 else 3", 1),
        ("if false or a < 0 then 1 elseif a == 3/7 then 2 else 3", 2),
        ("{1, 2}*{3, 4}", 11),
        ("[1, 2; 3, 4]*v", (12, 26)),
        ("v.*v", (4, 25)),
        ("2*v - {1, 1}", (3, 9)),
        ("v[2] + v[end]", 10),
        ("v[end - 1]*v[1]", 4),
        ("v[1:end]", (2, 5)),
        ("v[:]", (2, 5)),
        ("sum(v)", 7),
        ("sum({i^2 for i in 1:3})", 14),
        ("sum(1:2:5)", 9),
        ("max({1, 5, 3}) + min(2, 4)", 7),
        ("cross({1, 2, 3}, {4, 5, 7})", (-1, 5, -3)),
        ("if 2 >= 2 and 2 <= 2 and not 2 > 2 then 1 else 0", 1),
        ("skew({1, 2, 3})*{4, 5, 6}", (-3, 6, -3)),
        ("transpose([1, 2; 3, 4])", ((1, 3), (2, 4))),
        ("identity(2)*v", (2, 5)),
        ("diagonal({2, 3})*v", (4, 15)),
        ("size([1, 2; 3, 4; 5, 6], 1) + size(v, 1)", 5),
        ("zeros(2) + ones(2) + fill(3, 2)", (4, 4)),
        ("semiLinear(b, 2, 3)", Fraction(-15, 2)),
        ("smooth(1, noEvent(a)) - homotopy(a, b)", 0),
        ("abs(-2) + sign(-3) + floor(2.7) + sqrt(9)", 6),
        ("Modelica.Math.sin(0)", 0),
    ],
)
def test_values_are_those_of_the_language(text: str, expected: Any) -> None:
    assert value(text) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("sin(a)", np.sin(3 / 7)),
        ("2*asin(1.0)", np.pi),
        ("asin(0.5) + acos(0.5)", np.pi / 2.0),
        ("atan2(1, -1)", 0.75 * np.pi),
        ("exp(1)*log10(1000)", 3 * np.e),
        ("2^0.5", np.sqrt(2.0)),
        ("tanh(a)/cosh(b)", np.tanh(3 / 7) / np.cosh(2.5)),
    ],
)
def test_functions_of_numbers(text: str, expected: float) -> None:
    found = value(text)
    number = found if isinstance(found, Fraction) else ca.evalf(in_doubles(ca.SX(found)))
    roundoff(float(number), expected)


def test_numbers_are_not_rounded() -> None:
    digits = "1.00000000000000000000000000000000001"
    assert value(digits) == Fraction(digits)
    head = "model M\n parameter Real k(min=1, max=3) = 2;\n Real x;\nequation\n"
    text = f"{head} x = ({digits} - 1)*1e35*k;\nend M;"
    dae, _ = translate(flat_model(text))
    (e,) = dae.equations
    assert str(e.residual) == "(x-k)"


@pytest.mark.parametrize("file", sorted(FLAT.glob("*.mof")), ids=lambda file: file.stem)
def test_flat_texts_are_written_as_they_are_read(file: Any) -> None:
    text = file.read_text(encoding="utf-8")
    assert flat_text(flat_model(text)) == text


def test_names_comments_and_annotations_make_the_round_trip() -> None:
    text = """
    model 'a b' "says \\"so\\""
      parameter Real 'odd name'.k(min=1, max=3, unit="N.m") = 2 "of \\\\ it"
        annotation(Placement(x={1, 2}), mbdlft(role="design", name="k_odd"), Dialog(tab=(1)));
      Real x[2](each start=1.5, each fixed=true);
      Real y; // a comment
      Real 'end'.'x' = 3;
    equation
      for i in 1:2 loop der(x[i]) = -i*x[i]; end for;
      if true then y = 1; elseif y > 0 then y = 2; else y = 'odd name'.k; end if;
    end 'a b';
    """
    model = flat_model(text)
    again = flat_model(flat_text(model))
    assert flat_text(again) == flat_text(model)
    dae, _ = translate(again)
    assert [p.name for p in dae.parameters] == ["k_odd"]
    assert dae.parameters[0].role == "design"
    assert [x.name for x in dae.variables] == ["x[1]", "x[2]", "y", "end.x"]
    assert [x.start for x in dae.variables] == [1.5, 1.5, None, None]
    assert dae.description == 'says "so"'
    residuals = [str(e.residual) for e in dae.equations]
    assert residuals == ["(end.x-3)", "(der(x[1])+x[1])", "(der(x[2])+(2.*x[2]))", "(y-1)"]


def test_texts_as_openmodelica_writes_them_are_read() -> None:
    text = """function Lib.Math.half
      input Real x; output Real y;
    algorithm
      y := if x > 0 then x/2 else -x/2;
    end Lib.Math.half;

    class Lib.Examples.First "with a dot in its name"
      parameter enumeration(never, avoid, default, prefer) body.stateSelect = StateSelect.default "p";
      final parameter Boolean body.useSupport = true "= true";
      protected parameter Real body.J(quantity = "MomentOfInertia", unit = "kg.m2", min = 0.0) = 2.0;
      Real body.phi(quantity = "Angle", unit = "rad", stateSelect = StateSelect.prefer);
      Real body.w(start = 1.0, fixed = true) "speed" annotation(Evaluate = true);
      protected Real body.a;
      parameter Integer n = 3;
    initial equation
      body.phi = 0.0;
    equation
      body.w = der(body.phi);
      body.a = der(body.w);
      body.J * body.a = -10.0 ^ (-1.0) * (if body.useSupport then body.phi else 0.0);
      annotation(experiment(StopTime = 1.0));
    end Lib.Examples.First;
    """
    dae, report = translate(flat_model(text))
    assert dae.name == "Lib.Examples.First"
    assert [(x.name, x.unit, x.fixed) for x in dae.variables] == [
        ("body.phi", "rad", False),
        ("body.w", "1", True),
        ("body.a", "1", False),
    ]
    assert report.states == ("body.phi",)
    assert [e.line for e in dae.equations] == [18, 19, 20]
    assert [str(e.residual) for e in dae.initial] == ["body.phi"]
    assert flat_text(flat_model(dae.text)) == dae.text


def test_entries_that_are_declared_one_by_one_are_those_of_an_array() -> None:
    head = "model M\n Real x[1](start=1); Real x[2](start=2); Real r[1].c[3](start={4, 5, 6});\n"
    body = "equation\n der(x[1]) = x[2]; x[2] = -x[1]; r[1].c = {x[1], 2, 3};\nend M;"
    dae, _ = translate(flat_model(head + body))
    names = [x.name for x in dae.variables]
    assert names == ["x[1]", "x[2]", "r[1].c[1]", "r[1].c[2]", "r[1].c[3]"]
    assert [x.start for x in dae.variables] == [1.0, 2.0, 4.0, 5.0, 6.0]
    assert len(dae.equations) == 5


def test_der_of_an_expression_is_that_of_its_variables() -> None:
    text = "model M\n Real x; Real y; Real z;\nequation\n z = der(x*y^2 + 3);\n y = 1; x = y;\nend M;"
    dae, _ = translate(flat_model(text))
    residual = dae.equations[0].residual
    symbols = {s.name(): s for s in ca.symvar(residual)}
    at = {"x": 2.0, "y": 3.0, "der(x)": 5.0, "der(y)": 7.0, "z": 0.0}
    function = ca.Function("f", list(symbols.values()), [residual])
    exact(float(function(*(at[name] for name in symbols))), -(5.0 * 9.0 + 2.0 * 2.0 * 3.0 * 7.0))


def test_a_source_of_time_becomes_an_input_with_its_value_at_time_zero() -> None:
    text = """model M
      parameter Real a(min=1, max=5) = 3;
      Real u; Real w; Real x;
    equation
      u = a + (if time < 1 then 0 else sin(time));
      2*a - w*1 = time;
      der(x) = -x + u + w;
    end M;"""
    dae, report = translate(flat_model(text))
    assert report.sources == ("u", "w")
    assert [(u.name, u.start) for u in dae.inputs] == [("u", 3.0), ("w", 6.0)]
    assert [str(e.residual) for e in dae.equations] == ["(der(x)-((u-x)+w))"]


def test_which_parameters_stay() -> None:
    text = """model M
      parameter Real own(min=1, max=3) = 2;
      parameter Real own_too(min=1, max=1e60) = 2;
      parameter Real a.library(min=0, max=10) = 5;
      parameter Real a.meant(min=4, max=6, nominal=5) = 5;
      parameter Real a.noted(unit="kg") = 5 annotation(mbdlft(percent=20));
      parameter Real dependent(min=1, max=9) = 2*own;
      constant Real c(min=1, max=3) = 2;
      Real x;
    equation
      x = own + own_too + a.library + a.meant + a.noted + dependent + c;
    end M;"""
    dae, report = translate(flat_model(text))
    assert [(p.name, p.low, p.nominal, p.high, p.unit) for p in dae.parameters] == [
        ("a_meant", 4.0, 5.0, 6.0, "1"),
        ("a_noted", 4.0, 5.0, 6.0, "kg"),
        ("own", 1.0, 2.0, 3.0, "1"),
    ]
    assert len(report.notes) == 1
    assert "a.library has min and max" in report.notes[0]
    (e,) = dae.equations
    assert {s.name() for s in ca.symvar(e.residual)} == {"x", "own", "a_meant", "a_noted"}


@pytest.mark.parametrize(
    ("modelica", "ours"),
    [
        ("N.m/rad", "N m/rad"),
        ("kg.m2", "kg m^2"),
        ("J/(kg.K)", "J/kg/K"),
        ("m.s-2", "m/s^2"),
        ("1/s", "1/s"),
        ("V.s/rad", "V s"),
    ],
)
def test_units_mean_the_same(modelica: str, ours: str) -> None:
    found = unit_of(modelica)
    assert found is not None
    assert parse_unit(found) == parse_unit(ours)


def test_units_that_are_not_known_are_said() -> None:
    for text in ("mol", "degC", "m^2", "1/(", "N*m"):
        assert unit_of(text) is None
    dae, report = translate(flat_model('model M\n Real x(unit="mol") = 1;\nend M;'))
    assert dae.variables[0].unit == "1"
    assert report.notes == ("the unit 'mol' of x is not known here; it is not checked",)


def test_choices_of_equations_are_those_of_expressions() -> None:
    head = "model M\n Real x; Real y;\nequation\n x = 1;\n "
    choice = "if x > 0 then y = x; elseif x > -1 then y = 2; else 3*y = 5; end if;\nend M;"
    dae, _ = translate(flat_model(head + choice))
    function = ca.Function("f", [x.symbol for x in dae.variables], [dae.equations[1].residual])
    for x in (1.0, -0.5, -3.0):
        expected = {1.0: 4.0 - 1.0, -0.5: 4.0 - 2.0, -3.0: 3.0 * 4.0 - 5.0}[x]
        exact(float(function(x, 4.0)), expected)


def test_the_first_condition_that_holds_decides() -> None:
    head = "model M\n Real x; Real y;\nequation\n x = 1;\n "
    dae, _ = translate(flat_model(f"{head}y = if x > 0 then x elseif x > -1 then 2 else 5/3;\nend M;"))
    residual = in_doubles(dae.equations[1].residual)
    function = ca.Function("f", [x.symbol for x in dae.variables], [residual])
    for x, value in ((1.0, 1.0), (-0.5, 2.0), (-3.0, 5.0 / 3.0)):
        exact(float(function(x, 4.0)), 4.0 - value)


def test_long_sums_are_read() -> None:
    text = f"model M\n Real x; Real y;\nequation\n x = 1;\n y = {' - '.join(['x'] * 5001)};\nend M;"
    dae, _ = translate(flat_model(text))
    function = ca.Function("f", [x.symbol for x in dae.variables], [dae.equations[1].residual])
    exact(float(function(1.0, 0.0)), 4999.0)


def test_an_array_is_written_with_its_entries() -> None:
    e = Array((Number("1"), Unary("-", Number("2"))))
    assert write(e) == "{1, -2}"


def test_modes_of_arrays_and_claims_on_variables_are_decided_at_the_equilibrium() -> None:
    model = flat_model(
        "model M\n Boolean b[2]; Boolean c[2];\n Real x[2](each start = 1); input Real u;\nequation\n"
        ' c = not b;\n b = {x[1] > 0.5 and true, x[2] > 2};\n assert(x[1] < 5, "large");\n'
        " der(x[1]) = 1 - x[1] + (if b[1] then u else 0);\n"
        " der(x[2]) = 1 - x[2] + (if c[2] then 2*u else 0);\nend M;"
    )
    dae, report = translate(model)
    linear = mbdlft.linearize_dae(operating_point(dae, report))
    assert np.array_equal(np.ravel(mbdlft.matrices_at(linear, {})[1]), [1.0, 2.0])


def test_an_integer_does_not_stay() -> None:
    text = "model M\n parameter Integer n(min=1, max=5)=2; Real x;\nequation\n x = n;\nend M;"
    dae, report = translate(flat_model(text))
    assert not dae.parameters
    assert report.notes == ("n has min and max, and is a number: it is an Integer",)
    with pytest.raises(SceneError, match="parameter 'n': it is of type Integer; only a Real can stay"):
        translate(flat_model(text), ModelicaTable(parameters={"n": {"low": 1.0, "high": 3.0}}))


# Laws of modes: what holds at nominal holds in the whole range of L, from 1 to 3, or it is refused.


def of_modes(declared: str, equations: str, at: Any = None) -> tuple[Dae, DaeTrim]:
    """y = (if b then 1 else 3) x with der(x) = u - L x."""
    text = (
        f"model M parameter Real L(min=1, max=3)=2; {declared} Real x(start=0.5);\n"
        "input Real u(start=1); output Real y;\nequation der(x) = u - L*x; y = (if b then 1 else 3)*x;\n"
        f"{equations};\nend M;"
    )
    dae, report = translate(flat_model(text))
    return dae, operating_point(dae, report) if at is None else trim(reduce_index(dae), at)


@pytest.mark.parametrize(
    ("b", "gain"),
    [
        ("L > 0.9", 1.0),
        ("L*x > 1.5", 3.0),
        ("x > 0.4 and u > 0 or L < 3.5", 1.0),
        ("L <= 3", 1.0),
        ("abs(x - 0.5) < 0.6 and max(x, L) > 0.9 and min(0.2, 0.5 - x) > -0.6", 1.0),
        ("true <> (x < 0)", 1.0),
        ("(x > 0) == false", 3.0),
    ],
)
def test_a_mode_that_does_not_change_is_a_number(b: str, gain: float) -> None:
    linear = mbdlft.linearize_dae(of_modes("Boolean b;", f"b = {b}")[1])
    for L in (1.0, 2.9):
        A, _, C, _ = mbdlft.matrices_at(linear, {"L": L})
        exact(np.array([A[0, 0], C[0, 0]]), np.array([-L, gain]))


@pytest.mark.parametrize(
    ("given", "point", "A", "C"),
    [
        ("x(start=L, fixed=true)", "start", lambda L: -2.0 * L, lambda L: 2.0 * L + 1.0),
        ("x(start=1/L)", "start", lambda L: -2.0 / L, lambda L: 2.0 / L + 1.0),
        ("x(start=L)", "equilibrium", lambda L: 0.0 * L, lambda L: 2.0 * L + 1.0),
    ],
)
def test_a_start_of_parameters_holds_where_nothing_else_does(
    given: str, point: str, A: Any, C: Any
) -> None:
    rate = "u - x^2" if point == "start" else "u"  # a free shaft
    table = ModelicaTable(point=point)
    dae, report = translate(
        flat_model(
            f"model M parameter Real L(min=1, max=3)=2; Real {given}; Real z; input Real u;\n"
            f"output Real y;\nequation der(x) = {rate}; z = x^2 + x; y = z;\nend M;"
        ),
        table,
    )
    linear = mbdlft.linearize_dae(operating_point(dae, report))
    for L in (1.0, 2.3, 3.0):
        found = mbdlft.matrices_at(linear, {"L": L})
        roundoff(np.array([found.A[0, 0], found.C[0, 0]]), np.array([A(L), C(L)]))


def test_a_trim_that_does_not_depend_on_parameters_has_no_signals() -> None:
    model = mbdlft.linearize_dae(of_modes("Boolean b;", "b = true", at={"u": 0.0})[1])
    assert model.trim.signals == ()
    assert mbdlft.trim_at(model, {}).shape == (0,)
    assert mbdlft.trim_at(model, {"L": [1.0, 2.0, 3.0]}).shape == (3, 0)


def test_a_simulation_ends_where_a_mode_changes() -> None:
    dae, _ = of_modes("Boolean b;", "b = x > 0.1")
    late, times = {"u": 0.0}, np.linspace(0.0, 2.0, 21)
    x = mbdlft.simulate(dae, times[:8], inputs=late).states[:, 0]  # 0.5 exp(-2 t) > 0.1 to t = 0.805
    target(x, 0.5 * np.exp(-2.0 * times[:8]), SIMULATED)
    with pytest.raises(mbdlft.AnalysisError, match=r"b = x > 0\.1: this changes, .* at 0\.9 s"):
        mbdlft.simulate(dae, times, inputs=late)


test_what_changes_within_the_range_is_refused = refused(
    """
> of_modes({}) => NotRationalError: changes its branch inside of the range of L
"Boolean b;", "b = L > 1.5"
"Boolean b;", "b = x > 0.4"
"Boolean b;", "b = x > 0.4 or pre(b) and x > 0.35"
"Boolean a; Boolean b;", "a = x > 0.4; b = not a"
"Integer n; Boolean b = n > 1;", "n = if L > 1.5 then 2 else 1"
> of_modes({}) => TrimError:
"Boolean b = true;", 'assert(x < 0.9, "long")' => assert(x < 0.9) does not hold. long At L = 1
"Boolean b;", "b = x > 0.1", {"u": 0.05} => it is 0 at this equilibrium, and 1 in the equations
"Boolean b;", "b = u > 0", {"u": 0} => b = u > 0: jumps from … to … at this equilibrium
> mbdlft.delta_theta(of_modes("Boolean b;", {})[0]) => StructureError:
"b = x > 0.1" => b = x > 0.1: these equations are those of one operating point
"""
)


# Laws of the tables of the Modelica library, as records and values of them.

ROWS = ((0, 1, 5), (2, -3, 5), (3, 4, 6), (7, 0, 2))
TIMES = np.linspace(-4.3, 12.9, 87)
NAMES = {
    "TimeTable": "tableName fileName table startTime columns smoothness extrapolation shiftTime",
    "Table1D": "tableName fileName table columns smoothness extrapolation",
}


def function(name: str, inputs: str = "") -> tree.Function:
    return tree.Function(name, tuple(tree.Declaration(n, "Real", 0) for n in inputs.split()), (), (), ())


def table(
    kind: str, smoothness: str, extrapolation: str, rows: Any = ROWS, start: Any = 0, shift: Any = 0
) -> Any:
    values = {
        **dict.fromkeys(("tableName", "fileName"), "NoName"),
        "table": tuple(tuple(map(Fraction, row)) for row in rows),
        **{"startTime": Fraction(start), "shiftTime": Fraction(shift)},
        "columns": (Fraction(2), Fraction(3)),
        **{"smoothness": smoothness, "extrapolation": extrapolation},
    }
    name = f"Modelica.Blocks.Types.ExternalCombi{kind}"
    make = of_tables(name, function(name, NAMES[kind]))
    assert make is not None
    return make(*(values[key] for key in NAMES[kind].split()))


def got(kind: str, of: Any, column: int, at: float) -> tuple[float, float]:
    """The value at a number, and that of the expression of a symbol."""
    name = f"Modelica.Blocks.Tables.Internal.get{kind}Value"
    look = of_tables(name, function(name))
    assert look is not None
    u = ca.SX.sym("u")
    number, expression = (look(of, Fraction(column), x) for x in (Fraction(at), u))
    return float(number), float(ca.Function("f", [u], [in_doubles(expression)])(at))


@pytest.mark.parametrize("column", [1, 2])
def test_lines_are_those_of_numpy_and_go_on_with_the_last_slopes(column: int) -> None:
    x, y = np.array(ROWS, dtype=float)[:, (0, column)].T
    held, on = (table("Table1D", "LinearSegments", e) for e in ("HoldLastPoint", "LastTwoPoints"))
    for u in TIMES:
        expected = np.interp(u, x, y)
        roundoff(got("Table1D", held, column, u), [expected] * 2)
        k = 0 if u < x[0] else len(x) - 2
        if not x[0] <= u <= x[-1]:
            expected = y[k] + (y[k + 1] - y[k]) / (x[k + 1] - x[k]) * (u - x[k])
        roundoff(got("Table1D", on, column, u), [expected] * 2)


def test_steps_of_time_begin_at_their_points_shifted_and_after_the_start() -> None:
    held = table("TimeTable", "ConstantSegments", "HoldLastPoint", start="-1", shift="0.5")
    again = table("TimeTable", "ConstantSegments", "Periodic", start="-1000")
    x, y = np.array(ROWS, dtype=float)[:, :2].T
    for t in TIMES:
        step = y[max(np.searchsorted(x, t - 0.5, side="right") - 1, 0)]
        exact(got("TimeTable", held, 1, t), [step if t >= -1.0 else 0.0] * 2)
        exact(got("TimeTable", again, 1, t), [y[np.searchsorted(x, t % 7.0, side="right") - 1]] * 2)


def test_two_points_of_one_time_are_a_jump_to_the_second() -> None:
    jump = table("TimeTable", "LinearSegments", "HoldLastPoint", ((0, 1), (1, 3), (1, 7), (2, 7)))
    exact([got("TimeTable", jump, 1, t) for t in (0.5, 1.0, 1.5)], [[2.0] * 2, [7.0] * 2, [7.0] * 2])


def test_ends_are_those_of_the_rows() -> None:
    of = table("Table1D", "LinearSegments", "HoldLastPoint")
    for name, end in (("Table1DAbscissaUmin", 0), ("Table1DAbscissaUmax", 7)):
        whole = f"Modelica.Blocks.Tables.Internal.get{name}"
        look = of_tables(whole, function(whole))
        assert look is not None
        assert look(of) == end


test_what_is_no_table_of_lines_or_steps_is_refused = refused(
    r"""
> table({}) => SceneError:
"Table1D", "ContinuousDerivative", "HoldLastPoint", ROWS => ContinuousDerivative
"Table1D", "ConstantSegments", "LastTwoPoints", ROWS => known is HoldLastPoint
"Table1D", "LinearSegments", "Periodic", ROWS => Periodic
"Table1D", "LinearSegments", "HoldLastPoint", ((0, 1, 1), (0, 2, 2)) => increase: 0, 0
"TimeTable", "LinearSegments", "HoldLastPoint", ((1, 1, 1), (0, 2, 2)) => increase: 1, 0
"Table1D", "LinearSegments", "HoldLastPoint", () => no rows
"""
)
