"""What equations are made of: a part linear in signals, a number, and nonlinear functions with factors.

value = sum c_k(p) l_k + c_0(p) + sum c_j(p) f_j,      l_k, f_j without parameters
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import NamedTuple

import casadi as ca

from mbdlft.dae.alias import rational
from mbdlft.problem.sx.constants import is_constant, literal

ONE_KEY = "1"


class Part(NamedTuple):
    """A coefficient of parameters and numbers, times an expression linear in signals."""

    coefficient: ca.SX
    form: ca.SX


@dataclass(frozen=True, slots=True, eq=False)
class Mixed:
    """A value in an equation.

    Attributes
    ----------
    linear : mapping of the text of a coefficient to `Part`
        The forms have numbers only.
    constant : SX, or None for zero
        Of parameters and numbers.
    terms : mapping of numbers of functions to their factors SX
    """

    linear: Mapping[str, Part]
    constant: ca.SX | None
    terms: Mapping[int, ca.SX]

    @property
    def is_coefficient(self) -> bool:
        """Whether there are no signals in it."""
        return not self.linear and not self.terms

    @property
    def is_plain(self) -> bool:
        """Whether there are no parameters in it."""
        return (
            set(self.linear) <= {ONE_KEY}
            and (self.constant is None or is_constant(self.constant))
            and all(is_constant(c) for c in self.terms.values())
        )


NOTHING = Mixed({}, None, {})


def coefficient(value: ca.SX) -> Mixed:
    """A value of parameters and numbers."""
    return NOTHING if rational(value) == 0 else Mixed({}, value, {})


def signal(symbol: ca.SX) -> Mixed:
    """A signal."""
    return Mixed({ONE_KEY: Part(ca.SX(1), symbol)}, None, {})


def term(number: int, factor: ca.SX) -> Mixed:
    """A function with a factor."""
    return Mixed({}, None, {number: factor})


def plus(a: Mixed, b: Mixed) -> Mixed:
    """Sum."""
    linear = dict(a.linear)
    for key, part in b.linear.items():
        known = linear.get(key)
        linear[key] = part if known is None else Part(known.coefficient, known.form + part.form)
    linear = {key: part for key, part in linear.items() if not _is_zero(part.form)}
    terms = dict(a.terms)
    for number, factor in b.terms.items():
        terms[number] = terms[number] + factor if number in terms else factor
    terms = {number: factor for number, factor in terms.items() if not _is_zero(factor)}
    if a.constant is None or b.constant is None:
        constant = b.constant if a.constant is None else a.constant
    else:
        constant = a.constant + b.constant
        constant = None if _is_zero(constant) else constant
    return Mixed(linear, constant, terms)


def times(a: Mixed, factor: ca.SX) -> Mixed:
    """Times a coefficient."""
    number = rational(factor)
    if number is not None:
        if not number:
            return NOTHING
        if number == 1:
            return a
    linear: dict[str, Part] = {}
    for key, part in a.linear.items():
        if is_constant(factor):
            linear[key] = Part(part.coefficient, factor * part.form)
            continue
        new = factor if key == ONE_KEY else part.coefficient * factor
        known = linear.get(str(new))
        linear[str(new)] = Part(new, part.form if known is None else known.form + part.form)
    return Mixed(
        linear,
        None if a.constant is None else factor * a.constant,
        {number: c * factor for number, c in a.terms.items()},
    )


def _is_zero(expression: ca.SX) -> bool:
    return expression.nnz() == 0 or bool(expression.is_zero())


@cache
def number(value: Fraction) -> ca.SX:
    """A number as SX that is not rounded."""
    return ca.SX(literal(value))
