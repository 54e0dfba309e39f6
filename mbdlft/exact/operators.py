"""What all number systems share: the operators that follow from + * / and -a, also with floats."""

from typing import Any


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
