"""Laws of bounds in exact arithmetic.

1. a polynomial in one parameter needs its degree, a product of coprime fractions the sum of theirs
2. what is equal as a rational function has one bound, however it is written
3. it is the rank of a Loewner matrix modulo another prime, and no reduced model is smaller
4. constants that are not rational have their relations
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from mbdlft import Angle, MatrixProblem, Parameter, exact_lower_bound
from mbdlft.lft.lft import constant, delta, inverse
from mbdlft.order import lower_bound as exact
from tests.extracted import exactly
from tests.laws.lfts import lfts
from tests.laws.loewner import degrees as degrees_by_ranks
from tests.strategies import fewer

A, B = Parameter("a", 0.5, 0.3, 0.8), Parameter("b", 1.5, 1.0, 2.0)


def bound(*rows: list[str], parameters: tuple[Parameter, ...] = (A, B)) -> dict[str, int]:
    return exact_lower_bound(MatrixProblem(matrix=rows, parameters=parameters))


CLOSED = [
    ([["3"]], (0, 0)),
    ([["a - a"]], (0, 0)),
    ([["a^7 + 2*a - 1"]], (7, 0)),
    ([["a*b + a*b^2"]], (1, 2)),
    ([["(a - 0.5)*(b - 1.5)"]], (1, 1)),
    ([["1/(1 + a)^3"]], (3, 0)),
    ([["a^2/((1 + a)*(2 + a))"]], (2, 0)),
    ([["(a^2 - 1)/(a + 1)"]], (1, 0)),
    ([["a", "0"], ["0", "a"]], (2, 0)),
    ([["a", "a*b"], ["a*b", "a*b^2"]], (1, 2)),
    ([["a", "2*a"], ["b", "a + b"]], (2, 1)),
    ([["0.1*a + 0.2*a - 0.3*a"]], (0, 0)),
]


def law_closed_form(matrix: list[list[str]], degrees: tuple[int, int]) -> None:
    assert bound(*matrix) == dict(zip("ab", degrees, strict=True))


@pytest.mark.parametrize(("matrix", "degrees"), CLOSED, ids=lambda item: str(item)[:30])
def test_degrees_known_in_closed_form(matrix: list[list[str]], degrees: tuple[int, int]) -> None:
    law_closed_form(matrix, degrees)


entries = st.recursive(
    st.sampled_from(["a", "b", "2", "0.7", "(1 + a)", "(3 + b)"]),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from("+-*"), inner).map(lambda t: f"({t[0]} {t[1]} {t[2]})"),
        inner.map(lambda text: f"({text}/(4 + a*b))"),
    ),
    max_leaves=6,
)


@fewer
@given(st.lists(st.lists(entries, min_size=2, max_size=2), min_size=2, max_size=2))
def test_no_model_is_smaller_and_another_prime_says_the_same(matrix: list[list[str]]) -> None:
    proved = bound(*matrix)
    problem = MatrixProblem(matrix=matrix, parameters=(A, B))
    model = mbdlft.realize(problem, search=0.0)
    assert proved == degrees_by_ranks(matrix, "ab")
    for name, order, claimed in zip(
        "ab", model.certificate.order, model.certificate.lower_bound, strict=True
    ):
        assert claimed == proved[name] <= order
    doubled = [[f"({text} + b*a - a*b)" for text in row] for row in matrix]
    assert bound(*doubled) == proved


@pytest.mark.parametrize(
    ("text", "degree"),
    [
        ("sin(th)", 2),
        ("sin(th)^2 + cos(th)^2", 0),
        ("sin(2*th)", 4),
        ("sin(2*th) - 2*sin(th)*cos(th)", 0),
        ("cos(th + 90*deg) + sin(th)", 0),
    ],
)
def test_angles(text: str, degree: int) -> None:
    for substitution in ("half-angle", "quarter-angle"):
        angle = Angle("th", 30, 10, 50, substitution=substitution)
        factor = 1 if substitution == "half-angle" else 2
        assert bound([text], parameters=(angle,)) == {"th": degree * factor}


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        ("sqrt(2)*a", (1, 0)),
        ("sqrt(2)*a*sqrt(3) - a*sqrt(6)", (0, 0)),
        ("pi*a - 180*deg*a", (0, 0)),
        ("a*sin(0.3)^2 + a*cos(0.3)^2 - a + b", (0, 1)),
        ("a + (cos(60*deg) - 0.5)*b", (1, 0)),
        ("a + (cos(60*deg) - 0.500000000001)*b", (1, 1)),
    ],
)
def test_constants_have_their_relations(text: str, degrees: tuple[int, int]) -> None:
    law_closed_form([[text]], degrees)


def test_denominator_that_is_zero_everywhere_is_refused() -> None:
    with pytest.raises(mbdlft.WellPosednessError, match="vanishes in the range"):
        bound(["1/(a*b - b*a)"])


@given(lfts(2, 2))
def test_degrees_are_not_above_the_order(a: mbdlft.LFT) -> None:
    found = exact.exact_degrees(exactly(a))
    assert all(degree <= dict(a.blocks)[name] for name, degree in found.items())


def test_degrees_of_an_lft_that_is_not_minimal() -> None:
    """(p q - q p) t is zero, though every channel is seen and reached."""
    p, q, t = (constant([[0.25]]) + delta(name) for name in "pqt")
    cases = [
        (t + (p @ q - q @ p) @ t, {"p": 0, "q": 0, "t": 1}),
        (p @ q @ p + t @ t, {"p": 2, "q": 1, "t": 2}),
        (inverse(1.0 + p @ q) @ t, {"p": 1, "q": 1, "t": 1}),
    ]
    for a, degrees in cases:
        assert exact.exact_degrees(exactly(a)) == degrees
