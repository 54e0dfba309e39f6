"""Laws of realize beside those of tests/reference/test_orders.py."""

import itertools
import random
import re
import time
from collections.abc import Callable
from fractions import Fraction

import casadi as ca
import flint
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from mbdlft import Angle, Constant, MatrixProblem, Parameter, realize
from mbdlft.exact.interval import FUNCTIONS, Interval
from mbdlft.exact.numbers import BITS
from mbdlft.exact.rounding import channel_scales
from mbdlft.matrix import expressions
from mbdlft.matrix.relations import problem_of_matrix
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.order.reduction import ExactLFT, reduce_exactly
from mbdlft.pipeline import forms, stages
from tests.close import CLOSED_FORM, exact, roundoff, target
from tests.laws.loewner import degrees
from tests.laws.test_bound import entries
from tests.seeds import some

A, B = Parameter("a", 0.5, 0.3, 0.8), Parameter("b", 1.5, 1.0, 2.0)
SAMPLES = mbdlft.random([A, B], 50, seed=4)


def value(model: mbdlft.LFTModel, values: dict[str, np.ndarray]) -> np.ndarray:
    m = mbdlft.matrices_at(model, values)
    return np.block([[m.A, m.B], [m.C, m.D]])


def python_value(rows: list[list[str]], values: dict[str, np.ndarray]) -> np.ndarray:
    count = len(next(iter(values.values())))
    known = {**values, "sin": np.sin, "cos": np.cos}
    found = [[np.broadcast_to(eval(t.replace("^", "**"), known), count) for t in r] for r in rows]
    return np.moveaxis(np.array(found, dtype=float), 2, 0)


@pytest.mark.long
@given(st.lists(st.lists(entries, min_size=2, max_size=2), min_size=1, max_size=3))
def test_all_ways_of_giving_a_matrix_agree(rows: list[list[str]]) -> None:
    expected = python_value(rows, SAMPLES)
    problem = MatrixProblem(name="m", matrix=rows, parameters=(A, B))
    symbols = {name: ca.SX.sym(name) for name in "ab"}
    # other names of symbols than those of the parameters
    swapped = {"a": ca.SX.sym("x"), "b": ca.SX.sym("y")}
    models = [realize(rows, [B, A], search=0.0), realize(problem, search=0.0)]
    models.append(realize(mbdlft.matrix_from_toml(mbdlft.matrix_to_toml(problem)), search=0.0))
    for table in (symbols, swapped):
        # CasADi's own arithmetic on the entries
        symbolic = ca.vertcat(*(ca.horzcat(*(ca.SX(eval(t, dict(table))) for t in row)) for row in rows))
        models.append(realize(symbolic, [A, B], symbols=None if table is symbols else table, search=0.0))
    for model in models:
        roundoff(value(model, SAMPLES), expected, 1e2)
        assert model.certificate.max_relative_error <= CLOSED_FORM


def test_a_rotation_more_costs_a_few_channels() -> None:
    """The signals that a rotation turns are shared by the next one: they do not double each time."""
    th = Angle("th", 10, -60, 60)
    models = [realize([[f"sin({count}*th)"]], [th], search=0.0) for count in (5, 15, 16)]
    assert [model.certificate.raw_order for model in models] == [(18,), (58,), (62,)]


