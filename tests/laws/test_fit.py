"""Laws of fits of equilibria: the bound holds, is tight, belongs to the right branch."""

import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest

from mbdlft.base.errors import TrimError
from mbdlft.base.expression import evaluate, names, parse
from mbdlft.exact import taylor
from mbdlft.multibody.equilibrium import branches
from mbdlft.multibody.equilibrium import fit as fitting
from mbdlft.multibody.equilibrium.branches import system
from mbdlft.multibody.equilibrium.fit import EquilibriumFit, fit_equilibrium
from mbdlft.problem.sx.tapes import arithmetic, fold
from tests.close import FIT_BOUND, exact, roundoff
from tests.seeds import some

mpmath.mp.dps = 50


@dataclass(frozen=True)
class Case:
    """A residual that is written once, for CasADi and for mpmath."""

    residual: Callable[[Any, Any, Any], list[Any]]
    box: Sequence[tuple[float, float, float]]  # low, nominal, high
    start: Sequence[float]
    tolerance: float

    def fit(self, **options: Any) -> EquilibriumFit:
        t, p = ca.SX.sym("t", len(self.start)), ca.SX.sym("p", len(self.box))
        f = ca.Function("joint", [t, p], [ca.vertcat(*self.residual(t, p, ca))])
        low, nominal, high = np.array(self.box).T
        return fit_equilibrium(f, nominal, low, high, np.array(self.start), self.tolerance, **options)

    def errors(self, fit: EquilibriumFit, points: Sequence[Sequence[float]]) -> np.ndarray:
        """|fit - root| (N, n) to 50 digits, with the texts of the fit."""
        found = []
        trees = [parse(text) for text in fit.expressions]
        for point in points:
            p = [mpmath.mpf(float(value)) for value in point]
            values = dict(zip(fit.names, p, strict=True))
            t = [mpmath.mpf(evaluate(tree, values, mpmath.mpf)) for tree in trees]
            root = mpmath.findroot(partial(_equations, self.residual, p), t if len(t) > 1 else t[0])
            roots = list(root) if len(t) > 1 else [root]
            found.append([float(abs(a - b)) for a, b in zip(t, roots, strict=True)])
        return np.array(found)

    def points(self, count: int) -> list[tuple[float, ...]]:
        """A grid with the ends, no node of which is a Chebyshev node but those."""
        return list(itertools.product(*(np.linspace(a, b, count) for a, _, b in self.box)))


def _equations(residual: Callable[[Any, Any, Any], list[Any]], p: Any, *t: Any) -> Any:
    f = residual(t, p, mpmath)
    return f if len(t) > 1 else f[0]


def half_angle(t: Any) -> tuple[Any, Any]:
    """Cosine and sine of the angle whose half has the tangent t."""
    return (1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)


def tangent(t: Any, p: Any, m: Any) -> list[Any]:
    """tan(theta) = (0.2 + p0)/(1 + 0.3 p1), with t = tan(theta/2)."""
    return [2 * t[0] * (1 + 0.3 * p[1]) - (1 - t[0] * t[0]) * (0.2 + p[0])]


def spring(t: Any, p: Any, m: Any) -> list[Any]:
    """A pendulum with a mass p0 beside its axis and a linear spring p1: the unknown is the angle."""
    return [p[1] * t[0] + 2 * m.sin(t[0]) - p[0] * m.cos(t[0])]


def offset(t: Any, p: Any, m: Any) -> list[Any]:
    """A pendulum with a mass p0 at an arm p1 beside it and a torsion spring with moment k sin."""
    c, s = half_angle(t[0])
    return [p[0] * p[1] * c - (1.5 + m.sqrt(p[1])) * s]


def two_links(t: Any, p: Any, m: Any) -> list[Any]:
    """Two coupled angles: links with springs p0 and p1."""
    return [
        p[0] * t[0] - m.sin(t[0] + 0.4) - 0.3 * m.sin(t[0] - t[1]),
        p[1] * t[1] - 0.5 * m.cos(t[1]) + 0.3 * m.sin(t[0] - t[1]),
    ]


def peak(t: Any, p: Any, m: Any) -> list[Any]:
    """A resonance 2e-3 wide between the samples, on a smooth curve."""
    return [(t[0] - m.sin(p[0])) * (1 + 1e6 * (p[0] - 0.3137) ** 2) - 0.01]


