"""Whether units fit: equations are followed with the units of quantities in place of numbers.

What is added or compared has one unit: the same exponents of kg, m, s, A and K, and the same factor to
SI, as nothing is converted. A plain number may carry any unit, so that `0.001*x` is a length in km if x
is one in m; and so may a quantity in "1", whose unit is not given. One in "rad" is dimensionless.
"""

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import casadi as ca

from mbdlft.base.errors import SceneError
from mbdlft.base.unit import Exponents, dimension_name, parse_unit
from mbdlft.dae.dae import Dae
from mbdlft.dae.text import column_of
from mbdlft.exact.operators import Operators
from mbdlft.problem.sx.constants import is_constant
from mbdlft.problem.sx.tapes import Rules, fold, rules

_SAME = 1e-9  # relative, of factors: products of few powers of ten, 60 and pi, that were rounded


@dataclass(frozen=True, slots=True)
class Measure(Operators):
    """The unit of a value: its exponents of kg, m, s, A, K, and its factor to SI; `OPEN` is any unit."""

    exponents: Exponents | None
    factor: float = 1.0
    text: str = field(default="", compare=False)

    def __str__(self) -> str:
        if self.exponents is None:
            return "any unit"
        name = dimension_name(self.exponents)
        if self.text and (self.factor != 1.0 or name == "1"):
            return self.text
        return name if self.factor == 1.0 else f"{self.factor:.6g} {name}"

    def fits(self, other: "Measure") -> bool:
        """Whether values in both may be added; `OPEN` fits to all."""
        if self.exponents is None or other.exponents is None:
            return True
        return self.exponents == other.exponents and math.isclose(
            self.factor, other.factor, rel_tol=_SAME
        )

    def __add__(self, other: "Measure") -> "Measure":
        if not self.fits(other):
            raise SceneError(f"{self} and {other} are added or compared; units do not fit.")
        return other if self.exponents is None else self

    def __neg__(self) -> "Measure":
        return self

    def __mul__(self, other: "Measure") -> "Measure":
        if self.exponents is None or other.exponents is None:
            return OPEN
        exponents = tuple(a + b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Measure(exponents, self.factor * other.factor)

    def __truediv__(self, other: "Measure") -> "Measure":
        return self * other.power(Fraction(-1))

    def power(self, exponent: Fraction) -> "Measure":
        """The unit of a power of a value."""
        if self.exponents is None:
            return OPEN
        powers = [Fraction(x) * exponent for x in self.exponents]
        whole = tuple(int(x) if x.denominator == 1 else x for x in powers)
        return Measure(whole, self.factor ** float(exponent))

    def root(self) -> "Measure":
        """The unit of a square root of a value."""
        return self.power(Fraction(1, 2))


OPEN = Measure(None)


def measure_of(text: str) -> Measure:
    """That of the text of a unit."""
    unit = parse_unit(text)
    return Measure(unit.dimension, unit.factor, text)


NUMBER, SECOND = measure_of("rad"), measure_of("s")


def open_unit(text: str) -> Measure:
    """That of the text of a unit; of "1" it is open."""
    return OPEN if text == "1" else measure_of(text)


def plain(value: Measure, function: str = "a function") -> Measure:
    """The value of a function such as exp, dimensionless as its argument is."""
    if not value.fits(NUMBER):
        raise SceneError(f"{function} of a value in {value}; it takes plain numbers and angles in rad.")
    return NUMBER


def compared(a: Measure, b: Measure) -> Measure:
    """A condition on two values, which have the same unit."""
    a + b
    return OPEN


def check_units(dae: Dae) -> None:
    """Raise a SceneError that names the equation and both units where units do not fit."""
    measures = {v.symbol.element_hash(): open_unit(v.unit) for v in (*dae.variables, *dae.inputs)}
    for v in dae.variables:
        if v.derivative is not None:
            measures[v.derivative.element_hash()] = open_unit(v.unit) / SECOND
    for p, symbol in zip(dae.parameters, ca.vertsplit(dae.p), strict=True):
        measures[symbol.element_hash()] = NUMBER if p.is_angle else open_unit(p.unit)
    residuals = [(f"equation {e.place}", e.residual, e.unit) for e in (*dae.equations, *dae.initial)]
    residuals += [(f"output {y.name!r}", y.expression, y.unit) for y in dae.outputs]
    for what, expression, unit in residuals:
        try:
            measure = unit_of(expression, measures)
            if unit is not None:
                measure + open_unit(unit)
        except SceneError as error:
            raise SceneError(
                f"{dae.owner}, {what}: {error} A 1 or 2 that has a unit is written d.number(1)."
            ) from None


def unit_of(expression: ca.SX, measures: Mapping[int, Measure]) -> Measure:
    """The unit of an expression of symbols that have some, by their hashes."""
    free = ca.symvar(expression)
    values = [OPEN if is_constant(s) else measures[s.element_hash()] for s in free]
    function = ca.Function("units", [column_of(free)], [ca.densify(expression)])
    measure: Measure = fold(function, _RULES, values)[0][0]
    return measure


_PLAIN = (
    *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
    *("asinh", "acosh", "atanh", "exp", "log", "log1p", "expm1"),
)
_RULES: Rules = rules(
    lambda value: OPEN,
    add=operator.add,
    mul=operator.mul,
    div=operator.truediv,
    neg=operator.neg,
    twice=lambda a: a if any(a.exponents or ()) else OPEN,  # the 2 may carry any unit, too
    inv=lambda a: OPEN,
    sqrt=Measure.root,
    **dict.fromkeys(("fmin", "fmax"), operator.add),
    if_else_zero=lambda condition, a: a,
    **dict.fromkeys(("lt", "le"), compared),
    missing=lambda operation, where, *operands: OPEN,
    **dict.fromkeys(("fabs", "floor", "ceil"), lambda a: a),
    **dict.fromkeys(_PLAIN, plain),
)
