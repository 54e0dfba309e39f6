"""Laws of tables: what is lines or cubic polynomials of one argument is found, kept, read and bounded."""

from fractions import Fraction
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

import mbdlft
from mbdlft.analyze import sector_bounds, slope_bounds
from mbdlft.base import Parameter
from mbdlft.base.errors import AnalysisError
from mbdlft.dae import DaeDraft, evaluate_form, formula_function
from mbdlft.dae.theta.piecewise import piecewise_of
from mbdlft.pipeline import delta_theta
from mbdlft.system import DeltaThetaModel, Table, ThetaFunction
from tests.close import CLOSED_FORM, ENCLOSURE, exact, target
from tests.daes import dae_of

R = np.random.default_rng(7)
FREE = ((-np.inf, np.inf),)
A = np.union1d(np.linspace(-4.0, 4.0, 4001), R.uniform(-4, 4, 500))


def points(count: int) -> tuple[np.ndarray, np.ndarray]:
    b = np.unique(np.round(R.uniform(-3, 3, count), 2))
    return b, np.round(np.cumsum(R.normal(size=len(b))), 2)


def form_with(interpolation: str, beyond: str, count: int = 12) -> tuple[DeltaThetaModel, np.ndarray]:
    """rate = -x + p f(x) + u, and f at A by scipy."""
    b, v = points(count)
    d = DaeDraft("looked_up")
    x, u, y = d.variable("x"), d.input("u"), d.variable("y")
    p = d.parameter(Parameter("p", 2.0, percent=10))
    d.equation(d.der(x), equals=-x + p * y + u)
    d.equation(y, "y", equals=d.table(x, b, v, interpolation, beyond))  # type: ignore[arg-type]
    d.output("x")
    cubic = PchipInterpolator(b, v)
    inside = np.interp(A, b, v) if interpolation == "linear" else cubic(np.clip(A, b[0], b[-1]))
    chords = np.diff(v) / np.diff(b)
    ends = chords[[0, -1]] if interpolation == "linear" else cubic.derivative()(b[[0, -1]])
    outside = ends[0] * np.minimum(A - b[0], 0) + ends[1] * np.maximum(A - b[-1], 0)
    return delta_theta(d.dae(), search=0.0), inside + (outside if beyond == "lines" else 0.0)


@pytest.mark.parametrize("beyond", ["lines", "constant"])
@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_a_table_is_one_function_and_its_values_are_kept(
    interpolation: str, beyond: str, tmp_path: Path
) -> None:
    model, expected = form_with(interpolation, beyond)
    (f,) = model.functions
    assert (f.text, len(f.tables)) == ("table1(x)", 1)
    assert bool(f.tables[0].slopes) == (interpolation == "cubic")
    target(f(A), expected, CLOSED_FORM)
    own = formula_function("f", f.arguments, f.text, f.tables)
    target(own.map(len(A))(A).full()[0], expected, CLOSED_FORM)
    target([float(f.tables[0].exactly(Fraction(a))) for a in A[::40]], expected[::40], CLOSED_FORM)
    mbdlft.save(tmp_path / "a.h5", model)
    again = mbdlft.load(tmp_path / "a.h5")
    assert again.functions == model.functions
    rates, _ = evaluate_form(again, {"x": A[300]}, {"u": 0.5}, {"p": 1.9})
    target(rates["x"], -A[300] + 1.9 * expected[300] + 0.5, CLOSED_FORM)


def test_several_tables_of_one_archive(tmp_path: Path) -> None:
    b = [-1.0, 0.0, 1.0, 2.0]
    d = DaeDraft("two")
    x, y = d.variable("x"), d.variable("y")
    first, second = d.table(x, b, [3, 1, 2, 0], "cubic"), d.table(y, b, [0, 1, 0, 2], "cubic")
    d.equation(d.der(x), equals=first * second)
    d.equation(d.der(y), equals=ca.sin(d.table(x, b, [2, 1, 3, 0])) - y)
    d.output("x")
    model = delta_theta(d.dae(), search=0.0)
    assert sorted(len(f.tables) for f in model.functions) == [1, 2]
    mbdlft.save(tmp_path / "a.h5", model)
    assert mbdlft.load(tmp_path / "a.h5").functions == model.functions


def test_sums_of_kinks_are_tables_and_jumps_are_not() -> None:
    x = ca.SX.sym("x")
    kinks = 2 + 3 * x - ca.fmax(0, x - 0.5) + 2 * ca.fmin(x, 1) - ca.fabs(x + 1) / 2
    found = piecewise_of(kinks, x)
    assert found is not None
    table = found.table()
    assert table is not None
    assert table.breakpoints == (-1.0, 0.5, 1.0)
    target(table(A), np.array(ca.Function("f", [x], [kinks]).map(len(A))(A)).ravel(), CLOSED_FORM)
    more = kinks + ca.fmax(0, x - 2)
    spike = ca.if_else(ca.logic_and(x <= 3, ca.logic_not(x < 3)), 1, 0)
    for other in (more + spike, more + ca.if_else(x < 3, 1, 0), more + x * x, ca.sin(more)):
        found = piecewise_of(other, x)
        assert found is None or found.table() is None