def twisted(t: Any, p: Any, m: Any) -> list[Any]:
    """Three parameters, one of them an angle."""
    return [p[0] * t[0] - p[1] * m.sin(t[0] + p[2])]


def three_links(t: Any, p: Any, m: Any) -> list[Any]:
    """Three coupled angles in a ring of springs p1."""
    return [
        p[0] * t[k] - m.sin(t[k] + 0.4 + 0.1 * k) - 0.3 * p[1] * m.sin(t[k] - t[(k + 1) % 3])
        for k in range(3)
    ]


CASES = {
    "closed form": Case(tangent, [(0.0, 0.5, 1.0), (-0.5, 0.0, 1.0)], [0.3], 1e-6),
    "spring": Case(spring, [(0.5, 1.0, 1.5), (3.0, 4.0, 6.0)], [0.2], 1e-6),
    "offset": Case(offset, [(0.5, 1.0, 1.5), (0.2, 0.5, 1.0)], [0.1], 1e-8),
    "two links": Case(two_links, [(3.0, 4.0, 5.0), (2.5, 3.0, 4.0)], [0.1, 0.1], 1e-5),
    "three links": Case(three_links, [(3.0, 4.0, 5.0), (0.5, 1.0, 1.5)], [0.1] * 3, 1e-3),
    "three parameters": Case(twisted, [(4.0, 5.0, 6.0), (1.5, 2.0, 2.5), (0.1, 0.3, 0.5)], [0.1], 1e-4),
}
PEAK = Case(peak, [(0.0, 0.7, 1.0)], [0.6], 1e-3)
POINTS = {2: 13, 3: 5}


def bound_holds(case: Case, fit: EquilibriumFit, points: Sequence[Sequence[float]]) -> np.ndarray:
    """The largest errors (n,) at the points, none above the bound."""
    assert np.all(fit.bound <= case.tolerance)
    largest = case.errors(fit, points).max(axis=0)
    assert np.all(largest <= fit.bound), f"error {largest}, bound {fit.bound}"
    return np.asarray(largest)


@pytest.mark.parametrize("name", some([name for name in CASES if name != "three links"], CASES))
def test_bound_holds_and_is_tight(name: str) -> None:
    case = CASES[name]
    fit = case.fit()
    points = case.points(POINTS[len(case.box)])
    largest = bound_holds(case, fit, points)
    assert np.all(fit.bound <= (1 + FIT_BOUND) * largest), f"{fit.bound / largest}"
    assert set().union(*(names(parse(text)) for text in fit.expressions)) <= set(fit.names)
    roundoff(
        fit(np.array(points)).T,
        [
            evaluate(parse(t), dict(zip(fit.names, np.array(points).T, strict=True)))
            for t in fit.expressions
        ],
        kappa=100.0,
    )


def test_closed_form() -> None:
    case = CASES["closed form"]
    fit = case.fit(names=["a", "b"])
    p = np.array(case.points(41))
    expected = np.tan(0.5 * np.arctan((0.2 + p[:, 0]) / (1 + 0.3 * p[:, 1])))
    assert np.max(np.abs(fit(p)[:, 0] - expected)) <= fit.bound[0]
    assert names(parse(fit.expressions[0])) == {"a", "b"}


def other_root(t: np.ndarray) -> np.ndarray:
    return -1 / t


def test_the_branch_is_that_of_the_start() -> None:
    """tan theta has two half angles, t and -1/t."""
    case = CASES["closed form"]
    other = Case(tangent, [(0.4, 0.5, 0.6), (-0.1, 0.0, 0.1)], [-3.0], 1e-6)
    p = np.array(other.points(9))
    expected = np.tan(0.5 * np.arctan((0.2 + p[:, 0]) / (1 + 0.3 * p[:, 1])))

    def same_branch(case: Case, expected: np.ndarray) -> None:
        fit = case.fit()
        assert np.max(np.abs(fit(p)[:, 0] - expected)) <= fit.bound[0]

    same_branch(other, other_root(expected))
    same_branch(Case(tangent, other.box, case.start, 1e-6), expected)


