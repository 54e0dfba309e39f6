"""Laws of the structure of DAEs: index, states, order of solving, aliases, and linear models of them."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import mbdlft
from mbdlft.base import NotRationalError, Parameter
from mbdlft.base.errors import SceneError, TrimError
from mbdlft.dae import DaeDraft, from_casadi, reduce_index, start_point, trim
from mbdlft.dae.alias import eliminate_aliases
from mbdlft.dae.balance import solved_linear
from mbdlft.dae.dae import Dae
from mbdlft.dae.index import Entry, differentiated
from mbdlft.dae.initial import guessed, point_by_orders
from mbdlft.dae.linear import linearized, slopes_of, trim_sizes, trimmed_points
from mbdlft.dae.newton import System, follow_all
from mbdlft.modelica import flat_model, modelica_table_from_toml, operating_point, translate
from mbdlft.pipeline import delta_theta, linearize_dae
from mbdlft.problem.sx.constants import in_doubles
from tests.close import CLOSED_FORM, CROSS, Method, roundoff, target
from tests.daes import Known, coupled_inertias, dae_of, example_2, pendulum, random_dae, servo
from tests.seeds import some

FREQUENCIES = (0.37, 1.3, 9.0)


def _transfer(A, B, C, D, w):  # type: ignore[no-untyped-def]
    return C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B) + D


def test_solutions_stay_on_the_branch_of_the_first() -> None:
    """sin z = q from q = -0.99: Newton's first step from there to 0.99 is 14 rad long."""
    z, q = ca.SX.sym("z"), ca.SX.sym("q")
    ends = np.array([[0.99], [-0.5], [0.999], [0.4]])
    start, first = np.arcsin(np.array([-0.99])), np.array([-0.99])
    found = follow_all(System(ca.sin(z) - q, z, q), start, first, ends, np.ones(1))
    target(np.array([at.values for at in found]), np.arcsin(ends), CLOSED_FORM)


def _as_known(known: Known, seed: int) -> None:
    structure = reduce_index(known.dae, states=known.states)
    assert structure.index == known.index
    model = linearize_dae(structure, search=0.0, prove=0.0)
    drawn = np.random.default_rng(seed)
    for _ in range(2):
        values = {p.name: float(drawn.uniform(p.low, p.high)) for p in known.dae.parameters}
        ordered = [values[f"p{k}"] for k in range(len(values))]
        A, B, C = (part.full() for part in known.matrices(ordered))
        found = mbdlft.matrices_at(model, values)
        for w in FREQUENCIES:
            expected = _transfer(A, B, C, 0.0, w)
            size = max(float(np.max(np.abs(expected))), 1e-3)
            target(_transfer(*found, w), expected, CROSS, scale=size)


@pytest.mark.parametrize("seed", some(range(4), range(224)))
def test_random_daes_have_the_known_linear_model(seed: int) -> None:
    _as_known(random_dae(seed), seed)


@pytest.mark.long
def test_index_is_that_of_casadi() -> None:
    """`casadi.dae_reduce_index` has Pantelides' algorithm of its own."""
    for dae in (pendulum(), coupled_inertias()):
        x = [v for v in dae.variables if v.derivative is not None]
        z = [v for v in dae.variables if v.derivative is None]
        u = ca.vertcat(*(v.symbol for v in dae.inputs))
        free = ca.substitute(ca.vertcat(*(e.residual for e in dae.equations)), u, 0)
        given = {
            "x_impl": ca.vertcat(*(v.symbol for v in x)),
            "dx_impl": ca.vertcat(*(v.derivative for v in x)),
            "z": ca.vertcat(*(v.symbol for v in z)),
            "p": ca.vertcat(dae.p, *ca.symvar(free)[:0]),
            "alg": ca.SX(mbdlft.problem.sx.constants.in_doubles(free)),
        }
        _, stats = ca.dae_reduce_index(given, {})
        assert reduce_index(dae).index == stats["index"]


def test_states_can_be_chosen() -> None:
    chosen = reduce_index(pendulum(0.6), states=["y", "vy"])
    assert [q.name for q in chosen.states] == ["y", "vy"]
    assert len(reduce_index(pendulum(0.6)).states) == 2


