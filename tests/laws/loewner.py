"""McMillan degrees by another way: ranks of Loewner matrices modulo a prime, by FLINT.

Entries of texts are evaluated as Python expressions in integers modulo a prime that the package does not
use.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction

import flint
import numpy as np

from mbdlft.lft.lft import LFT

PRIME = 2**61 - 1
_MOST = 10  # degree of a parameter in the matrices of the tests


def residue(value: float | str) -> flint.nmod:
    fraction = Fraction(value)
    return flint.nmod(fraction.numerator, PRIME) / fraction.denominator


def degree(values: Callable[[int], flint.nmod_mat], most: int, random: np.random.Generator) -> int:
    """The degree, at most so much, of a matrix that has these values: the rank of its Loewner matrix."""
    points = [int(z) for z in random.integers(1, PRIME, 2 * most)]
    lefts, rights = ([(z, values(z)) for z in half] for half in (points[:most], points[most:]))
    rows, columns = lefts[0][1].nrows(), lefts[0][1].ncols()
    entries = [
        (left[i, j] - right[i, j]) / (mu - z)
        for mu, left in lefts
        for i in range(rows)
        for z, right in rights
        for j in range(columns)
    ]
    return flint.nmod_mat(rows * most, columns * most, entries, PRIME).rank()


def python_text(text: str) -> str:
    """A text with its numbers made by F, and ** for powers; exponents stay numbers of Python."""
    return re.sub(r"(?<![\w.^])(\d[\d.]*(?:e[-+]?\d+)?)", r"F('\1')", text.replace("^-", "^ -")).replace(
        "^", "**"
    )


def values(rows: Sequence[Sequence[str]], at: Mapping[str, int]) -> flint.nmod_mat:
    """The matrix at residues; those of an angle are tangents of its half."""
    known = {name: residue(value) for name, value in at.items()}
    names = {
        "F": residue,
        "cos": lambda t: (1 - t * t) / (1 + t * t),
        "sin": lambda t: 2 * t / (1 + t * t),
    }
    entries = [eval(python_text(text), names, known) for row in rows for text in row]
    return flint.nmod_mat(len(rows), len(rows[0]), [residue(0) + x for x in entries], PRIME)


def degrees(rows: Sequence[Sequence[str]], names: Sequence[str], seed: int = 0) -> dict[str, int]:
    """The McMillan degree in each parameter, if it is below 10 times the shorter side."""
    random, found = np.random.default_rng(seed), {}
    for name in names:
        others = {other: int(random.integers(1, PRIME)) for other in names}
        found[name] = degree(lambda z, at=others, name=name: values(rows, at | {name: z}), _MOST, random)
    return found


def exact_degree(a: LFT, name: str, random: np.random.Generator) -> int:
    """The McMillan degree of an LFT, whose entries are short binary fractions, in a delta."""
    others = {block.name: int(random.integers(1, PRIME)) for block in a.blocks}
    M = np.block([[a.M11, a.M12], [a.M21, a.M22]])

    def value(z: int) -> flint.nmod_mat:
        at = others | {name: z}
        return value_modulo(M, [at[block.name] for block in a.blocks for _ in range(block.size)])

    return degree(value, dict(a.blocks)[name] + 1, random)


def value_modulo(M: np.ndarray, deltas: Sequence[int]) -> flint.nmod_mat:
    """M22 + M21 Delta (I - M11 Delta)^-1 M12 modulo the prime."""
    n = len(deltas)
    M11, M12, M21, M22 = map(_residues, (M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:]))
    if not n:
        return M22
    D = _residues(np.diag(np.array(deltas, dtype=object)))
    return M22 + M21 * D * (_residues(np.eye(n)) - M11 * D).solve(M12)


def _residues(matrix: np.ndarray) -> flint.nmod_mat:
    return flint.nmod_mat(*matrix.shape, [residue(x) for x in matrix.ravel().tolist()], PRIME)
