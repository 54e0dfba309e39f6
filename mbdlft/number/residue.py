"""Integers modulo a prime: a value that is not zero there is not zero."""

from fractions import Fraction

from mbdlft.number.operators import Operators

PRIME = 2**61 - 1


class Residue(Operators):
    """An integer modulo the prime."""

    __slots__ = ("value",)

    def __init__(self, value: int) -> None:
        self.value = value % PRIME

    @staticmethod
    def of(number: "Residue | float") -> "Residue":
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

    def __add__(self, other: "Residue | float") -> "Residue":
        return Residue(self.value + Residue.of(other).value)

    def __neg__(self) -> "Residue":
        return Residue(-self.value)

    def __mul__(self, other: "Residue | float") -> "Residue":
        return Residue(self.value * Residue.of(other).value)

    def __truediv__(self, other: "Residue | float") -> "Residue":
        return Residue(self.value * pow(Residue.of(other).value, -1, PRIME))
