"""Laws of realize for matrices in any units, with common factors left in, and with digits that cancel.

1. rows, columns and parameters scaled by any powers of ten: order, bounds and relative errors stay
2. bounds are the degrees where common factors are left in, or ranges are small, as ranks modulo a prime
3. numbers that cancel as decimals leave nothing
4. parameters far from zero: models have the digits that differences of them have
5. the error in the certificate is not below that of the model, and its condition says why it is large

Values are those of `fractions`.
"""

import itertools
import random
import re
from fractions import Fraction

import flint
import numpy as np
import pytest

import mbdlft
from mbdlft import Angle, Parameter, realize
from mbdlft.exact.numbers import BITS
from mbdlft.exact.rounding import channel_scales
from mbdlft.matrix.relations import problem_of_matrix
from mbdlft.multibody.to_problem import problem_of_scene
from mbdlft.order.reduction import ExactLFT, reduce_exactly
from mbdlft.pipeline import forms, stages
from tests.close import CLOSED_FORM, exact, target
from tests.laws.loewner import degrees
from tests.seeds import some

A, B = Parameter("a", 0.2, -0.5, 0.6), Parameter("b", 0.15, -0.4, 0.5)
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
        for p, u in zip((A, B), units.values(), strict=True)
    ]
    return found, parameters


@pytest.mark.parametrize("seed", some(range(2), range(6)))
@pytest.mark.parametrize("rows", MATRICES, ids=str)
def test_units_change_nothing(rows: Rows, seed: int) -> None:
    plain = realize(rows, [A, B], search=0.0)
    model = law_values(*scaled(rows, seed))
    assert model.certificate.order == plain.certificate.order
    assert model.certificate.lower_bound == plain.certificate.lower_bound


def test_small_entries_are_compared() -> None:
    """A thousandth of an entry is an error whatever the unit of the entry is."""
    problem = problem_of_matrix(mbdlft.matrix_problem([["1e-20*a", "1e20*b"]], [A, B]))
    a = realize([["1e-20*a", "1e20*b"]], [A, B], search=0.0).lft
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
    plain, model = (realize(text, [A, B], search=0.0) for text in (left, rows))
    assert model.certificate.order == plain.certificate.order
    assert model.certificate.lower_bound == plain.certificate.lower_bound
    assert model.certificate.minimal
    points = mbdlft.random(model.parameters, 20, seed=3)
    found, expected = (mbdlft.matrices_at(each, points).D for each in (model, plain))
    target(found, expected, CLOSED_FORM)
    # what models are compared with: to all digits, and zeros to their row and column
    found, expected = (
        problem_of_matrix(mbdlft.matrix_problem(text, [A, B])).reference() for text in (rows, left)
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
        problem = problem_of_matrix(mbdlft.matrix_problem(rows, [A, B]))
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
        for a in (found.lft, found.closed, found.relations):
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
