"""Laws of equilibria of DAEs: fits with a proved bound, large linear blocks, sizes, units."""

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.base import Angle, NotRationalError, Parameter, SceneError, TrimError
from mbdlft.dae import Dae, DaeDraft, reduce_index, trim
from mbdlft.dae.balance import solved_linear
from mbdlft.dae.linear import linearized, slopes_of, trim_sizes, trimmed_points
from mbdlft.modelica import flat_model, modelica_table_from_toml, operating_point, translate
from mbdlft.pipeline import delta_theta, linearize_dae
from mbdlft.problem.sx.constants import in_doubles
from tests.close import CLOSED_FORM, Method, target
from tests.daes import pendulum


def tank() -> Dae:
    """0 = q - k sqrt(h) - h^2/20, with what flows out as a variable of its own."""
    d = DaeDraft("tank")
    a, k = (d.parameter(Parameter(n, x, percent=20)) for n, x in (("a", 2.0), ("k", 0.5)))
    h, out, q = d.variable("h", start=4.0), d.variable("out", start=1.0), d.input("q", start=1.0)
    d.equation(a * d.der(h), equals=q - out)
    d.equation(out, equals=k * ca.sqrt(h) + h * h / 20)
    d.output("h")
    d.output("root", ca.sqrt(h))
    return d.dae()


def points_of(dae: Dae, count: int = 40) -> tuple[dict[str, np.ndarray], np.ndarray]:
    drawn = mbdlft.random(dae.parameters, count, seed=3)
    return drawn, np.stack([drawn[p.name] for p in dae.parameters], axis=1)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-7])
def test_fits_of_an_equilibrium_and_of_slopes_there_are_within_the_bound(tolerance: float) -> None:
    dae = tank()
    s = reduce_index(dae)
    at = trim(s, fit=tolerance)
    assert 0.0 < at.fit_bound <= tolerance
    model = linearize_dae(at, search=0.0)
    assert model.certificate.fit_error_bound == at.fit_bound
    assert not model.certificate.exact
    assert model.certificate.max_relative_error < 1e-12
    values, points = points_of(dae)
    z = trimmed_points(at, points)
    names = [q.name for q in (*s.unknowns, *s.states, *s.inputs)]
    height = mbdlft.trim_at(model, values)[..., [t.name for t in model.trim.signals].index("h")]
    nominal = trim(s, fit=1e-9).nominal["h"]
    found = np.abs(np.ravel(height) - z[:, names.index("h")])
    assert np.max(found) <= at.fit_bound * nominal * (1 + 1e-9)
    assert np.max(found) > 1e-5 * at.fit_bound
    A, _, C, _ = mbdlft.matrices_at(model, values)
    truth = linearized(s, slopes_of(s), z, points)
    slope = 0.25 / np.sqrt(nominal) + 0.1 * nominal  # of what flows out, at nominal
    assert np.max(np.abs(A[:, 0, 0] - truth[:, 0, 0])) <= 4.0 * at.fit_bound * slope
    assert np.max(np.abs(C[:, 1, 0] - truth[:, 2, 0])) <= at.fit_bound
    known = values["k"] * np.sqrt(z[:, names.index("h")]) + z[:, names.index("h")] ** 2 / 20
    target(known, np.ones(len(points)), 1e-10)


def test_slopes_are_fitted_where_the_equilibrium_is_rational() -> None:
    """0 = q - k sqrt(h): h = (q/k)^2 is exact, and the slope k/(2 sqrt(h)) = k^2/(2 q) is a root."""
    d = DaeDraft("outflow")
    k = d.parameter(Parameter("k", 0.5, percent=20))
    h, q = d.variable("h", start=4.0), d.input("q", start=1.0)
    d.equation(d.der(h), equals=q - k * ca.sqrt(h))
    d.output("h")
    model = linearize_dae(d.dae(), fit=1e-8)
    assert 0.0 < model.certificate.fit_error_bound <= 1e-8
    k_values = np.linspace(0.4, 0.6, 7)
    A = mbdlft.matrices_at(model, {"k": k_values}).A[:, 0, 0]
    target(A, -(k_values**2) / 2, 1e-8)
    target(np.ravel(mbdlft.trim_at(model, {"k": k_values})[..., 0]), k_values**-2.0, CLOSED_FORM)


