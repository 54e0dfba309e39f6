"""Units, such as ``"N m/rad"``: a factor to SI and a dimension; and signals, whose values have units."""

import re
from dataclasses import dataclass
from decimal import Context, Decimal, localcontext
from fractions import Fraction
from functools import cache
from typing import NamedTuple

import numpy as np

from mbdlft.base.errors import SceneError, unknown_name

Exponents = tuple[int | Fraction, ...]  # of kg, m, s, A and K
BASE, _NONE = ("kg", "m", "s", "A", "K"), (0, 0, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class Unit:
    """The factor of a unit to SI and its exponents of kg, m, s, A and K.

    An angle is dimensionless; a cycle, as in Hz and rpm, is 2 pi rad. `exact` is the factor, unless pi is
    in it.
    """

    factor: float
    dimension: tuple[int, ...]
    exact: Fraction | None = None

    def __mul__(self, other: "Unit") -> "Unit":
        dimension = tuple(a + b for a, b in zip(self.dimension, other.dimension, strict=True))
        if self.exact is not None and other.exact is not None:
            exact = self.exact * other.exact
            return Unit(float(exact), dimension, exact)
        return Unit(self.factor * other.factor, dimension)

    def __pow__(self, exponent: int) -> "Unit":
        dimension = tuple(a * exponent for a in self.dimension)
        if self.exact is not None:
            exact = self.exact**exponent
            return Unit(float(exact), dimension, exact)
        return Unit(self.factor**exponent, dimension)


_TWO_PI = 2.0 * float(np.pi)
_FACTORS = {  # dimension: factors by symbol
    (0, 0, 0, 0, 0): {"1": 1.0, "%": 0.01, "rad": 1.0, "deg": float(np.pi) / 180.0, "rev": _TWO_PI},
    (1, 0, 0, 0, 0): {"g": 1e-3, "kg": 1.0, "t": 1e3},
    (0, 1, 0, 0, 0): {"m": 1.0},
    (0, 0, 1, 0, 0): {"s": 1.0, "min": 60.0, "h": 3600.0},
    (0, 0, -1, 0, 0): {"rpm": _TWO_PI / 60.0, "Hz": _TWO_PI},
    (1, 1, -2, 0, 0): {"N": 1.0},
    (1, -1, -2, 0, 0): {"Pa": 1.0},
    (1, 2, -2, 0, 0): {"J": 1.0},
    (1, 2, -3, 0, 0): {"W": 1.0},
    (0, 0, 0, 1, 0): {"A": 1.0},
    (0, 0, 0, 0, 1): {"K": 1.0},
    (0, 0, 1, 1, 0): {"C": 1.0},
    (1, 2, -3, -1, 0): {"V": 1.0},
    (1, 2, -3, -2, 0): {"Ohm": 1.0},
    (-1, -2, 3, 2, 0): {"S": 1.0},
    (-1, -2, 4, 2, 0): {"F": 1.0},
    (1, 2, -2, -2, 0): {"H": 1.0},
    (1, 2, -2, -1, 0): {"Wb": 1.0},
    (1, 0, -2, -1, 0): {"T": 1.0},
}
_WITH_PI = ("deg", "rev", "rpm", "Hz")
_BASE = {
    symbol: Unit(factor, dimension, None if symbol in _WITH_PI else Fraction(repr(factor)))
    for dimension, factors in _FACTORS.items()
    for symbol, factor in factors.items()
}
_PREFIX = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3, "M": 1e6, "G": 1e9}
_PREFIXED = (
    *("g", "m", "s", "Hz", "N", "Pa", "J", "W", "rad", "t"),
    *("A", "K", "C", "V", "Ohm", "S", "F", "H", "Wb", "T"),
)
_SYMBOLS = _BASE | {
    prefix + name: _BASE[name] * Unit(factor, _NONE, Fraction(repr(factor)))
    for prefix, factor in _PREFIX.items()
    for name in _PREFIXED
    if prefix + name not in _BASE
}
_TOKEN = re.compile(r"\s*(?:([A-Za-zµ%]+|1)(?:\s*\^\s*(-?\d)(?!\d))?|([*/·]))")