def test_what_is_linear_and_constant_beside_kinks_is_in_the_table() -> None:
    dae = dae_of(
        "kinks",
        "x y z",
        "der(x) = u - p*y - z",
        "y = 1 + 3*x + fmax(0, x - 1) - fmax(0, x - 2) + fmin(0, x + 1)",
        "p*z = p*(fabs(x) + fabs(x - 1) + fabs(x + 1)) + x",
        inputs="u",
        outputs="x",
        parameters=[Parameter("p", 2.0, percent=10)],
    )
    for arrange in ("fewest", "blocks"):
        model = delta_theta(dae, arrange, search=0.0)  # type: ignore[arg-type]
        assert [len(f.tables) for f in model.functions] == [1, 1]
        assert not model.has_one
        rates, _ = evaluate_form(model, {"x": 1.5}, {"u": 0.25}, {"p": 1.8})
        y_there, z_there = 1 + 4.5 + 0.5, 1.5 + 0.5 + 2.5 + 1.5 / 1.8
        target(rates["x"], 0.25 - 1.8 * y_there - z_there, CLOSED_FORM)


@pytest.mark.parametrize("cubic", [False, True])
def test_sectors_of_tables_are_exact_between_the_points(cubic: bool) -> None:
    slopes = ((0.1, 0.5), (0.5, 0.5), (0.5, 0.2)) if cubic else ()
    table = Table((-2.0, -1.0, 1.0, 2.5), (-1.0, -0.5, 0.5, 3.0), 0.1, 0.2, slopes)
    f = ThetaFunction("f", ("s",), ("a",), "table1(a)", FREE, tables=(table,))
    found = sector_bounds(f, -5.0, 5.0)
    a = np.union1d(np.linspace(-5.0, 5.0, 20001), table.breakpoints)
    a = a[np.abs(a) > 1e-9]
    ratio, slope = table(a) / a, np.diff(table(a)) / np.diff(a)
    for (low, high), of in ((found.sector, ratio), (found.slope, slope)):
        assert low <= np.min(of) + 1e-12
        assert high >= np.max(of) - 1e-12
        assert max(np.min(of) - low, high - np.max(of)) < (0.01 if cubic else 1e-9)
    for k in R.uniform(-6, 6, 60):
        box = sorted((k, k + R.exponential()))
        bounds = slope_bounds(f, [tuple(box)], boxes=1)[0]
        inside = np.linspace(*box, 301)
        between = np.diff(table(inside)) / np.diff(inside)
        assert bounds[0] <= np.min(between) + 1e-9
        assert np.max(between) - 1e-9 <= bounds[1]


def test_slopes_by_several_arguments() -> None:
    f = ThetaFunction("f", ("s", "t"), ("a", "b"), "a*sin(b) + b**2", (*FREE, *FREE))
    (low_a, high_a), (low_b, high_b) = slope_bounds(f, [(0.0, 1.0), (-0.5, 0.5)])
    target([low_a, high_a], [-np.sin(0.5), np.sin(0.5)], ENCLOSURE)
    target([low_b, high_b], [-1.0, 1.0 + np.cos(0.5)], ENCLOSURE)
    assert low_b <= -1.0
    assert high_b >= 1.0 + 1.0 * np.cos(0.5)


def test_a_table_at_points() -> None:
    table = Table((0.0, 1.0), (2.0, 4.0), -1.0, 0.5)
    exact(table([-1.0, 0.0, 0.25, 1.0, 3.0]), [3.0, 2.0, 2.5, 4.0, 5.0])


@pytest.mark.parametrize(
    ("text", "slopes"),
    [
        ("tanh(a/0.001)", (0.0, 1000.0)),  # 1/cosh^2 of 2000 would overflow
        ("asinh(a)", (1.0 / np.sqrt(5.0), 1.0)),
        ("hypot(a, 1)", (-2.0 / np.sqrt(5.0), 2.0 / np.sqrt(5.0))),
        ("where(and_(a < 5, not_(a == 7)), a, 0)", (1.0, 1.0)),
    ],
)
def test_slopes_of_functions(text: str, slopes: tuple[float, float]) -> None:
    found = sector_bounds(ThetaFunction("f", ("s",), ("a",), text, FREE), -2.0, 2.0).slope
    assert found[0] <= slopes[0]
    assert found[1] >= slopes[1]
    target(found, slopes, 1e-2 * slopes[1])


@pytest.mark.parametrize(
    "text",
    ["where(a == 0, 1, a)", "(0 < a)*2", "where(not_(a), 1, 0)", "where(or_(a < -1, 1 < a), 1, a)"],
)
def test_conditions_that_change_may_jump(text: str) -> None:
    found = sector_bounds(ThetaFunction("f", ("s",), ("a",), text, FREE), -2.0, 2.0)
    exact(found.slope, [-np.inf, np.inf])
    assert found.values[0] <= 0.0
    assert found.values[1] >= 1.0


@pytest.mark.parametrize("ranges", [[(-np.inf, 1.0)], [(0.0, 1.0), (0.0, 1.0)]])
def test_slopes_need_a_finite_range_of_each_argument(ranges: list[tuple[float, float]]) -> None:
    f = ThetaFunction("f", ("s",), ("a",), "a**2", FREE)
    with pytest.raises(AnalysisError, match="expected a finite range of each of the arguments a"):
        slope_bounds(f, ranges)
