"""Laws of enclosures: intervals and Taylor models hold what they claim, rounding counted."""

import itertools
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import mbdlft
from mbdlft import Constant, Inertia, Parameter, Scene
from mbdlft.base import expression
from mbdlft.base.expression import Number, evaluate
from mbdlft.exact import interval, taylor
from mbdlft.exact.interval import FUNCTIONS, Interval
from mbdlft.exact.taylor import lowest, not_negative
from mbdlft.multibody.scene import checks
from mbdlft.multibody.scene.checks import check_positive
from tests import kit
from tests.close import EPS, roundoff
from tests.errors.table import refused

SIZES = [0.0, 5e-324, 2.5e-308, 1e-200, 1e-16, 0.1, 0.7, 1.0, 3.0, 22.0, 1e16, 1e200, 1.7e308]
ends = st.one_of(
    st.sampled_from([sign * size for sign in (1.0, -1.0) for size in SIZES]),
    st.floats(-10.0, 10.0),
    st.floats(allow_nan=False, allow_infinity=False),
)
boxes = st.fixed_dictionaries({name: st.tuples(ends, ends).map(sorted) for name in "xy"})
atoms = st.one_of(st.sampled_from("xy").map(expression.Name), st.floats(0.0, 1e3).map(expression.Number))
trees: st.SearchStrategy[expression.Expression] = st.recursive(
    atoms,
    lambda inner: st.one_of(
        st.builds(expression.Binary, st.sampled_from("+-*/"), inner, inner),
        st.builds(expression.Negative, inner),
        st.builds(expression.Power, inner, st.integers(-3, 4)),
        st.builds(expression.Call, st.sampled_from(["sqrt", "sin", "cos", "atan"]), inner),
    ),
    max_leaves=6,
)


def enclosure(tree: expression.Expression, box: dict[str, Any]) -> Interval:
    found = expression.evaluate(tree, box, Interval.of, FUNCTIONS)
    assert isinstance(found, Interval)
    return found


def real(value: Any) -> Any:
    """The number, if the function is defined there."""
    if not mpmath.isfinite(value) or mpmath.im(value):
        raise ValueError("not defined")
    return mpmath.re(value)


