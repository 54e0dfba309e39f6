"""Matrices of known LFTs, written as quotients: right order, bounds, values and words, or an error.

Families: whole numbers of any length, decimals, fractions, terms that cancel, parameters, rows and
columns of sizes from 1e-9 to 1e9, constants that are not rational, denominators that vanish in a ball.
"""

from dataclasses import dataclass, replace
from fractions import Fraction
from math import lcm
from pathlib import Path
from typing import Any

import mpmath
import numpy as np

import mbdlft
from mbdlft import MbdlftError, Parameter
from mbdlft.problem.references import NEGLIGIBLE
from tests.attack.known import Known, Polynomial, degrees, known, polynomials, value
from tests.attack.mutations import check_message
from tests.close import ATTACKED

CONSTANTS = {
    "pi": lambda: mpmath.pi,
    "sqrt(2)": lambda: mpmath.sqrt(2),
    "(1+sqrt(5))": lambda: 1 + mpmath.sqrt(5),
    "cos(0.3)": lambda: mpmath.cos(mpmath.mpf(3) / 10),
    "sin(70*deg)": lambda: mpmath.sin(70 * mpmath.pi / 180),
    "atan(0.5)": lambda: mpmath.atan(mpmath.mpf(1) / 2),
    "7.25": lambda: mpmath.mpf("7.25"),
}
NOTHING = (  # what is zero, with a name x
    "1e13*x-1e13*x",
    "0.1*x+0.2*x-0.3*x",
    "123456789012345678*x-123456789012345677*x-x",
    "1e130*x^2-1e130*x*x",
    "(x-1)*(x+1)-x^2+1",
    "sqrt(2)*sqrt(3)*x-sqrt(6)*x",
    "(cos(0.3)^2+sin(0.3)^2-1)*x",
    "1e15*(cos(36*deg)-cos(72*deg)-0.5)*x",
    "(x+1e-9)^3-x^3-3e-9*x^2-3e-18*x-1e-27",
)
FAMILIES = ("whole", "decimal", "fraction", "canceling", "scaled", "constants")
POINTS = 12


@dataclass(frozen=True)
class Drawn:
    """A matrix in texts, and what is known of it; parameters times `factors` are those of `lft`."""

    lft: Known
    family: str
    rows: list[list[str]]
    factors: dict[str, str]
    parameters: list[Parameter]
    states: int


def attack(seed: int, folder: Path) -> str:
    """Realize a matrix, and compare with what is known."""
    random = np.random.default_rng(seed)
    drawn = draw(random, FAMILIES[seed % len(FAMILIES)])
    try:
        model = mbdlft.realize(
            drawn.rows,
            drawn.parameters,
            states=drawn.states,
            search=float(random.choice([0.0, 0.0, 0.0, 1.0])),
        )
    except MbdlftError as error:
        check_message(error)
        return f"{drawn.family} refused: {type(error).__name__}"
    check_bounds(drawn, model, random)
    check_values(drawn, model, random)
    return f"{drawn.family} exact"


def check_bounds(drawn: Drawn, model: mbdlft.LFTModel, random: np.random.Generator) -> None:
    """Bounds are the degrees, none is above the known order, and the words say so."""
    found, sizes = model.certificate, dict(zip(drawn.lft.names, drawn.lft.sizes, strict=True))
    names = [p.name for p in model.parameters]
    expected = degrees(drawn.lft, random)
    assert dict(zip(names, found.lower_bound, strict=True)) == expected
    assert all(bound <= sizes[name] for name, bound in expected.items())
    assert sum(found.lower_bound) <= found.order_bound <= drawn.lft.order
    assert found.order == tuple(dict(model.lft.blocks).get(name, 0) for name in names)
    assert sum(found.order) >= found.order_bound
    assert found.minimal == (sum(found.order) == found.order_bound)
    assert found.exact
    assert found.exact_bound
    assert not any(found.doubtful)