def test_a_pole_that_intervals_miss_is_found_at_points(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(expressions, "find_zero", lambda function, bounds: None)
    with pytest.raises(mbdlft.WellPosednessError, match="the model is singular at"):
        realize([["1/(a - 0.6)"]], [A], search=0.0)
    with pytest.raises(mbdlft.WellPosednessError, match=r"is not finite at a = 0\.5"):
        realize([["1/(a - 0.5)"]], [A], search=0.0)


def law_interval(cosine: Callable[[Interval], Interval], low: float, width: float) -> None:
    """All cosines lie inside, and the ends are reached."""
    found = cosine(Interval(low, low + width))
    turns = np.pi * np.arange(-10, 11)
    inside = turns[(turns >= low) & (turns <= low + width)]
    samples = np.cos(np.concatenate([np.linspace(low, low + width, 101), inside]))
    roundoff([found.low, found.high], [samples.min(), samples.max()], scale=1.0)


@given(st.floats(-10, 10), st.floats(0, 8))
def test_intervals_of_cosines(low: float, width: float) -> None:
    law_interval(FUNCTIONS["cos"], low, width)


def test_large_symbolic_matrix_has_short_texts() -> None:
    """What is shared gets a name: the text grows with the instructions, not with the tree."""
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    x = a
    for _ in range(30):
        x = (x * b + a) / (1 + x * x)
    problem = mbdlft.matrix_problem(x, [A, B])
    assert sum(len(str(text)) for text in problem.expressions.values()) < 5000
    long = sum((0.1 * k * a * b + b for k in range(200)), a)
    model = realize(long, [A, B], search=0.0)
    expected = SAMPLES["a"] + sum(
        0.1 * k * SAMPLES["a"] * SAMPLES["b"] + SAMPLES["b"] for k in range(200)
    )
    target(value(model, SAMPLES)[:, 0, 0], expected, CLOSED_FORM)
    powers = realize(a**5 + (a * b) ** -3, [A, B], search=0.0)
    expected = SAMPLES["a"] ** 5 + (SAMPLES["a"] * SAMPLES["b"]) ** -3.0
    target(value(powers, SAMPLES)[:, 0, 0], expected, CLOSED_FORM)


def test_states_divide_the_matrix() -> None:
    rows = [["-a", "1", "b"], ["0", "-b", "1"], ["1", "a*b", "0"]]
    model = realize(rows, [A, B], states=2, name="plant", inputs=["force"], search=0.0)
    assert [s.name for s in model.states] == ["x0", "x1"]
    assert [s.name for s in (*model.inputs, *model.outputs)] == ["force", "y0"]
    plant = model.at(a=0.4, b=1.2)
    target(plant.A, [[-0.4, 1], [0, -1.2]], CLOSED_FORM)
    target(plant.C, [[1, 0.48]], CLOSED_FORM)
    response = mbdlft.frequency_response(model, {"a": 0.4, "b": 1.2}, [2.0])
    s = 2.0j
    state = np.linalg.solve(s * np.eye(2) - plant.A, plant.B)
    target(np.squeeze(response), np.squeeze(plant.C @ state + plant.D), CLOSED_FORM)


def test_without_states_the_model_is_static() -> None:
    model = realize([["a", "b", "1"], ["0", "a*b", "2"]], [A, B], search=0.0)
    assert [s.name for s in (*model.inputs, *model.outputs)] == ["u0", "u1", "u2", "y0", "y1"]
    assert model.states == ()
    assert model.trim.signals == ()
    target(model.at(a=0.4).D, [[0.4, 1.5, 1], [0, 0.6, 2]], CLOSED_FORM)
    response = mbdlft.frequency_response(model, {"a": 0.4}, [1.0, 10.0])
    target(np.squeeze(response)[1].real, [[0.4, 1.5, 1], [0, 0.6, 2]], CLOSED_FORM)
    assert model.certificate.minimal


def test_nothing_is_converted() -> None:
    mm = Parameter("length", 20.0, 10.0, 40.0, unit="mm")
    model = realize(
        [["length + gap"]], [mm], constants={"gap": Constant(value=3.0, unit="mm")}, search=0.0
    )
    target(model.at(length=30.0).D, [[33.0]], CLOSED_FORM)


def test_unused_parameters_and_numbers() -> None:
    model = realize([["a", 2], [0.5, "a - a"]], [B, A], search=0.0)
    assert dict(model.lft.blocks) == {"a": 1, "b": 0}
    assert model.certificate.raw_order == (1, 0)
    constant = realize(np.eye(2), search=0.0)
    assert constant.order == 0
    exact(constant.at().D, np.eye(2))


def test_what_cancels_is_compared_with_its_terms() -> None:
    model = realize([["1e8*(a + b)^2 - 1e8*a^2 - 2e8*a*b - 1e8*b^2 + 0*a"]], [A, B], search=0.0)
    assert model.certificate.max_relative_error <= CLOSED_FORM


ROTATIONS = [["cos(th + 2*ph)", "-sin(th - ph)"], ["sin(0.3 + th)*a", "1/(2 + cos(th)*sin(ph))"]]


@pytest.mark.parametrize("unit", ["deg", "rad"])
@pytest.mark.parametrize("substitution", ["half-angle", "quarter-angle"])
def test_angles_are_angles(unit: str, substitution: str) -> None:
    factor = np.pi / 180 if unit == "deg" else 1.0
    angles = [
        Angle("th", 0.5 / factor, -0.2 / factor, 1.5 / factor, unit=unit, substitution=substitution),
        Angle("ph", -0.1 / factor, -1.0 / factor, 1.0 / factor, unit=unit, substitution=substitution),
    ]
    model = realize(ROTATIONS, [A, *angles], search=0.0)
    samples = mbdlft.random([A, *angles], 50, seed=6)
    in_rad = {name: column * (1.0 if name == "a" else factor) for name, column in samples.items()}
    expected = python_value(ROTATIONS, in_rad)
    target(value(model, samples), expected, CLOSED_FORM)
    th, ph, a = (ca.SX.sym(name) for name in ("th", "ph", "a"))
    known = {"th": th, "ph": ph, "a": a, "sin": ca.sin, "cos": ca.cos}
    symbolic = ca.vertcat(*(ca.horzcat(*(eval(t, dict(known)) for t in row)) for row in ROTATIONS))
    target(value(realize(symbolic, [A, *angles], search=0.0), samples), expected, CLOSED_FORM)


def test_long_sums_and_deep_texts() -> None:
    """Thousands of terms need no recursion."""
    text = " + ".join(f"{k % 7}*a*b" for k in range(1, 1501))
    model = realize([[text]], [A, B], search=0.0)
    total = sum(k % 7 for k in range(1, 1501))
    target(value(model, SAMPLES)[:, 0, 0], total * SAMPLES["a"] * SAMPLES["b"], CLOSED_FORM)


def test_a_way_to_write_a_matrix_that_is_singular_at_nominal_is_left_out() -> None:
    """Relations of low degree can have a factor d, which is zero there; the matrix is regular."""
    parameters = [
        Parameter("a", 0.5, percent=20),
        Parameter("b", 0.75, percent=20),
        Parameter("c", 0.15, percent=20),
        Parameter("d", 0.0, low=-1.0, high=1.0),
    ]
    first, second, third = "(1 - 0.25*b)", "(1 + d/8 - c*d/8)", "(1 - d/16 - b^2/8)"
    entries = [
        f"c*d/{first} - 1/{second} - 5/{third}",
        f"-6*a*b/{second} + 84/{third} + 1/{first}",
        f"-d*c/{second} - 1/{third}",
        f"1/{third}",
    ]
    model = realize([entries], parameters, search=0.0)
    a, b, c, d = 0.5, 0.8, 0.16, -0.5
    under = [1 - 0.25 * b, 1 + d / 8 - c * d / 8, 1 - d / 16 - b**2 / 8]
    expected = [
        c * d / under[0] - 1 / under[1] - 5 / under[2],
        -6 * a * b / under[1] + 84 / under[2] + 1 / under[0],
        -d * c / under[1] - 1 / under[2],
        1 / under[2],
    ]
    target(model.at(a=a, b=b, c=c, d=d).D[0], expected, CLOSED_FORM)


def test_entries_that_share_no_denominator_do_not_take_minutes() -> None:
    """Twelve nested fractions over one denominator have millions of coefficients."""
    names = "abcde"
    parameters = [Parameter(name, 0.1 * (k + 1), percent=20) for k, name in enumerate(names)]
    of = [[(names[(i + j) % 5], names[(i + 2 * j) % 5], names[(2 * i + j + 1) % 5]) for j in range(4)]
          for i in range(3)]  # fmt: skip
    rows = [[f"{x}/(3 + {y}/(2 + {z}/3))" for x, y, z in row] for row in of]
    start = time.process_time()
    model = realize(rows, parameters, search=0.0)
    assert time.process_time() - start < 20.0  # 0.3 s; all of them took minutes and gigabytes
    nominal = {p.name: p.nominal for p in parameters}
    expected = [[nominal[x] / (3 + nominal[y] / (2 + nominal[z] / 3)) for x, y, z in row] for row in of]
    target(model.at().D, expected, CLOSED_FORM)


# Laws of realize for matrices in any units, with common factors left in, and with digits that cancel.
# Values are those of `fractions`.

IN_A, IN_B = Parameter("a", 0.2, -0.5, 0.6), Parameter("b", 0.15, -0.4, 0.5)
Rows = list[list[str]]
MATRICES: list[Rows] = [
    [["a", "a^2", "a^3"]],
    [["b", "b"]],
    [["1 - 4*b - 8*b^2"]],
    [["a^2", "b^2", "a*b"], ["1", "0", "b"]],
    [["1 + a", "2*a", "a^2"], ["a", "3*a + 1", "a"]],
    [["a*b", "1", "a*b"], ["b", "b", "b"]],
    [["1/(1 + a)", "a/(1 + a)", "b"]],
    [["a/(4 + a*b)", "b/(4 + a*b)"], ["(a + b)/(4 + a*b)", "1/(4 + a*b)"]],
    [["(1 + a)/(3 - b - a*b)"], ["a^2/(3 - b - a*b)"], ["a*b^2 + a"]],
]
# numerators and denominators that have a factor in common, and terms that cancel in sums
Unreduced = tuple[Rows, list[Parameter]]
UNREDUCED: list[Unreduced] = [
    (
        [
            ["0", "0", "0", "(-2-2*b)/(b+1)"],
            [
                "(2*b^2*a+4*b^2-2-2*b)/(b+1)",
                "(-4*b^3-b-1)/(1+b)",
                "(2*a^2*b^3+2*b^3)/(a^2+1+b*a^2+b)",
                "0",
            ],
        ],
        [Parameter("a", 0.05, -0.2, 0.3), Parameter("b", 0.06, -0.2, 0.3)],
    ),
    (
        [
            ["(6*b+2*b^2)/(1-b^2)", "(2*b+7*b^2-1)/(-b^2+1)", "-(-1)", "(-2*b)/(1-b)"],
            [
                "(7*b*a-2*b-5*a)/(-1+a-a*b+b)",
                "(-4*a+6*b*a-3*b+1)/(b-a*b+a-1)",
                "0",
                "(-b+2-b*a)/(b-b*a-1+a)",
            ],
            [
                "(2*b^2+6*b)/(1-b^2)",
                "(2*a*b-2*b-4*b^2-2-2*a+8*b^2*a)/(-1+a+b^2-a*b^2)",
                "(6*a-1)/(-a+1)",
                "(4*b-2-2*a)/(-1+a-b*a+b)",
            ],
            ["(a+2*b*a-b)/(-b*a+1-a+b)", "(2*a+1+b*a+2*b)/(-a*b+b+1-a)", "(3*a)/(-a+1)", "(2*a)/(-a+1)"],
        ],
        [
            Parameter("a", 0.006969365683367192, 0.006969365013673535, 0.006969366213673535),
            Parameter("b", 0.009354908821728103, 0.009354902728179014, 0.009354914728179014),
        ],
    ),
]
TANGENT: Unreduced = ([["(1 - cos(th))/sin(th)"]], [Angle("th", 1e-4, 1e-5, 1e-3, unit="rad")])
# numbers of which only rounding is left in double precision, and nothing as decimals
CANCELED: list[tuple[Rows, Rows]] = [  # and what is left of them
    ([["(0.7*a+0.1*b-0.3*a-0.4*a)/(1+b)"]], [["0.1*b/(1+b)"]]),
    ([["1e-3*(0.7*a+1e-4*b-0.3*a-0.4*a)/(1+b)"]], [["1e-7*b/(1+b)"]]),
    ([["(0.87*b+0.93*b-1.8*b)/(1+a)", "1/(1+b)"]], [["0", "1/(1+b)"]]),
    ([["a/(1+b)", "(1.1*a+2.2*a-3.3*a)/(1+a)"]], [["a/(1+b)", "0"]]),
    ([["(0.1*a+0.2*a-0.3*a)*1e17/(1+b)"]], [["0"]]),
    ([["a + 1e13*b - 1e13*b"]], [["a"]]),
    ([["a + 1e130*b - 1e130*b"]], [["a"]]),
    ([["a + 0.123456789012345678*b - 0.123456789012345677*b - 1e-18*b"]], [["a"]]),
    ([["a + sqrt(2)*sqrt(3)*b - sqrt(6)*b"]], [["a"]]),
    ([["a + (cos(36*deg) - cos(72*deg) - 0.5)*b"]], [["a"]]),
    ([["a + (sin(0.3)^2 + cos(0.3)^2 - 1)*b"]], [["a"]]),
    ([["1e15*(cos(36*deg)-cos(72*deg)-0.5)*a/(2+b)", "b"]], [["0", "b"]]),
    ([["a + 1e130*b^2 - 1e130*b*b"]], [["a"]]),
    ([["1e130*b^2 - 1e130*b*b + 1e100*b^3 - 1e100*b^2*b", "b"]], [["0", "b"]]),
]
THOUSAND = Parameter("a", 1000.3, 999.3, 1001.3)
FAR = [
    ([["1+(a-1000)^5"]], [THOUSAND]),
    ([["1/(2+(a-1000)^3*(b-1000)^3)"]], [THOUSAND, Parameter("b", 1000.2, 999.3, 1001.1)]),
    ([["1/(a*b+1)"]], [Parameter("a", 1e9 + 0.5, 1e9, 1e9 + 1), Parameter("b", 0.2, 0.1, 0.5)]),
]
# the second row is in much larger units
NEARLY_SINGULAR = [["1/(a-0.4999999999)"], ["1e30*a"]], [Parameter("a", 1.0, 0.5, 2.0)]


def values_of(rows: Rows, points: dict[str, np.ndarray]) -> np.ndarray:
    """Values (N, ., .) at the doubles of the points, rounded once."""
    found = []
    for point in zip(*points.values(), strict=True):
        known = dict(zip(points, map(Fraction, point), strict=True))
        found.append([[float(eval(_python(text), {"F": Fraction}, known)) for text in r] for r in rows])
    return np.array(found)


def _python(text: str) -> str:
    return re.sub(r"(?<![\w.])(\d[\d.]*(?:e[-+]?\d+)?)", r"F('\1')", text.replace("^", "**"))


def law_values(rows: Rows, parameters: list[Parameter], bound: float = CLOSED_FORM) -> mbdlft.LFTModel:
    """Every entry has its digits, relative to its own size, and the certificate says so."""
    model = realize(rows, parameters, search=0.0)
    corners = np.array(list(itertools.product(*([p.low, p.high] for p in model.parameters))))
    points = mbdlft.random(model.parameters, 20, seed=3)
    points = {p.name: np.append(points[p.name], corners[:, k]) for k, p in enumerate(model.parameters)}
    expected = values_of(rows, points)
    error = np.abs(mbdlft.matrices_at(model, points).D - expected)
    size = np.max(np.abs(expected), axis=0)
    assert np.all(error <= bound * size), f"relative error {np.max(error / size):.1e}"
    assert model.certificate.max_relative_error <= bound
    return model


def scaled(rows: Rows, seed: int) -> tuple[Rows, list[Parameter]]:
    """Rows and columns in other units, and parameters in others."""
    draw = random.Random(seed)
    units = {name: 10.0 ** draw.randint(-12, 12) for name in "ab"}
    across = [10.0 ** draw.randint(-9, 9) for _ in rows[0]]
    found = []
    for row in rows:
        own = 10.0 ** draw.randint(-9, 9)
        texts = [re.sub("[ab]", lambda m: f"({units[m[0]]!r}*{m[0]})", text) for text in row]
        found.append([f"{own!r}*({text})*{c!r}" for text, c in zip(texts, across, strict=True)])
    parameters = [
        Parameter(p.name, p.nominal / u, p.low / u, p.high / u)
        for p, u in zip((IN_A, IN_B), units.values(), strict=True)
    ]
    return found, parameters


@pytest.mark.parametrize("seed", some(range(1), range(6)))
@pytest.mark.parametrize("rows", MATRICES, ids=str)
def test_units_change_nothing(rows: Rows, seed: int) -> None:
    plain = realize(rows, [IN_A, IN_B], search=0.0)
    model = law_values(*scaled(rows, seed))
    assert model.certificate.order == plain.certificate.order
    assert model.certificate.lower_bound == plain.certificate.lower_bound


def test_small_entries_are_compared() -> None:
    """A thousandth of an entry is an error whatever the unit of the entry is."""
    problem = problem_of_matrix(mbdlft.matrix_problem([["1e-20*a", "1e20*b"]], [IN_A, IN_B]))
    a = realize([["1e-20*a", "1e20*b"]], [IN_A, IN_B], search=0.0).lft
    wrong = np.array([1.001, 1.0])
    with pytest.raises(mbdlft.AnalysisError, match=r"entry \(1, 1\) .* differs from the matrix"):
        stages._Check(problem).model(
            mbdlft.LFT(a.M11, a.M12 * wrong, a.M21, a.M22 * wrong, a.blocks), None
        )


@pytest.mark.parametrize("case", [*UNREDUCED, TANGENT], ids=["2 x 4", "5 x 4", "tangent"])
def test_what_cancels_proves_nothing(case: Unreduced) -> None:
    """What is proved are the degrees."""
    rows, parameters = case
    proved = realize(*case, search=0.0).certificate.lower_bound
    assert proved == tuple(degrees(rows, sorted(p.name for p in parameters)).values())


@pytest.mark.parametrize(("rows", "left"), CANCELED, ids=str)
def test_numbers_that_cancel_are_nothing(rows: Rows, left: Rows) -> None:
    """0.1 + 0.2 - 0.3 is zero, as a coefficient and as an entry, whatever stands beside it."""
    plain, model = (realize(text, [IN_A, IN_B], search=0.0) for text in (left, rows))
    assert model.certificate.order == plain.certificate.order
    assert model.certificate.lower_bound == plain.certificate.lower_bound
    assert model.certificate.minimal
    points = mbdlft.random(model.parameters, 20, seed=3)
    found, expected = (mbdlft.matrices_at(each, points).D for each in (model, plain))
    target(found, expected, CLOSED_FORM)
    # what models are compared with: to all digits, and zeros to their row and column
    found, expected = (
        problem_of_matrix(mbdlft.matrix_problem(text, [IN_A, IN_B])).reference() for text in (rows, left)
    )
    target(found.values, expected.values, CLOSED_FORM)
    target(found.scale, expected.scale, CLOSED_FORM)


@pytest.mark.parametrize("size", [1e-7, 1e-4, 1e7, 1e14])
@pytest.mark.parametrize("rows", [[["1/x", "x"]], [["1/x^2"], ["x^2"]], [["1/x^3", "x"]]], ids=str)
def test_powers_in_any_unit(rows: Rows, size: float) -> None:
    model = law_values(rows, [Parameter("x", size, 0.5 * size, 2.0 * size)])
    assert model.certificate.minimal


def test_the_smallest_form_comes_first() -> None:
    """The forms of these have different orders."""
    for rows in ([["a^2*b + a*b*a", "b*a"]], [["a*b + b*a"], ["a^2 + a*(1 + b)*a"]]):
        problem = problem_of_matrix(mbdlft.matrix_problem(rows, [IN_A, IN_B]))
        orders = [found.lft.order for found in forms.candidates(problem, problem.forms)]
        assert orders == sorted(orders)
        assert orders[0] < orders[-1]


def test_many_channels_begin_with_twice_the_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """The model is the same, and nothing is reduced with few bits first."""
    problem = problem_of_scene(mbdlft.load_scene("scenarios/crane.toml"))
    (expected, *_), bits = forms.candidates(problem, problem.forms), list[int]()

    def counted(a: ExactLFT) -> ExactLFT:
        bits.append(flint.ctx.prec)
        return reduce_exactly(a)

    monkeypatch.setattr(forms, "reduce_exactly", counted)
    for most, used in ((expected.lft.order - 1, 2 * BITS), (1000, BITS)):
        monkeypatch.setattr(forms, "_MANY", most)
        found = forms.candidates(problem, problem.forms)[0]
        exact(found.lft.M22, expected.lft.M22)
        assert set(bits) == {used}
        bits.clear()


@pytest.mark.parametrize("size", [1e-7, 1.0, 1e7])
def test_channels_have_one_size(size: float) -> None:
    """What enters and what leaves a channel has one size."""
    x = Parameter("x", size, 0.5 * size, 2.0 * size)
    problem = problem_of_matrix(mbdlft.matrix_problem([["1/x^2"], ["x^2"]], [x]))
    for found in forms.candidates(problem, problem.forms):
        a = found.lft
        exact(channel_scales(a.M11, a.M12, a.M21), np.ones(a.order))


@pytest.mark.parametrize(("rows", "parameters"), FAR)
def test_differences_have_their_digits(rows: Rows, parameters: list[Parameter]) -> None:
    law_values(rows, parameters)


def law_error(rows: Rows, parameters: list[Parameter]) -> float:
    """The certificate states at least the error that the model has at the corners; its condition."""
    model = realize(rows, parameters, search=0.0)
    ends = {p.name: np.array([p.low, p.high]) for p in parameters}
    expected = values_of(rows, ends)
    error = np.abs(mbdlft.matrices_at(model, ends).D - expected) / np.max(np.abs(expected), axis=0)
    assert np.max(error) <= 2.0 * model.certificate.max_relative_error
    return model.certificate.condition


def test_certificate_states_what_is_lost() -> None:
    assert law_error(*NEARLY_SINGULAR) > 1e9