def test_blocks_are_in_the_order_of_solving() -> None:
    for dae in (example_2(), pendulum(), servo()):
        s = reduce_index(dae)
        pattern = ca.DM(ca.jacobian_sparsity(s.residual, s.unknown), 1.0).full()
        known: set[int] = set()
        for block in s.blocks:
            known |= set(block.columns)
            for row in block.rows:
                assert set(np.flatnonzero(pattern[row])) <= known
        assert known == set(range(len(s.unknowns)))


def test_aliases_are_what_they_say() -> None:
    s = reduce_index(example_2())
    of = {a.name: (a.of, float(a.factor)) for a in s.aliases}
    assert of["J2.flange_b.tau"] == (None, 0.0)
    assert of["J1.flange_a.tau"] == ("tau", 1.0)
    assert of["sensor.phi"] == ("J2.phi", 1.0) or of["J2.phi"] == ("sensor.phi", 1.0)
    assert "8 blocks" in str(s) or "9 blocks" in str(s)


def test_negative_aliases_and_numbers() -> None:
    equations = ("der(x) + 2*x = u + c", "minus: y + x", "-z = y", "number: 2*c = number(0.3)")
    s = reduce_index(dae_of("signs", "x y z c", *equations, inputs="u", outputs="z"))
    assert {str(a) for a in s.aliases} == {"y = -x", "z = x", "c = 0.15"}
    model = linearize_dae(s)
    assert mbdlft.matrices_at(model, {}).A[0, 0] == -2.0


def test_solving_begins_at_what_is_known_then_near_then_at_starts() -> None:
    laws = [f"der({name}) + {name}" for name in "xyz"]
    s = reduce_index(dae_of("near", "x=1 y=2 z=3", *laws, outputs="x"))
    assert s.near_start(s.dae.variables) is None
    s = replace(s, near={"y": 4.0, "z": 5.0})
    begin = s.near_start(s.dae.variables, {"z": 6.0})
    assert begin is not None
    assert begin.tolist() == [1.0, 4.0, 6.0]


def test_a_builder_of_casadi() -> None:
    b = ca.DaeBuilder("tank")
    h, q, u = b.add("h", "output"), b.add("q"), b.add("u", "input")
    a, c = b.add("a", "parameter", "tunable"), b.add("c", "parameter", "tunable")
    b.set_min("a", 1.0)
    b.set_max("a", 3.0)
    b.set_nominal("a", 2.0)
    b.set_start("c", 0.3)
    b.eq(b.der(h), (u - q) / a)
    b.eq(0, q - c * h - h**3)
    dae = from_casadi(b)
    assert [p.name for p in dae.parameters] == ["a"]
    model = linearize_dae(dae)
    values = np.array([1.0, 2.0, 3.0])
    target(mbdlft.matrices_at(model, {"a": values}).A[:, 0, 0], -0.3 / values, CROSS)
    assert linearize_dae(from_casadi(b, [Parameter("c", 0.3, percent=10)])).order == 2


def test_derivatives_of_inputs_can_be_inputs() -> None:
    imposed = dae_of(
        "imposed", "x[m] v[m/s] F[N]", "v: der(x) = v", "F: m*der(v) = F", "drive: x = 2*u",
        inputs="u[m]", outputs="F", parameters=[Parameter("m", 2.0, percent=10, unit="kg")],
    )  # fmt: skip
    s = reduce_index(imposed, input_rates="inputs")
    assert [q.name for q in s.inputs] == ["u", "der(u)", "der(u, 2)"]
    D = mbdlft.matrices_at(linearize_dae(s), {"m": 2.1}).D
    target(D, [[0.0, 0.0, 4.2]], CROSS)


def test_a_number_takes_the_unit_of_what_it_is_added_to() -> None:
    with pytest.raises(SceneError, match=r"equation 'sum': m and s are added"):
        reduce_index(dae_of("units", "x[m] t[s]", "sum: 3 + x = t", "rate: der(x) = 1"))


# A consistent point of a loop, order after order: closed forms of a slider crank.

CRANK, ROD, ANGLE, SPEED = 0.4, 1.1, 0.3, 2.0


