"""Units as Modelica writes them, such as ``N.m/(rad.s)`` or ``kg.m2``, as units of this package."""

import re

from mbdlft.base.errors import SceneError
from mbdlft.base.unit import parse_unit

_FACTOR = re.compile(r"([^\W\d_]+|%|1)([+-]?\d+)?")


def unit_of(text: str) -> str | None:
    """The unit of this package, such as ``N m/rad/s``; None if it is not known here.

    Modelica Specification 3.6, section 19.1: one slash at most, products by dots, exponents without sign
    or caret, parentheses around the denominator.
    """
    above, slash, below = text.replace(" ", "").partition("/")
    factors = [*_factors(above, 1), *(_factors(below, -1) if slash else [])]
    if None in factors:
        return None
    known = [factor for factor in factors if factor is not None and factor[0] != "1"]
    upper = " ".join(_power(symbol, exponent) for symbol, exponent in known if exponent > 0)
    lower = "".join(f"/{_power(symbol, -exponent)}" for symbol, exponent in known if exponent < 0)
    written = (upper or "1") + lower
    try:
        parse_unit(written)
    except SceneError:
        return None
    return written


def _power(symbol: str, exponent: int) -> str:
    return symbol if exponent == 1 else f"{symbol}^{exponent}"


def _factors(text: str, sign: int) -> list[tuple[str, int] | None]:
    """The factors of a product and their exponents; None for one that cannot be read."""
    if text.startswith("(") and text.endswith(")"):
        text = text[1:-1]
    matches = [_FACTOR.fullmatch(part) for part in text.split(".")]
    return [match and (match[1], sign * int(match[2] or 1)) for match in matches]
