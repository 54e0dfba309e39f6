"""Relations that the numbers of a problem nearly have: they are said, and not made.

Decisions are made for the numbers as they are written. An axis (0, 0.5, 0.8660254) is not parallel to
another one after 30 deg, and what nearly cancels costs repetitions. So numbers beside others that they
may be meant to be are looked for. If a problem with these in their places has a smaller order, its
certificate says which.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from math import pi
from typing import NamedTuple

import casadi as ca

from mbdlft.base.errors import MbdlftError
from mbdlft.exact.numbers import LARGEST_ANGLE, Constant
from mbdlft.pipeline.candidates import Candidate, candidates
from mbdlft.problem.problem import Problem
from mbdlft.problem.sx.constants import constant, constants_in, double, is_zero

_MOST = 400  # channels before reduction: a second look at more takes long
_PART, _PART_OF_AXIS = 1e-9, 1e-5  # of itself, of its length: a number is near another one
_DIGITS, _DIGITS_OF_ANGLE = 6, 4  # a number of so many digits may be another one that was rounded
_SIMPLE, _LARGEST = 12, 144  # largest denominator and numerator of what may be meant
_STEP = 15  # degrees
_MOST_DIGITS = 20


class Signed(NamedTuple):
    """A constant, or its negative."""

    sign: int
    number: Constant

    @property
    def value(self) -> float:
        """The double next to it."""
        return self.sign * double(self.number)

    @property
    def symbol(self) -> ca.SX:
        """Its expression."""
        return self.sign * constant(self.number)

    def __str__(self) -> str:
        kind, argument = self.number.kind, self.number.argument
        unit = " rad" if self.number.in_radians else " deg"
        texts = {
            "rational": f"{argument}" if argument.denominator <= _SIMPLE else f"{self.value!r}",
            "root": f"sqrt({argument})",
            "pi": f"{argument} pi",
            "cosine": f"cos({float(argument):.15g}{unit})",
            "sine": f"sin({float(argument):.15g}{unit})",
            "unit": f"{self.value!r}",
        }
        by_value = texts[kind] == f"{self.value!r}"
        return texts[kind] if by_value or self.sign > 0 else f"-{texts[kind]}"


def near_relations(problem: Problem, found: Candidate) -> tuple[str, ...]:
    """Sentences on numbers that nearly are others, if the order is smaller with these."""
    relations = found.form.relations
    if sum(found.channels.values()) > _MOST:
        return ()
    symbols, numbers = constants_in(ca.vertcat(relations.residual, relations.output))
    meant = neighbors(numbers)
    if not meant:
        return ()
    places = ca.vertcat(*(meant.get(n, Signed(1, n)).symbol for n in numbers))
    residual, output = ca.substitute([relations.residual, relations.output], [symbols], [places])
    form = replace(found.form, relations=replace(relations, residual=residual, output=output))
    try:
        order = candidates(problem, [form])[0].lft.order
    except MbdlftError:  # with these numbers it cannot be solved: they are not meant
        return ()
    if order >= found.lft.order:
        return ()
    listed = "; ".join(
        f"{Signed(1, number)} is {abs(double(number) - other.value):.1g} from {other}"
        for number, other in meant.items()
        if double(number) != other.value
    )
    return (f"{listed}: written exactly, the order is {order}, not {found.lft.order}",)


def neighbors(numbers: Sequence[Constant]) -> dict[Constant, Signed]:
    """For numbers that are beside others, which they may be meant to be, these others."""
    found: dict[Constant, Signed] = {}
    has_pi = any(number.kind == "pi" for number in numbers)
    for k, number in enumerate(numbers):
        before = [n for n in numbers[:k] if n not in found and number.kind != "rational"]
        others = [Signed(sign, n) for n in before for sign in (1, -1)]
        for other in (*_special(number), *others):
            if other.number.kind == "pi" and not has_pi:
                continue  # there is nothing that it could be related to
            if _is_near(number, other) and not is_zero(constant(number) - other.symbol):
                found[number] = other
                break
    return found


def _special(number: Constant) -> Iterator[Signed]:
    """Numbers next to a number that people mean, the simplest first."""
    if number.in_radians and abs(number.argument) > LARGEST_ANGLE:
        return
    if number.in_radians:
        degrees = round(float(number.argument) * 180.0 / pi / _STEP) * _STEP
        yield Signed(1, Constant(number.kind, Fraction(degrees)))
    elif number.kind in ("rational", "unit"):
        value, sign = Fraction(abs(double(number))), 1 if double(number) > 0.0 else -1
        for kind, argument in (
            ("rational", value),
            ("root", value * value),
            ("pi", value / Fraction(pi)),
        ):
            simple = argument.limit_denominator(_SIMPLE)
            if simple.numerator <= _LARGEST and (simple or number.kind == "unit"):
                yield Signed(sign, Constant(kind, simple))


def _is_near(number: Constant, other: Signed) -> bool:
    """Whether a number is another one but for rounding, in doubles or to the digits that it has."""
    distance = abs(double(number) - other.value)
    if number.kind == "rational":
        rounding = _half_of_last_digit(number.argument, _DIGITS)
        return distance <= max(rounding, _PART * abs(double(number)))
    if number.in_radians and not other.number.in_radians:
        angle = float(other.number.argument) * pi / 180.0
        rounding = _half_of_last_digit(number.argument, _DIGITS_OF_ANGLE)
        return abs(float(number.argument) - angle) <= rounding
    return distance <= (_PART_OF_AXIS if number.kind == "unit" else _PART * abs(double(number)))


def _half_of_last_digit(number: Fraction, digits: int) -> float:
    """Half a unit of the last decimal of a number that has at least so many digits; 0.0 otherwise."""
    for decimals in range(_MOST_DIGITS):
        shifted = number * 10**decimals
        if shifted.denominator == 1:
            return 0.5 * 10.0**-decimals if len(str(abs(int(shifted)))) >= digits else 0.0
    return 0.0