def slider_crank(guess: float) -> Dae:
    """Entries of the rotations of crank and rod are variables, and no start is known of them."""
    d = DaeDraft("crank")
    m = d.parameter(mbdlft.Parameter("m", 2.0, percent=20))
    phi, w = d.variable("phi", start=ANGLE, fixed=True), d.variable("w", start=SPEED, fixed=True)
    x = d.variable("x", start=-0.7 * np.sign(np.cos(guess)))  # of the other assembly
    psi, force = d.variable("psi", start=guess), d.variable("force")
    arms = [[d.variable(f"R{k}{i}") for i in range(2)] for k in range(2)]
    for (c, s), angle in zip(arms, (phi, psi), strict=True):
        d.equation(c, equals=ca.cos(angle))
        d.equation(s, equals=ca.sin(angle))
    (c, s), (e, f) = arms
    d.equation(CRANK * s + ROD * f, "closure")
    d.equation(x, equals=CRANK * c + ROD * e)
    d.equation(w, equals=d.der(phi))
    v = d.variable("v")
    d.equation(v, equals=d.der(x))
    d.equation(m * d.der(v), equals=force)
    d.equation(d.der(w), equals=-force)
    d.output("x")
    return d.dae()


@pytest.mark.parametrize(("guess", "side"), [(0.2, 1.0), (2.8, -1.0)])
def test_the_assembly_and_the_rates_are_those_near_the_starts(guess: float, side: float) -> None:
    dae, _ = eliminate_aliases(slider_crank(guess))
    d = differentiated(dae)
    known = point_by_orders(d, [], np.array([2.0]), {"psi"})
    assert known is not None
    names = [v.name for v in dae.variables]
    psi, x, rate = (known[Entry(names.index(n), k)] for n, k in (("psi", 0), ("x", 0), ("x", 1)))
    sine, slope = -CRANK / ROD * np.sin(ANGLE), -CRANK / ROD * np.cos(ANGLE) * SPEED
    cosine = side * np.sqrt(1.0 - sine**2)
    roundoff([np.sin(psi), np.cos(psi)], [sine, cosine])
    roundoff(x, CRANK * np.cos(ANGLE) + ROD * cosine)
    roundoff(rate, -CRANK * np.sin(ANGLE) * SPEED - ROD * sine * slope / cosine)
    values = np.array([known[entry] for entry in d.symbols])
    residual = ca.vertcat(*d.residuals.values())
    symbols = [ca.vertcat(*d.symbols.values()), dae.p]
    missed = ca.Function("missed", symbols, [in_doubles(residual)])(values, [2.0])
    roundoff(missed.full()[:, 0], np.zeros(missed.numel()))


def test_the_start_of_a_structure_is_that_assembly() -> None:
    at = start_point(reduce_index(slider_crank(2.8), preferred=["psi", "phi"]))
    assert np.cos(at.nominal["psi"]) < -0.9
    roundoff(at.nominal["phi"], ANGLE)


def test_a_guess_goes_from_one_equation_to_the_next() -> None:
    a, b, c, q = ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("c"), ca.SX.sym("q")
    system = System(ca.vertcat(c - a * b, 2 * b - ca.cos(a)), ca.vertcat(a, b, c), q)
    z = guessed(system, np.array([0.5, 7.0, 9.0]), np.array([0.0]), [[0], [2], [1]])
    roundoff(z, [0.5, np.cos(0.5) / 2, np.cos(0.5) / 4])


# Laws of equilibria of DAEs: fits with a proved bound, large linear blocks, sizes, units.


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
    k = Parameter("k", 0.5, percent=20)
    law = "der(h) = q - k*sqrt(h)"
    outflow = dae_of("outflow", "h=4", law, inputs="q=1", outputs="h", parameters=[k])
    model = linearize_dae(outflow, fit=1e-8)
    assert 0.0 < model.certificate.fit_error_bound <= 1e-8
    k_values = np.linspace(0.4, 0.6, 7)
    A = mbdlft.matrices_at(model, {"k": k_values}).A[:, 0, 0]
    target(A, -(k_values**2) / 2, 1e-8)
    target(np.ravel(mbdlft.trim_at(model, {"k": k_values})[..., 0]), k_values**-2.0, CLOSED_FORM)


