"""Dimensions as a number system: an expression is evaluated to see whether its units fit."""

from dataclasses import dataclass

from mbdlft.base.errors import SceneError
from mbdlft.base.unit import dimension_name
from mbdlft.number.operators import Operators


@dataclass(frozen=True, slots=True)
class Dimension(Operators):
    """Exponents of kg, m, s of a value; None where a plain number may carry any unit."""

    exponents: tuple[int, int, int] | None

    @staticmethod
    def of(number: "Dimension | float") -> "Dimension":
        """A plain number may carry any unit."""
        return number if isinstance(number, Dimension) else Dimension(None)

    def __add__(self, other: "Dimension | float") -> "Dimension":
        if isinstance(other, float) or other.exponents is None:
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
        if isinstance(other, float) or self.exponents is None or other.exponents is None:
            return Dimension(None)
        kg, m, s = (a + sign * b for a, b in zip(self.exponents, other.exponents, strict=True))
        return Dimension((kg, m, s))

    def __mul__(self, other: "Dimension | float") -> "Dimension":
        return self._times(other, 1)

    def __truediv__(self, other: "Dimension | float") -> "Dimension":
        return self._times(other, -1)