def test_rational_equilibrium_has_its_own_degree() -> None:
    """t = (0.1 + p0)/(1 + 0.3 p0 + 0.2 p1) is found again, whatever the tolerance."""
    case = Case(
        lambda t, p, m: [t[0] * (1 + 0.3 * p[0] + 0.2 * p[1]) - (0.1 + p[0])],
        [(-1.0, 0.0, 1.0), (-1.0, 0.0, 1.0)],
        [0.1],
        1e-9,
    )
    fit = case.fit()
    function = fit.functions[0]
    assert function.numerator_exponents.sum(axis=1).max() == 1
    assert function.denominator_exponents.sum(axis=1).max() == 1
    bound_holds(case, fit, case.points(9))


def test_polynomial_equilibrium_needs_no_denominator() -> None:
    case = Case(
        lambda t, p, m: [t[0] - 0.1 - p[0] ** 2 * (1 - p[1])],
        [(-1.0, 0.0, 1.0), (-1.0, 0.0, 1.0)],
        [0.1],
        1e-9,
    )
    fit = case.fit()
    exact(fit.functions[0].denominator, [1.0])
    exact(fit.functions[0].numerator_exponents.max(axis=0), [2, 1])
    bound_holds(case, fit, case.points(9))


def test_a_peak_between_the_samples_is_found() -> None:
    points = [(x,) for x in (0.1, 0.313, 0.3137, 0.3145, 0.8)]
    bound_holds(PEAK, PEAK.fit(largest_degree=12), points)


def test_a_pole_between_the_samples_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """t = p; the first fit is planted: a zero next to a pole, too close for the errors to tell."""
    case = Case(lambda t, p, m: [t[0] - p[0]], [(-1.0, 0.0, 1.0)], [0.0], 1e-6)
    right, seen, pole = fitting.smallest_fit, [], 0.6180339887
    zero = pole * (1 + 1e-15)
    powers = np.array([[0], [1], [2]])
    planted = fitting.Rational(
        np.zeros(1), powers, np.array([0.0, 1.0, -1 / zero]), powers[:2], np.array([1.0, -1 / pole])
    )

    def fit(x: Any, t: Any, guards: Any, *others: Any) -> Any:
        seen.append(guards)
        return (planted, 0.0) if len(seen) == 1 else right(x, t, guards, *others)

    monkeypatch.setattr(fitting, "smallest_fit", fit)
    bound_holds(case, found := case.fit(), [(-1.0,), (pole,), (1.0,)])
    exact(found.functions[0].denominator, [1.0])
    added = seen[1][len(seen[0]) :]
    assert len(added)
    assert np.all(planted.below(added) <= 0)


EXPRESSIONS: dict[str, Callable[[Any, Any], Any]] = {
    "product": lambda x, m: (x[0] * x[1] + 3) * (x[0] - x[1]) ** 3 * (1 - x[0] * x[1]),
    "quotient": lambda x, m: (x[0] - 2) / (2.5 + x[0] + x[1] * x[0]),
    "root": lambda x, m: m.sqrt(2 + x[0] * x[1] + x[1]),
    "sine": lambda x, m: m.sin(2 * x[0] + x[1] * x[1]) + m.cos(5 * x[0] * x[1] - 1),
    "tangent": lambda x, m: m.tan(0.5 * x[0] + 0.3 * x[1]),
    "cancellation": lambda x, m: ((x[0] + 1e8) * (x[1] - 1e8)) + 1e8 * (x[0] - x[1]) + 1e16,
}


@pytest.mark.parametrize("order", [1, 2, 5])
@pytest.mark.parametrize("name", EXPRESSIONS)
def test_taylor_models_enclose(name: str, order: int) -> None:
    """The values at points of boxes, to 50 digits, are within the radius of the polynomial."""
    x = ca.SX.sym("x", 2)
    tape = ca.Function("f", [x], [EXPRESSIONS[name](x, ca)])
    rng = np.random.default_rng(7)
    low = rng.uniform(-1, 0.7, (6, 2))
    high = low + rng.uniform(1e-3, 0.3, (6, 2))
    monomials = taylor.space(2, order)
    variables = [taylor.variable(monomials, k, low[:, k], high[:, k]) for k in range(2)]
    with np.errstate(all="ignore"):
        table = arithmetic(lambda v: taylor.constant(monomials, v, 6), taylor.FUNCTIONS)
        f = fold(tape, table, variables)[0][0]
        largest = taylor.largest(f)
    assert np.all(np.isfinite(f.r))
    for k, point in itertools.product(range(6), itertools.product((-1.0, 0.3, 1.0), repeat=2)):
        scaled = [mpmath.mpf(value) for value in point]
        physical = [
            mpmath.mpf(v.c[0, k]) + s * mpmath.mpf(v.c[:, k][monomials.degrees == 1].max())
            for v, s in zip(variables, scaled, strict=True)
        ]
        value = EXPRESSIONS[name](physical, mpmath)
        polynomial = sum(
            mpmath.mpf(c) * scaled[0] ** int(a) * scaled[1] ** int(b)
            for c, (a, b) in zip(f.c[:, k], monomials.exponents, strict=True)
        )
        assert abs(value - polynomial) <= f.r[k]
        assert abs(value) <= largest[k]