def test_what_is_exact_stays_exact_with_a_tolerance() -> None:
    d = DaeDraft("exact")
    p = d.parameter(Parameter("p", 2.0, percent=20))
    x, u = d.variable("x"), d.input("u", start=1.0)
    d.equation(d.der(x), equals=u - p * x)
    d.output("x")
    model = linearize_dae(d.dae(), fit=1e-6)
    assert model.certificate.exact
    assert model.certificate.minimal


def test_fits_of_a_modelica_model() -> None:
    text = """
model Tank
  parameter Real k(min=0.4, max=0.6) = 0.5;
  input Real q(start=1);
  output Real h(start=4);
equation
  der(h) = q - k*sqrt(h) - 0.05*h*h;
end Tank;
"""
    dae, report = translate(flat_model(text))
    begin = 'format = "mbdlft-modelica/1"\n[trim]\n'
    with pytest.raises(NotRationalError, match="fit=1e-6"):
        operating_point(dae, report, modelica_table_from_toml(begin))
    at = operating_point(dae, report, modelica_table_from_toml(begin + "fit = 1e-5\n"))
    assert 0.0 < at.fit_bound <= 1e-5
    for wrong in ("0", "true", '"x"', "2.0"):
        with pytest.raises(SceneError, match="trim: fit: expected a tolerance"):
            modelica_table_from_toml(begin + f"fit = {wrong}\n")


def test_what_cannot_be_fitted() -> None:
    d = DaeDraft("hard")
    p = d.parameter(Parameter("p", 2.0, percent=20))
    x = d.variable("x", start=0.7)
    d.equation(d.der(x), equals=p - ca.exp(x))
    d.output("x")
    with pytest.raises(NotRationalError):
        linearize_dae(d.dae(), fit=1e-6)
    d = DaeDraft("turned")
    angle = d.parameter(Angle("angle", 30.0, plus=10.0))
    x = d.variable("x", start=0.7)
    d.equation(d.der(x), equals=ca.sin(angle) - x**3)
    d.output("x")
    with pytest.raises(NotRationalError, match="depends on the angle angle"):
        linearize_dae(d.dae(), fit=1e-6)
    d = DaeDraft("fold")
    p = d.parameter(Parameter("p", 1.0, 0.0, 2.0))
    x = d.variable("x", start=0.7)
    d.equation(d.der(x), equals=p - x * x)  # no slope at p = 0
    d.output("x")
    with pytest.raises(TrimError):
        linearize_dae(d.dae(), fit=1e-6)


def test_linear_blocks_of_many_unknowns_are_solved() -> None:
    p = ca.SX.sym("p", 3)
    drawn = np.random.default_rng(8)
    for n in (2, 7, 12):
        numbers = np.round(drawn.standard_normal((n, n)), 2)
        numbers[drawn.random((n, n)) < 0.4] = 0.0
        matrix = ca.SX(numbers + 4 * np.eye(n)[drawn.permutation(n)])
        for _ in range(n):
            i, j, k = drawn.integers(n), drawn.integers(n), drawn.integers(3)
            matrix[i, j] = matrix[i, j] + p[k]
        right = ca.SX(np.round(drawn.standard_normal(n), 2)) * p[0]
        found = ca.vertcat(*solved_linear(ca.sparsify(matrix), right))
        both = ca.Function("both", [p], [in_doubles(found), ca.densify(matrix), right])
        for at in drawn.uniform(1, 2, (5, 3)):
            x, A, b = (part.full() for part in both(at))
            target(x, np.linalg.solve(A, b), 1e-9)


