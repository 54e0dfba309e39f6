"""McMillan degrees of matrices of texts by another way: ranks of Loewner matrices modulo a prime.

Entries are evaluated as Python expressions in integers modulo a prime that the package does not use.
"""

import re
from collections.abc import Mapping, Sequence
from fractions import Fraction

import numpy as np

from tests.laws.test_bound import PRIME, Rows, solve_modulo

_MOST = 10  # degree of a parameter in the matrices of the tests


class Modular:
    """An integer modulo the prime, with `+ - * / **`."""

    def __init__(self, value: "str | int | Fraction | Modular") -> None:
        if isinstance(value, Modular):
            self.value = value.value
            return
        fraction = Fraction(value)
        self.value = fraction.numerator * pow(fraction.denominator, -1, PRIME) % PRIME

    def __add__(self, other: "Modular | int") -> "Modular":
        return Modular(self.value + Modular(other).value)

    def __sub__(self, other: "Modular | int") -> "Modular":
        return Modular(self.value - Modular(other).value)

    def __mul__(self, other: "Modular | int") -> "Modular":
        return Modular(self.value * Modular(other).value)

    def __truediv__(self, other: "Modular | int") -> "Modular":
        return Modular(self.value * pow(Modular(other).value, -1, PRIME))

    def __neg__(self) -> "Modular":
        return Modular(-self.value)

    def __pow__(self, exponent: int) -> "Modular":
        return Modular(pow(self.value, exponent, PRIME))


def python_text(text: str) -> str:
    """A text with its numbers made by F, and ** for powers; exponents stay numbers of Python."""
    return re.sub(r"(?<![\w.^])(\d[\d.]*(?:e[-+]?\d+)?)", r"F('\1')", text.replace("^-", "^ -")).replace(
        "^", "**"
    )


def values(rows: Sequence[Sequence[str]], at: Mapping[str, int]) -> Rows:
    """The matrix at residues; those of an angle are tangents of its half."""
    known: dict[str, object] = {name: Modular(value) for name, value in at.items()}

    def cosine(t: Modular) -> Modular:
        return (Modular(1) - t * t) / (t * t + 1)

    def sine(t: Modular) -> Modular:
        return Modular(2) * t / (t * t + 1)

    names = {"F": Modular, "cos": cosine, "sin": sine}
    return [[Modular(eval(python_text(text), names, known)).value for text in row] for row in rows]


def degrees(rows: Sequence[Sequence[str]], names: Sequence[str], seed: int = 0) -> dict[str, int]:
    """The McMillan degree in each parameter, if it is below 10 times the shorter side."""
    random, found = np.random.default_rng(seed), {}
    for name in names:
        others = {other: int(random.integers(1, PRIME)) for other in names}
        points = [int(z) for z in random.integers(1, PRIME, 2 * _MOST)]
        samples = [values(rows, others | {name: z}) for z in points]
        matrix: Rows = []
        for mu, left in zip(points[:_MOST], samples[:_MOST], strict=True):
            for i in range(len(rows)):
                row: list[int] = []
                for z, right in zip(points[_MOST:], samples[_MOST:], strict=True):
                    over = pow(mu - z, -1, PRIME)
                    pairs = zip(left[i], right[i], strict=True)
                    row += [(x - y) * over % PRIME for x, y in pairs]
                matrix.append(row)
        found[name] = solve_modulo(matrix, [[] for _ in matrix])[1]
    return found