def test_singular_jacobian_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """t = 0 is a root for all p, but p0 t = sin t has others where p0 is near to 1."""
    case = Case(lambda t, p, m: [p[0] * t[0] - m.sin(t[0])], [(0.5, 2.0, 2.6)], [0.0], 1e-6)
    monkeypatch.setattr(fitting, "follow", lambda s, nominal, root, p: np.zeros((len(p), 1)))

    with pytest.raises(TrimError, match="nothing can be proved near") as caught:
        case.fit()
    roundoff(place(str(caught.value), ["p1"]), [1.0], kappa=1e10)


def test_bifurcation_of_a_column() -> None:
    """An inverted pendulum on a spring: k theta = F l sin theta buckles at k = F l."""
    case = Case(
        lambda t, p, m: [p[0] * t[0] - p[1] * 0.5 * m.sin(t[0])],
        [(1.0, 5.0, 8.0), (3.0, 4.0, 6.0)],
        [0.0],
        1e-6,
    )
    with pytest.raises(TrimError, match="bifurcates") as caught:
        case.fit(names=["k", "F"])
    k, force = place(str(caught.value), ["k", "F"])
    roundoff([k], [0.5 * force], kappa=1e10)
    stiff = Case(case.residual, [(3.5, 5.0, 8.0), (3.0, 4.0, 6.0)], [0.0], 1e-6)
    exact(stiff.fit().functions[0].numerator, [0.0])


def test_fold_where_no_root_is_left() -> None:
    """sin theta = p with p up to 1.2: the last equilibrium is at p = 1, theta = 90 deg, t = 1."""

    def lever(t: Any, p: Any, m: Any) -> list[Any]:
        return [half_angle(t[0])[1] - p[0]]

    with pytest.raises(TrimError, match="folds") as caught:
        Case(lever, [(0.0, 0.5, 1.2)], [0.25], 1e-6).fit(names=["load"])
    roundoff(place(str(caught.value), ["load"]), [1.0], kappa=1e10)
    bound_holds(case := Case(lever, [(0.0, 0.5, 0.9)], [0.25], 1e-6), case.fit(), case.points(101))


def place(message: str, names: Sequence[str]) -> list[float]:
    """Parameter values that a message tells."""
    found = [re.search(rf"\b{name} = ([-+.e\d]+)", message) for name in names]
    return [float(match[1]) for match in found if match]


# Enclosures of the distance of a fit from the root: they hold it, or they are infinite --------------

LOW, HIGH = 0.99, 1.01


def distance(fit: str, radius: float) -> float:
    """The bound of |fit - p^(1/3)| that is proved on the box, looking at so large distances."""
    t, p = ca.SX.sym("t"), ca.SX.sym("p")
    cube = system(ca.Function("cube", [t, p], [t * t * t - p]), ["p"])
    box = np.array([[LOW]]), np.array([[HIGH]])
    found, _ = branches.enclose(cube, [parse(fit)], *box, np.array([radius]))
    return float(found[0, 0])


def test_a_bound_holds_the_distance() -> None:
    largest = 1.001 - LOW ** (1 / 3)
    assert largest <= distance("1.001", 0.01) < 0.01


def test_a_root_outside_of_the_radius_is_not_enclosed() -> None:
    """The step of Newton from 1.3 leads to 1.06: 0.24 is less than the distance of the root."""
    assert distance("1.3", 0.001) == np.inf


def test_a_slope_that_changes_too_much_encloses_nothing() -> None:
    """Within 0.5 of 1.3 the slope is a third and twice what it is there."""
    assert distance("1.3", 0.5) == np.inf
