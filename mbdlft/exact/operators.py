"""Number systems: the operators that all of them share, and the two that are small.

Doubles, or arrays of them, have functions by the names of CasADi's operations. A `Dimension` holds the
exponents of the units of a value: an expression is evaluated in dimensions to see whether its units fit.

A number that stands by itself, or is a factor of dimensionless values only, may carry any unit: ``2.5``
and ``2.5*s`` are masses where a mass is expected. A number that is a factor of a value with a dimension
is a plain factor: ``2*l`` is a length, and ``2 [kg/m]*l`` a mass. A number that is added takes the unit
of the other terms.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from mbdlft.base.errors import SceneError
from mbdlft.base.expression import FUNCTIONS as FUNCTIONS_OF_NUMBERS
from mbdlft.base.unit import Exponents, dimension_name


class Operators:
    """An element of a number system; `of` makes one of a number that stands before an operator."""

    __slots__ = ()

    def __radd__(self: Any, other: Any) -> Any:
        return self + other

    def __sub__(self: Any, other: Any) -> Any:
        return self + -other

    def __rsub__(self: Any, other: Any) -> Any:
        return -self + other

    def __rmul__(self: Any, other: Any) -> Any:
        return self * other

    def __rtruediv__(self: Any, other: Any) -> Any:
        return self.of(other) / self


FUNCTIONS_OF_DOUBLES: Mapping[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "sqrt")},
    **{name: getattr(np, name) for name in ("exp", "expm1", "log", "log1p", "hypot", "floor")},
    **{name: getattr(np, name) for name in ("fabs", "sign", "copysign", "fmin", "fmax", "ceil")},
    **{f"a{name}": getattr(np, f"arc{name}") for name in ("sin", "cos", "tan", "tan2")},
    **{f"a{name}": getattr(np, f"arc{name}") for name in ("sinh", "cosh", "tanh")},
    **dict.fromkeys(("pow", "constpow"), np.power),
}

_NONE: Exponents = (0, 0, 0, 0, 0)


@dataclass(frozen=True, slots=True)
class Dimension(Operators):
    """Exponents of kg, m, s, A, K of a value; None where a plain number may carry any unit."""

    exponents: Exponents | None

    @staticmethod
    def of(number: "Dimension | float") -> "Dimension":
        """A plain number may carry any unit."""
        return number if isinstance(number, Dimension) else Dimension(None)

    def __add__(self, other: "Dimension | float") -> "Dimension":
        other = Dimension.of(other)
        if other.exponents is None:
            return self
        if self.exponents is None or self.exponents == other.exponents:
            return other
        raise SceneError(
            f"{dimension_name(self.exponents)} and {dimension_name(other.exponents)} are added; "
            "units do not fit."
        )

    def __neg__(self) -> "Dimension":
        return self

    def _times(self, other: "Dimension | float", sign: int) -> "Dimension":
        first, second = self.exponents, Dimension.of(other).exponents
        exponents = tuple(a + sign * b for a, b in zip(first or _NONE, second or _NONE, strict=True))
        # a number still carries any unit if nothing beside it has one
        open_ = (first is None or second is None) and not any(exponents)
        return Dimension(None if open_ else exponents)

    def __mul__(self, other: "Dimension | float") -> "Dimension":
        return self._times(other, 1)

    def __truediv__(self, other: "Dimension | float") -> "Dimension":
        return self._times(other, -1)


def _sqrt(value: Dimension) -> Dimension:
    if value.exponents is None:
        return value
    halves = (Fraction(exponent) / 2 for exponent in value.exponents)
    return Dimension(tuple(int(half) if half.denominator == 1 else half for half in halves))


def _of_angle(name: str, value: Dimension) -> Dimension:
    if value.exponents not in (None, _NONE):
        raise SceneError(
            f"{name} of a value in {dimension_name(value.exponents)}; it takes plain numbers and angles."
        )
    return value


def _function(name: str) -> Callable[["Dimension | float"], "Dimension | float"]:
    def of(value: "Dimension | float") -> "Dimension | float":
        if isinstance(value, float):
            return FUNCTIONS_OF_NUMBERS[name](value)
        return _sqrt(value) if name == "sqrt" else _of_angle(name, value)

    return of


FUNCTIONS_OF_DIMENSIONS: Mapping[str, Callable[..., "Dimension | float"]] = {
    "unit": Dimension,
    **{name: _function(name) for name in FUNCTIONS_OF_NUMBERS},
}