def test_what_is_exact_stays_exact_with_a_tolerance() -> None:
    p = Parameter("p", 2.0, percent=20)
    exact = dae_of("exact", "x", "der(x) = u - p*x", inputs="u=1", outputs="x", parameters=[p])
    model = linearize_dae(exact, fit=1e-6)
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
    parameters = [Parameter(n, 3e6, percent=1e-9) for n in "ab"]
    laws = ("der(x) = a - b - x", "der(y) = -y + x/1000")
    s = reduce_index(dae_of("balanced", "x y", *laws, outputs="x", parameters=parameters))
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
    parameters = [Parameter(n, 2.0, percent=10, unit="1/m") for n in "pq"]
    laws = ("der(x) = -(x**2*p + y**2*q)**2*number(3)", "der(y) = -y*number(2)")
    dae = dae_of("nested", "x[m] y[m]", *laws, outputs="x", parameters=parameters)
    nested = delta_theta(dae, search=0.0, prove=0.0)
    assert [f.unit for f in nested.functions] == ["m^2"] * 3
    assert "m" in {s.unit for s in nested.linear.outputs if s.name.startswith("omega")}
    laws = ("der(x) = v", "der(v) = -number(1)*x - atan(number(0.1)*x)*v*number(-1)")
    other = dae_of("other", "x[mm] v[mm/s]", *laws, outputs="x")
    (f,) = delta_theta(other, search=0.0, prove=0.0).functions
    assert f.unit == "1"  # a number has any unit, and nothing is said of mm


_FAR, _ZERO = "(x - number(0.3))", "(number(0.3)*number(0.3) - number(0.09))"


@pytest.mark.parametrize(
    ("laws", "slope"),
    [
        ("2*w + fabs(w) = x*fabs(x)", 0.0),
        ("3*w + p*fabs(w - x) = 3*x", 1.0),  # both pieces say w = x
        ("w = z - fabs(x); z = fabs(x)", 0.0),  # each has two slopes, what is read has none
        ("2*w + fabs(w) + z = x*x; 3*z + fabs(z - w) = x*x", 0.0),
        (f"w = fabs(z); z + z**3 = fabs(2*{_FAR}) - 2*fabs({_FAR})", 0.0),
        (f"w = tanh(p*(x + {_ZERO}))/p", 1.0),
        # determinants of two signs, or of one that changes its sign with p
        ("w + 2*fabs(w) = x*x", None),
        ("w + p*fabs(w - x) = x", None),
        ("w = z; 2*z + fabs(z) = x", None),
        # rounding leaves w beside its kink: 0.08436 is 0.57 times 0.148
        ("2*w + fabs(w) = sin(x + number(0.08436)/number(0.148) - number(0.57))", None),
        ("2*w + fabs(w) - z = sin(x + number(0.08436)/number(0.148) - number(0.57)); 3*z + w = 0", None),
        ("w = fabs(log(x + number(0.08436)/number(0.148)/number(0.57)))", None),
    ],
)
def test_kinks_of_equations_may_give_one_model(laws: str, slope: float | None) -> None:
    """dw/dx at x = 0, by hand, where all sides of the kinks give the same; else an error."""
    variables = "x w z" if "z" in laws else "x w"
    rate, p = "der(x) = u - p*x - w", Parameter("p", 1.0, percent=20)
    dae = dae_of("it", variables, rate, *laws.split("; "), inputs="u", outputs="x", parameters=(p,))
    at = trim(reduce_index(dae), {"x": 0.0}, free=["u"])
    if slope is None:
        with pytest.raises(TrimError, match="two slopes"):
            linearize_dae(at)
        return
    for value in (0.8, 1.1):
        found = mbdlft.matrices_at(linearize_dae(at, search=0.0), {"p": value}).A
        target(found, np.array([[-value - slope]]), CLOSED_FORM)


@pytest.mark.parametrize("x", [0.02072, np.nextafter(0.02072, 1.0), np.nextafter(0.02072, 0.0)])
def test_a_state_one_rounding_off_a_kink_is_on_its_side(x: float) -> None:
    """Doubles do not tell 0.020720000000000002/0.148 from 0.14: "a bug" was told."""
    p = Parameter("p", 1.0, percent=20)
    rate = "der(x) = u - p*fabs(x/number(0.148) - number(0.14))"
    dae = dae_of("it", "x", rate, inputs="u", outputs="x", parameters=(p,))
    at = trim(reduce_index(dae), {"x": float(x)}, free=["u"])
    if x == 0.02072:
        with pytest.raises(TrimError, match="two slopes by 'x', -6"):
            linearize_dae(at)
        return
    found = mbdlft.matrices_at(linearize_dae(at, search=0.0), {"p": 1.1}).A
    target(found, np.array([[-1.1 / 0.148 * np.sign(x - 0.02072)]]), CLOSED_FORM)