def test_a_block_of_eight_is_exact() -> None:
    d = DaeDraft("ladder")
    g, r = (d.parameter(Parameter("g", 2.0, percent=20)), d.parameter(Parameter("r", 1.0, percent=20)))
    u, x = d.input("u", start=1.0), d.variable("x")
    v = [d.variable(f"v{i}", start=0.5) for i in range(8)]
    for i in range(8):
        left, right = (u if i == 0 else v[i - 1]), (0 if i == 7 else v[i + 1])
        d.equation([g, r, 1][i % 3] * (left - v[i]) + right - v[i] + v[(i + 3) % 8] / 10, equals=0)
    d.equation(d.der(x), equals=-x * v[4])
    d.output("x")
    s = reduce_index(d.dae())
    assert max(len(block.rows) for block in s.blocks) > 6
    at = trim(s)
    _, points = points_of(s.dae, 5)
    names = [q.name for q in (*s.unknowns, *s.states, *s.inputs)]
    value = ca.Function("v4", [s.dae.p], [in_doubles(ca.SX(at.values["v4"]))])
    z = trimmed_points(at, points)
    target([float(value(p)) for p in points], z[:, names.index("v4")], Method(1e-10))


def test_a_trimmed_quantity_is_as_large_as_its_terms() -> None:
    """x = a - b is zero at nominal, and rounding of a and b is what may be left of it."""
    d = DaeDraft("balanced")
    a, b = (d.parameter(Parameter(n, 3e6, percent=1e-9)) for n in "ab")
    x, y = d.variable("x"), d.variable("y")
    d.equation(d.der(x), equals=a - b - x)
    d.equation(d.der(y), equals=-y + x / 1000)
    d.output("x")
    s = reduce_index(d.dae())
    at = trim(s)
    points = np.array([[3e6, 3e6], [3e6 + 1e-5, 3e6]])
    z = trimmed_points(at, points)
    names = [q.name for q in (*s.unknowns, *s.states, *s.inputs)]
    size = dict(zip(names, trim_sizes(at, points, z), strict=True))
    assert 6e6 <= size["x"] < 7e6
    assert 6e3 <= size["y"] < 7e3
    assert size["der(x)"] == 0.0


def test_functions_and_arguments_have_units() -> None:
    model = delta_theta(pendulum(0.3), search=0.0, prove=0.0)
    units = {s.name: s.unit for s in (*model.linear.inputs, *model.linear.outputs)}
    by_text = {f.text: f.unit for f in model.functions}
    assert by_text["x**2"] == "m^2"
    assert by_text["x*vx"] == "m^2 s^-1"
    assert units["omega.x"] == "m"
    assert units["omega.vx"] == "m/s"
    assert units["omega.F"] == "N"
    assert all(units[f.name] == f.unit for f in model.functions)
    d = DaeDraft("nested")
    p, q = (d.parameter(Parameter(n, 2.0, percent=10, unit="1/m")) for n in "pq")
    x, y = d.variable("x", "m"), d.variable("y", "m")
    d.equation(d.der(x), equals=-((x**2 * p + y**2 * q) ** 2) * d.number(3))
    d.equation(d.der(y), equals=-y * d.number(2))
    d.output("x")
    nested = delta_theta(d.dae(), search=0.0, prove=0.0)
    assert [f.unit for f in nested.functions] == ["m^2"] * 3
    assert "m" in {s.unit for s in nested.linear.outputs if s.name.startswith("omega")}
    d = DaeDraft("other")
    x, v = d.variable("x", "mm"), d.variable("v", "mm/s")
    d.equation(d.der(x), equals=v)
    d.equation(d.der(v), equals=-d.number(1) * x - ca.atan(d.number(0.1) * x) * v * d.number(-1))
    d.output("x")
    (f,) = delta_theta(d.dae(), search=0.0, prove=0.0).functions
    assert f.unit == "1"  # a number has any unit, and nothing is said of mm
