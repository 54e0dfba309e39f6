"""Laws of bounds in exact arithmetic.

1. a polynomial in one parameter needs its degree, a product of coprime fractions the sum of theirs
2. what is equal as a rational function has one bound, however it is written
3. the bound in double precision never exceeds it, and no reduced model is smaller
4. residues are a field: they agree with fractions
"""

import builtins
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbdlft
from mbdlft import Angle, MatrixProblem, Parameter, exact_lower_bound
from mbdlft.lft.lft import LFT
from mbdlft.matrix import exact_bound as exact
from mbdlft.number.residue import PRIME, Residue

A, B = Parameter("a", 0.5, 0.3, 0.8), Parameter("b", 1.5, 1.0, 2.0)


def bound(*rows: list[str], parameters: tuple[Parameter, ...] = (A, B)) -> dict[str, int]:
    return exact_lower_bound(MatrixProblem(matrix=rows, parameters=parameters))


CLOSED = [
    ([["3"]], (0, 0)),
    ([["a - a"]], (0, 0)),
    ([["a^7 + 2*a - 1"]], (7, 0)),
    ([["a*b + a*b^2"]], (1, 2)),
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


@given(st.lists(st.lists(entries, min_size=2, max_size=2), min_size=2, max_size=2))
def test_no_model_is_smaller_and_double_precision_is_not_above(matrix: list[list[str]]) -> None:
    proved = bound(*matrix)
    problem = MatrixProblem(matrix=matrix, parameters=(A, B))
    model = mbdlft.realize(problem, search=0.0)
    for name, order, numerical in zip(
        "ab", model.certificate.order, model.certificate.lower_bound, strict=True
    ):
        assert numerical <= proved[name] <= order
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


rationals = st.fractions(min_value=-100, max_value=100, max_denominator=99)


@given(rationals, rationals, rationals)
def test_residues_are_a_field(x: Fraction, y: Fraction, z: Fraction) -> None:
    def image(value: Fraction) -> int:
        return value.numerator * pow(value.denominator, -1, PRIME) % PRIME

    a, b, c = (Residue(image(value)) for value in (x, y, z))
    assert (a * b + c - 2.5).value == image(x * y + z - Fraction(5, 2))
    assert (-(3.0 - a * 0.1)).value == image(x / 10 - 3)
    if y:
        assert (a / b).value == image(x / y)
        assert (1.0 / b).value == image(1 / y)


def test_a_float_is_the_decimal_it_prints_as() -> None:
    assert Residue.of(0.1).value * 10 % PRIME == 1
    assert Residue.of(1e-3).value * 1000 % PRIME == 1


@pytest.mark.parametrize("text", ["sqrt(2)*a", "pi*a", "a*sin(0.3)", "sin(th + 0.1)", "a + 30*deg"])
def test_numbers_that_are_not_rational_are_refused(text: str) -> None:
    with pytest.raises(mbdlft.NotRationalError, match=r"entry \(0, 0\).*is not a rational number"):
        bound([text], parameters=(A, Angle("th", 0, -20, 20)))


def test_denominator_that_is_zero_everywhere_is_refused() -> None:
    with pytest.raises(mbdlft.WellPosednessError, match="zero whatever the values"):
        bound(["1/(a*b - b*a)"])


def test_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    original = builtins.__import__

    def without(name: str, *arguments: Any, **named: Any) -> Any:
        if name == "flint":
            raise ImportError(name)
        return original(name, *arguments, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(mbdlft.AnalysisError, match=r"pip install 'mbdlft\[exact\]'"):
        bound(["a"])


def test_planted_bugs_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values taken for differences count too much; one sample on each side counts too little."""
    right = exact._loewner

    def values_only(flint: Any, left: Any, above: Any) -> Any:
        zero = [(m, [[0] * len(row) for row in rows]) for m, rows in above]
        return right(flint, left, zero)

    monkeypatch.setattr(exact, "_loewner", values_only)
    with pytest.raises(AssertionError):
        law_closed_form([["1/(1 + a)^3"]], (3, 0))
    monkeypatch.setattr(
        exact, "_loewner", lambda flint, left, above: right(flint, left[:1], above[:1])
    )
    with pytest.raises(AssertionError):
        law_closed_form([["a^7 + 2*a - 1"]], (7, 0))


def test_a_model_below_the_proved_bound_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Terms that differ by rounding only are merged in double precision; the numbers differ."""
    from mbdlft.pipeline import realization

    def merged(lft: LFT) -> LFT:
        return mbdlft.LFT(lft.M11[:0, :0], lft.M12[:0], lft.M21[:, :0], lft.M22)

    problem = MatrixProblem(matrix=[["a"]], parameters=(A,))
    monkeypatch.setattr(
        realization,
        "reduce_order",
        lambda lft: realization.with_blocks(merged(lft), ["a"]),
    )
    with pytest.raises(
        mbdlft.AnalysisError, match="need 1 repetitions of a, and reduction in double"
    ):
        mbdlft.realize(problem, exact=True, search=0.0)
