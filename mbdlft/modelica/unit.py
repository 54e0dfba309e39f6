"""Units as Modelica writes them, such as ``N.m/(rad.s)`` or ``kg.m2``, as units of this package."""

import re

from mbdlft.base.errors import SceneError
from mbdlft.base.unit import parse_unit

_FACTOR = re.compile(r"([^\W\d_]+|%|1)([+-]?\d+)?")


def unit_of(text: str) -> str | None:
    """The unit of this package, such as ``N m rad^-1 s^-1``; None if it is not known here.

    Modelica Specification 3.6, section 20.1: one slash at most, products by dots, exponents without sign
    or caret, parentheses around the denominator.
    """
    above, slash, below = text.replace(" ", "").partition("/")
    factors = [*_factors(above, 1), *_factors(below, -1)] if slash else _factors(above, 1)
    if not all(factors):
        return None
    written = " ".join(factor for factor in factors if factor != "1") or "1"
    try:
        parse_unit(written)
    except SceneError:
        return None
    return written


def _factors(text: str, sign: int) -> list[str]:
    """The factors of a product; an empty one where it cannot be read."""
    if text.startswith("(") and text.endswith(")"):
        text = text[1:-1]
    found = []
    for part in text.split("."):
        match = _FACTOR.fullmatch(part)
        if match is None:
            return [""]
        exponent = sign * int(match[2] or 1)
        found.append(match[1] if exponent == 1 or match[1] == "1" else f"{match[1]}^{exponent}")
    return found