def digits(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *operands: real(function(*operands))


DIGITS: dict[str, Callable[..., Any]] = {
    "constpow": digits(lambda a, n: a**n),
    **{name: digits(getattr(mpmath, name)) for name in ("sqrt", "sin", "cos", "atan")},
}


def law_values_are_inside(tree: expression.Expression, box: dict[str, list[float]]) -> None:
    """At the ends, in the middle and at zero, in 50 digits."""
    try:
        found = enclosure(tree, {name: Interval(*ends) for name, ends in box.items()})
    except mbdlft.SceneError:  # the root of a negative interval
        return
    assert found.low <= found.high
    with mpmath.workdps(50):
        points = {
            name: [low, high, *{np.clip(x, low, high) for x in (0.0, 0.3 * low + 0.7 * high)}]
            for name, (low, high) in box.items()
        }
        for point in itertools.product(*points.values()):
            values = {n: mpmath.mpf(x) for n, x in zip(box, point, strict=True)}
            try:
                value = real(expression.evaluate(tree, values, mpmath.mpf, DIGITS))
            except (ValueError, ZeroDivisionError):
                continue
            assert found.low <= value <= found.high, f"{value} is not in {found}"


@given(trees, boxes)
def test_values_are_inside(tree: expression.Expression, box: dict[str, list[float]]) -> None:
    law_values_are_inside(tree, box)


def test_quotients_of_what_overflows() -> None:
    """Their ends are infinity over infinity."""
    tree, huge = expression.parse("(0 - 1e200*x)/(0 - 1e200*x)"), {"x": [1e200, 1e200]}
    law_values_are_inside(tree, huge)


@given(trees, ends)
def test_values_at_a_point_are_inside(tree: expression.Expression, at: float) -> None:
    law_values_are_inside(tree, {"x": [at, at], "y": [at, at]})


@pytest.mark.parametrize(
    ("text", "x", "y"),
    [
        ("x + y", (0.1, 0.1), (0.2, 0.2)),
        ("x - y", (1.0, 1.0), (1e-30, 1e-30)),
        ("x*y", (0.1, 0.1), (0.1, 0.1)),
        ("x*y", (1e-200, 1e-200), (1e-200, 1e-200)),
        ("x*y", (1e200, 1e200), (1e200, 1e200)),
        ("x/y", (1.0, 1.0), (3.0, 3.0)),
        ("x^3 + y", (0.1, 0.1), (0.0, 0.0)),
        ("sqrt(x)*y", (2.0, 2.0), (1.0, 1.0)),
        ("sin(x)", (0.1, 3.0), (0.0, 0.0)),
        ("cos(x)", (-0.5, 1.0), (0.0, 0.0)),
    ],
)
def test_last_units_and_turns_are_inside(text: str, x: list[float], y: list[float]) -> None:
    """The rounding of each operation decides, and so does the largest value inside of a range."""
    law_values_are_inside(expression.parse(text), {"x": list(x), "y": list(y)})


def test_a_library_may_be_wrong_in_the_last_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sine that is wrong by three units in the last place."""
    monkeypatch.setattr(interval.math, "sin", lambda x: float(np.sin(x)) * (1.0 + 3.0 * EPS))
    law_values_are_inside(expression.parse("sin(x)"), {"x": [0.7, 0.7], "y": [0.0, 0.0]})


def test_ends_are_near() -> None:
    """Of single operations the ends are reached, to rounding; also of even powers across zero."""
    box = {"x": Interval(-1.0, 2.0), "y": Interval(0.5, 4.0)}
    for text, low, high in (
        ("x + y", -0.5, 6.0),
        ("x*y", -4.0, 8.0),
        ("x/y", -2.0, 4.0),
        ("x^2", 0.0, 4.0),
        ("x^3", -1.0, 8.0),
        ("y^(-2)", 0.0625, 4.0),
        ("sqrt(y)", np.sqrt(0.5), 2.0),
        ("atan(x)", -np.pi / 4, np.arctan(2.0)),
        ("sin(x)", np.sin(-1.0), 1.0),
        ("0*(1/x)", 0.0, 0.0),
    ):
        found = enclosure(expression.parse(text), box)
        roundoff([found.low, found.high], [low, high], scale=max(1.0, high))
    assert enclosure(expression.parse("1/x"), box) == interval.UNKNOWN


def test_numbers_of_a_text_are_its_decimals() -> None:
    """0.4 - 0.3 - 0.1 is zero, though its doubles leave 3e-17."""
    text, parameter = "1/(a - 0.3 - 0.1)", mbdlft.Parameter("a", 0.5, 0.4, 1.0)
    with pytest.raises(mbdlft.WellPosednessError, match=r"vanishes in the range, near a = 0\.4"):
        mbdlft.realize([[text]], [parameter], search=0.0)


# Taylor models ----------------------------------------------------------------------------------

radii = st.one_of(st.just(0.0), st.floats(1e-300, 1e3))
numbers = st.one_of(st.sampled_from([0.0, 1e-170, -1e-170, 0.1]), st.floats(-1e3, 1e3))


def law_radii_hold(a: float, r: float, b: float, s: float) -> None:
    """[a - r, a + r] and [b - s, b + s], added, multiplied, widened: exact fractions are inside."""
    monomials = taylor.space(1, 1)
    x, y = (taylor.Taylor(monomials, np.array([[c], [0.0]]), np.array([e])) for c, e in ((a, r), (b, s)))
    exact = [Fraction(value) for value in (a, r, b, s)]
    for sign, other in itertools.product((1, -1), (1, -1)):
        u, v = exact[0] + sign * exact[1], exact[2] + other * exact[3]
        for found, value in (
            (x + y, u + v),
            (x - y, u - v),
            (x * y, u * v),
            (x * b, u * exact[2]),
            (taylor.widened(x, s), u + other * exact[3]),
        ):
            radius = float(found.r[0])
            assert abs(value - Fraction(float(found.c[0, 0]))) <= Fraction(radius)
            assert abs(value) <= Fraction(float(taylor.largest(found)[0]))


@given(numbers, radii, numbers, radii)
def test_radii_hold(a: float, r: float, b: float, s: float) -> None:
    assume(abs(a) + r < 1e100)
    law_radii_hold(a, r, b, s)


@pytest.mark.parametrize(
    "case",
    [(0.1, 1.0, 0.2, 2.0**-60), (1e-170, 0.0, 1e-170, 0.0), (0.0, 1.0, 0.0, 2.0**-54)],
    ids=["sum", "underflow", "radii"],
)
def test_rounding_of_radii_is_counted(case: tuple[float, float, float, float]) -> None:
    """Also of the sums that make a radius."""
    law_radii_hold(*case)


def test_what_many_products_lose_by_underflow_is_counted() -> None:
    """(s + s x + ... + s x^4)^2 at x = 1 with products below the least number."""
    monomials, least = taylor.space(1, 4), 1.5e-162
    a = taylor.Taylor(monomials, np.full((5, 1), least), np.zeros(1))
    polynomial = sum(map(Fraction, (a * a).c[:, 0].tolist()))
    assert abs((5 * Fraction(least)) ** 2 - polynomial) <= Fraction(float((a * a).r[0]))


def cancelling(boxes: int) -> taylor.Taylor:
    """Polynomials of degree 60 with control points of 1 at the end x = 1 and of at most 1/2 elsewhere.

    Their coefficients are 10^7 and cancel: the sum at the end loses more than the 2^-40 that `up` adds.
    """
    monomials, random = taylor.space(1, 60), np.random.default_rng(0)
    inverse = np.linalg.inv(monomials.bernstein.astype(float))
    points = random.uniform(-0.5, 0.5, (61, boxes))
    points[-1] = 1.0
    return taylor.Taylor(monomials, inverse @ points, np.zeros(boxes))


def test_rounding_of_control_points_is_counted() -> None:
    """The largest size is that at the end, where all coefficients are summed; here in fractions."""
    a = cancelling(64)
    bounds = taylor.largest(a).tolist()
    exact = [abs(sum(map(Fraction, column))) for column in a.c.T.tolist()]
    assert all(value <= Fraction(bound) for value, bound in zip(exact, bounds, strict=True))
    # the negative control: what doubles make of the sums alone is below the truth
    points = taylor.up(np.abs(a.space.bernstein @ a.c).max(axis=0)).tolist()
    assert any(value > Fraction(bound) for value, bound in zip(exact, points, strict=True))


def test_a_number_minus_an_interval() -> None:
    difference = 3.0 - Interval(1.0, 2.0)
    assert difference.low <= 1.0 <= 2.0 <= difference.high
    assert difference.high < 2.1


# Signs of functions in a box: what is proved is true, what is refuted has a point, the rest is open.


def ball(center: np.ndarray, offset: float):
    """sum (x_k - c_k)^2 + offset"""

    def function(x: Mapping[str, Any]) -> Any:
        steps = [value - float(at) for value, at in zip(x.values(), center, strict=True)]
        return sum((step * step for step in steps[1:]), steps[0] * steps[0]) + offset

    return function


@pytest.mark.parametrize("seed", range(30))
def test_a_ball_inside_is_found(seed: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 5))
    center, radius = random.uniform(-0.9, 0.9, count), 10.0 ** random.uniform(-3.0, -1.0)
    bounds = {f"x{k}": (-1.0, 1.0) for k in range(count)}
    found = not_negative(ball(center, -(radius**2)), bounds, boxes=4096)
    assert found.point is not None
    assert np.linalg.norm(np.array(list(found.point.values())) - center) < radius
    assert found.value < 0.0


@pytest.mark.parametrize("seed", range(30))
def test_what_stays_above_is_proved(seed: int) -> None:
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 5))
    center = random.uniform(-0.9, 0.9, count)
    bounds = {f"x{k}": (-1.0, 1.0) for k in range(count)}
    assert not_negative(ball(center, 0.01), bounds, boxes=4096).is_proved


@pytest.mark.parametrize("boxes", [0, 1, 3, 20])
def test_few_parts_leave_it_open(boxes: int) -> None:
    """And the open parts hold the zero."""
    center = np.array([0.3137, 0.7219])
    bounds = {"a": (0.0, 1.0), "b": (0.0, 1.0)}
    found = not_negative(ball(center, -1e-10), bounds, boxes=boxes)
    assert found.point is None
    assert not found.is_proved
    assert any(
        all(low <= at <= high for (low, high), at in zip(part, center, strict=True))
        for part in found.open_parts
    )


def test_a_zero_that_is_not_crossed_is_open_or_within_the_slack() -> None:
    square = ball(np.array([0.1]), 0.0)
    assert not_negative(square, {"x": (-1.0, 1.0)}, 1e-9).is_proved
    found = not_negative(lambda x: x["x"] - x["x"] * 1.0, {"x": (-1.0, 1.0)}, 1e-12)
    assert found.is_proved
    below = not_negative(lambda x: x["x"] * 0.0 - 1e-6, {"x": (-1.0, 1.0)}, 1e-7)
    assert below.point is not None


def test_a_pole_is_open() -> None:
    found = not_negative(lambda x: 1.0 / (x["x"] * x["x"]), {"x": (-1.0, 2.0)}, boxes=60)
    assert not found.is_proved


@pytest.mark.parametrize("variables", [1, 2, 5, 7])
def test_lowest_is_below(variables: int) -> None:
    random = np.random.default_rng(variables)
    space = taylor.space(variables, 2)
    c = random.standard_normal((len(space), 3))
    u = taylor.Taylor(space, c, np.array([0.0, 0.1, 1e-17]))
    for x in (random.uniform(-1.0, 1.0, (200, variables)), random.choice([-1.0, 1.0], (50, variables))):
        powers = np.prod(x[:, None, :] ** space.exponents, axis=2)
        assert np.all(powers @ c - u.r >= lowest(u))


RANGES = {"a": 0.5, "b": 0.5}
CONSTANTS = {
    "rho": Constant(value=1.0, unit="kg/m^2"),
    "a0": Constant(value=0.3137, unit="m"),
    "b0": Constant(value=0.7219, unit="m"),
    "e": Constant(value=0.01, unit="m"),
    "unit": Constant(value=1.0, unit="m^2"),
    "half": Constant(value=0.5, unit="m"),
}


def bob(mass: str, **inertia: Any) -> Scene:
    parameters = [Parameter(n, 0.5, low=0.0, high=1.0, unit="m") for n in "ab"]
    body = kit.body("bob", mass, inertia=Inertia(**inertia)) if inertia else kit.point("bob", mass)
    return kit.scene(
        "disc",
        *parameters,
        body,
        kit.hinge("s", "ground", "bob", (1, 0, 0), preload=0.0),
        constants=CONSTANTS,
    )


DISC = "rho*((a - a0)^2 + (b - b0)^2 - e^2)"
AROUND = DISC.replace("- e^2", "+ e^2")


test_what_fails_in_a_disc = refused(
    r"""
> check_positive(bob({})) => SceneError:
DISC => body 'bob': mass [kg] is negative in the range, at a = 0.3
"1", xx=DISC + "*unit"
    => inertia.xx [kg m^2] about the center of mass is negative in the range, at a = 0.3
"1", xx="2", yy="1", zz="1 - unit*rho*e^2 + " + DISC + "*unit"
    => inertia.yy + inertia.zz - inertia.xx [kg m^2] about the center of mass is negative
"1", xx="2", yy="2", zz="2", xy="1 - 0.999*" + DISC + "*unit"
    => a minor of the second moments of mass that follow from the inertia is negative
"""
)


@pytest.mark.parametrize(
    ("mass", "inertia"),
    [
        (AROUND, {}),
        ("1", {"xx": AROUND + "*unit"}),
        ("1", {"xx": 0.0, "yy": "rho*a^2*unit", "zz": "rho*a^2*unit"}),  # a rod: a minor is zero
        ("rho*a*b", {"xx": "rho*a*b*b^2/12", "yy": "rho*a*b*a^2/12", "zz": "rho*a*b*(a^2 + b^2)/12"}),
        ("rho*unit/(1 + a/half)", {"xx": "rho*unit*unit/(1 + a/half)"}),
    ],
)
def test_what_is_proved_everywhere(mass: str, inertia: dict[str, Any]) -> None:
    assert all(outcome.sign.is_proved for outcome in check_positive(bob(mass, **inertia)))


def test_what_is_open_lists_its_parts() -> None:
    mass = "rho*((a - a0)*(a - a0) + (b - b0)*(b - b0) + e^2)"
    (outcome,) = check_positive(bob(mass), boxes=2)
    assert outcome.sign.open_parts
    assert outcome.names == ("a", "b")


@pytest.mark.parametrize("seed", range(5))
def test_minors_are_those_of_the_second_moments(seed: int) -> None:
    random = np.random.default_rng(seed)
    J = random.standard_normal((3, 3))
    J = J + J.T + 5.0 * np.eye(3)
    entries = {a + b: Number(J[i, j]) for i, a in enumerate("xyz") for j, b in enumerate("xyz")}
    found = [float(evaluate(one, {})) for _, one, _ in checks._second_moments(entries)]
    P = np.trace(J) * np.eye(3) - 2.0 * J
    minors = [np.linalg.det(np.delete(np.delete(P, k, 0), k, 1)) for k in (2, 1, 0)]
    roundoff(np.array(found), np.array([*np.diag(P), *minors, np.linalg.det(P)]), scale=1e3)