def check_values(drawn: Drawn, model: mbdlft.LFTModel, random: np.random.Generator) -> None:
    """Values at random points and corners, relative to each entry or to what the certificate says."""
    share = random.uniform(0.0, 1.0, (POINTS, len(drawn.parameters)))
    share[: POINTS // 3] = np.rint(share[: POINTS // 3])
    points = {
        p.name: np.clip(p.low + s * (p.high - p.low), p.low, p.high)
        for p, s in zip(drawn.parameters, share.T, strict=True)
    }
    A, B, C, D = mbdlft.matrices_at(model, points)
    found = np.block([[A, B], [C, D]])
    expected = np.array(
        [values_of(drawn, {name: Fraction(x[k]) for name, x in points.items()}) for k in range(POINTS)]
    )
    size = np.max(np.abs(expected), axis=0)
    both = balanced(size)
    scale = np.where(size > 0, np.maximum(size, NEGLIGIBLE * both), both)
    worst = float(np.max(np.max(np.abs(found - expected), axis=0) / scale))
    allowed = max(ATTACKED, 10.0 * model.certificate.max_relative_error)
    assert worst <= allowed, f"values differ by {worst:.1e}, the certificate says {allowed:.1e}"


def balanced(size: np.ndarray) -> np.ndarray:
    """What rows and columns have to do with the sizes of entries (rows, columns); Ruiz 2001."""
    rows, columns = np.ones(len(size)), np.ones(size.shape[1])
    for _ in range(10):
        left = size / rows[:, None] / columns
        rows *= np.sqrt(np.where((part := np.max(left, axis=1)) > 0, part, 1.0))
        columns *= np.sqrt(np.where((part := np.max(left, axis=0)) > 0, part, 1.0))
    return np.outer(rows, columns)


def values_of(drawn: Drawn, at: dict[str, Fraction]) -> list[list[float]]:
    """The matrix at a point, rounded once."""
    a, factors = drawn.lft, drawn.factors
    if set(factors.values()) <= {"1"}:
        return [[float(x) for x in row] for row in value(a, at)]
    with mpmath.workdps(60):
        numbers = {
            name: _number(x) * (CONSTANTS[factors[name]]() if factors[name] != "1" else 1)
            for name, x in at.items()
        }
        P, n, (rows, columns) = mpmath.diag(a.spread(numbers)), a.order, a.shape
        M = mpmath.matrix([[_number(x) for x in row] for row in a.M])
        inner = mpmath.inverse(mpmath.eye(n) - M[:n, :n] * P)
        found = M[n:, n:] + M[n:, :n] * P * inner * M[:n, n:]
        return [[float(found[i, j]) for j in range(columns)] for i in range(rows)]


def _number(x: Fraction) -> Any:
    return mpmath.mpf(x.numerator) / x.denominator


# what is drawn -------------------------------------------------------------------------------


def draw(random: np.random.Generator, family: str) -> Drawn:
    """A known LFT as texts of a family."""
    lft = known(random, spread=9 if family == "scaled" else 0)
    if random.random() < 0.1:  # a row that is constant
        n = lft.order
        M = [
            [Fraction(0) if i == n and j < n else x for j, x in enumerate(row)]
            for i, row in enumerate(lft.M)
        ]
        lft = replace(lft, M=M)
    factors = dict.fromkeys(lft.names, "1")
    if family == "constants":
        factors = {name: str(random.choice(list(CONSTANTS))) for name in lft.names}
    above, over = polynomials(lft)
    style = Style(random, family, lft, factors)
    rows = [[style.quotient(entry, over) for entry in row] for row in above]
    return Drawn(
        lft=lft,
        family=family,
        rows=rows,
        factors=factors,
        parameters=[style.parameter(k) for k in random.permutation(len(lft.names))],
        states=int(random.integers(0, min(lft.shape) + 1)) if random.random() < 0.3 else 0,
    )


class Style:
    """How polynomials of one matrix are written."""

    def __init__(
        self, random: np.random.Generator, family: str, lft: Known, factors: dict[str, str]
    ) -> None:
        self.random, self.family, self.lft, self.factors = random, family, lft, factors
        self.is_nested = random.random() < 0.4
        self.is_unreduced = random.random() < 0.3

    def parameter(self, k: int) -> Parameter:
        """A parameter whose range is a part of where the LFT is regular."""
        reach = float(self.lft.reach[k]) / (8.0 if self.family == "constants" else 1.0)
        low, nominal, high = np.sort(self.random.uniform(-1.0, 1.0, 3))
        width = high - low
        nominal = float(np.clip(nominal, low + 0.1 * width, high - 0.1 * width))
        if self.random.random() < 0.3:
            return Parameter(self.lft.names[k], 0.0, low=-reach, high=reach)
        return Parameter(self.lft.names[k], nominal * reach, low=low * reach, high=high * reach)

    def quotient(self, above: Polynomial, over: Polynomial) -> str:
        """N/D, with a factor in common or without, and with what cancels."""
        if self.is_unreduced:
            more = self.common()
            above, over = _product(above, more), _product(over, more)
        if self.family == "whole":
            unit = lcm(*(x.denominator for x in (*above.values(), *over.values())))
            above, over = ({e: unit * x for e, x in part.items()} for part in (above, over))
        text, below = self.text(above), self.text(over)
        if self.family == "canceling":
            for _ in range(int(self.random.integers(1, 3))):
                nothing = str(self.random.choice(NOTHING)).replace("x", "{}").format
                name = str(self.random.choice(self.lft.names))
                text += f" + {nothing(*[name] * 9)}"
            if self.random.random() < 0.3:
                return f"-150000*({text})/(-150000*({below}))"
        return f"({text})/({below})"

    def common(self) -> Polynomial:
        """A polynomial that does not vanish: 2 + p/reach, or 1 + (p/reach)^2."""
        k, power = int(self.random.integers(len(self.lft.names))), int(self.random.integers(1, 3))
        none = (0,) * len(self.lft.names)
        unit = Fraction(10) ** int(np.floor(np.log10(float(1 / self.lft.reach[k]))))
        return {none: Fraction(2), (*none[:k], power, *none[k + 1 :]): unit**power}

    def text(self, a: Polynomial) -> str:
        """A polynomial as a sum in any order, or nested."""
        if self.is_nested:
            return self.nested(a, 0)
        keys = [list(a)[k] for k in self.random.permutation(len(a))]
        return "+".join(self.term(e, a[e]) for e in keys) or "0"

    def nested(self, a: Polynomial, k: int) -> str:
        """In powers of parameter k, with coefficients in those after it."""
        if k == len(self.lft.names):
            (only,) = a.values()
            return self.coefficient(only)
        parts = []
        for power in sorted({e[k] for e in a}):
            inner = self.nested({e: x for e, x in a.items() if e[k] == power}, k + 1)
            parts.append("*".join([f"({inner})", *self.powers(k, power)]))
        return "+".join(parts) or "0"

    def term(self, exponents: tuple[int, ...], x: Fraction) -> str:
        """A coefficient and powers of the parameters."""
        powers = [text for k, e in enumerate(exponents) for text in self.powers(k, e)]
        return "*".join([self.coefficient(x), *powers])

    def powers(self, k: int, exponent: int) -> list[str]:
        """A power of a parameter times its constant."""
        if not exponent:
            return []
        name = self.lft.names[k]
        if (factor := self.factors[name]) != "1":
            name = f"({factor}*{name})"
        if self.random.random() < 0.3:
            return [name] * exponent
        return [f"{name}^{exponent}" if exponent > 1 else name]

    def coefficient(self, x: Fraction) -> str:
        """A number in all its digits."""
        if x.denominator == 1:
            text = str(x.numerator)
        elif self.family == "fraction":
            text = f"{x.numerator}/{x.denominator}"
        else:
            text = _decimal_text(x)
        return f"({text})"


def _decimal_text(x: Fraction) -> str:
    """A fraction of a power of ten as a decimal in all its digits."""
    places = 0
    while (x * 10**places).denominator != 1:
        places += 1
    return f"{(x * 10**places).numerator}e-{places}"


def _product(a: Polynomial, b: Polynomial) -> Polynomial:
    found: Polynomial = {}
    for e, x in a.items():
        for f, y in b.items():
            key = tuple(i + j for i, j in zip(e, f, strict=True))
            found[key] = found.get(key, Fraction(0)) + x * y
    return {e: x for e, x in found.items() if x}
