"""Integers modulo a prime: a value that is not zero there is not zero."""

from fractions import Fraction

PRIME = 2**61 - 1


class Residue:
    """An integer modulo the prime."""

    __slots__ = ("value",)

    def __init__(self, value: int) -> None:
        self.value = value % PRIME

    def __add__(self, other: "Residue | float") -> "Residue":
        return Residue(self.value + residue(other).value)

    __radd__ = __add__

    def __neg__(self) -> "Residue":
        return Residue(-self.value)

    def __sub__(self, other: "Residue | float") -> "Residue":
        return Residue(self.value - residue(other).value)

    def __rsub__(self, other: float) -> "Residue":
        return residue(other) - self

    def __mul__(self, other: "Residue | float") -> "Residue":
        return Residue(self.value * residue(other).value)

    __rmul__ = __mul__

    def __truediv__(self, other: "Residue | float") -> "Residue":
        return Residue(self.value * pow(residue(other).value, -1, PRIME))

    def __rtruediv__(self, other: float) -> "Residue":
        return residue(other) / self


def residue(number: "Residue | float") -> Residue:
    """The residue of a number, a float taken as the decimal it prints as.

    Raises
    ------
    ValueError
        The denominator is a multiple of the prime.
    """
    if isinstance(number, Residue):
        return number
    fraction = Fraction(repr(number))
    return Residue(fraction.numerator * pow(fraction.denominator, -1, PRIME))