# what people write for a symbol; the text that takes its place may be a product
_WORDS = {
    **dict.fromkeys(("metre", "meter"), "m"),
    **dict.fromkeys(("second", "sec"), "s"),
    **dict.fromkeys(("gram", "gramme"), "g"),
    **dict.fromkeys(("tonne", "ton"), "t"),
    **dict.fromkeys(("minute", "mn"), "min"),
    **dict.fromkeys(("hour", "hr"), "h"),
    **dict.fromkeys(("radian", "rad", "rd"), "rad"),
    **dict.fromkeys(("degree", "°"), "deg"),
    **dict.fromkeys(("turn", "revolution", "cycle"), "rev"),
    **dict.fromkeys(("hertz", "hz"), "Hz"),
    **{"newton": "N", "pascal": "Pa", "pa": "Pa", "joule": "J", "watt": "W", "nm": "N m"},
    **{"volt": "V", "ampere": "A", "amp": "A", "kelvin": "K", "ohm": "Ohm", "kg": "kg", "percent": "%"},
    **{"newtonmeter": "N m", "kilo": "kg", "dimensionles": "1", "none": "1"},
}
_PREFIX_WORDS = {
    "": "",
    "kilo": "k",
    "mega": "M",
    "milli": "m",
    "micro": "u",
    "centi": "c",
    "nano": "n",
    "giga": "G",
}
_MORE_DIGITS = 60  # those of factors, and of what has no end, such as 1/60
ANGLE_UNITS = ("deg", "rad")


@cache
def parse_unit(text: str) -> Unit:
    """Parse the text of a unit: symbols with integer powers, joined by blanks, ``*`` or ``/``.

    ``"N m/rad"``, ``"kg m^2"``, ``"mm"``, ``"deg"`` and ``"1"`` are units. A slash divides by the
    one symbol that follows it.
    """
    if not text.strip():
        raise SceneError("a unit is empty; write '1' for a dimensionless quantity.")
    unit, divide, position, after_symbol = _SYMBOLS["1"], False, 0, False
    while position < len(text.rstrip()):
        match = _TOKEN.match(text, position)
        symbol, exponent, operator = match.groups() if match else (None, None, None)
        if match is None or (operator and not after_symbol):
            raise _unreadable(text, text[position:].strip())
        position, after_symbol = match.end(), not operator
        if operator:
            divide = operator == "/"
            continue
        if symbol is None or symbol not in _SYMBOLS:
            raise _unknown(text, str(symbol))
        power = int(exponent or 1)
        unit = unit * _SYMBOLS[symbol] ** (-power if divide else power)
        divide = False
    if not after_symbol:
        raise _unreadable(text, text.rstrip()[-1])
    return unit


def in_si(number: str, unit: Unit) -> str:
    """A number in a unit as one in SI units: all its digits, but for factors such as pi/180 or 1/60."""
    if unit.factor == 1.0:
        return number
    exact = Fraction(repr(unit.factor)) if unit.exact is None else unit.exact
    with localcontext(Context(prec=len(number) + _MORE_DIGITS)):
        return str(Decimal(number) * exact.numerator / exact.denominator)


def _unknown(text: str, symbol: str) -> SceneError:
    """An error for a symbol that is none; of words, plurals and other spellings it says the symbol."""
    word = symbol.lower().removesuffix("s")
    for prefix, letter in _PREFIX_WORDS.items():
        if word.removeprefix(prefix) in _WORDS and word != prefix:
            meant = letter * (word not in _WORDS) + _WORDS.get(word, _WORDS[word.removeprefix(prefix)])
            return SceneError(f"unit {text!r}: unknown symbol {symbol!r}. Did you mean {meant!r}?")
    near = [known for known in _BASE if len(symbol) > 2 or known.lower() == symbol.lower()]
    said = unknown_name("symbol", symbol, near or ["kg", "m", "s", "N", "rad", "deg", "Hz"])
    return SceneError(f"unit {text!r}: {said} Most of them take the prefixes {' '.join(_PREFIX)}.")


def _unreadable(text: str, behind: str) -> SceneError:
    """An error for a text that is not a unit from `behind` on."""
    return SceneError(
        f"unit {text!r} cannot be read at {behind!r}. Write symbols with integer powers joined by "
        "blanks, '*' or '/', such as 'N m/rad' or 'kg m^2'."
    )


def dimension_name(dimension: Exponents) -> str:
    """A dimension as a text in SI base units, such as ``kg m^2 s^-2``; ``1`` for a dimensionless one."""
    factors = [
        name if exponent == 1 else f"{name}^{exponent}"
        for name, exponent in zip(BASE, dimension, strict=True)
        if exponent
    ]
    return " ".join(factors) or "1"


@dataclass(frozen=True, slots=True)
class Signal:
    """A scalar input, output or state, such as ``shoulder.torque`` in ``N m``."""

    name: str
    unit: str

    def of(self, owner: str) -> "Signal":
        """The signal with the name of its owner in front, ``OWNER.NAME``."""
        return Signal(f"{owner}.{self.name}", self.unit)


class Freedom(NamedTuple):
    """Names of one coordinate of a joint or an elastic body."""

    label: str  # the ending of labels of quantities, such as x of stiffness.x; empty for one alone
    effort: Signal  # its generalized force
    measures: tuple[Signal, Signal, Signal]  # its displacement, velocity and acceleration
    turns: bool  # whether it is an angle
