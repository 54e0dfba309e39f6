"""Poles that no values of the controllers move, at one point of the box.

Such are modes that the controllers do not see or do not drive, and others that their structure leaves
fixed (Wang, Davison, IEEE Transactions on Automatic Control 18, 1973).

They are the roots that det(s I - A(x)) has for all x. Doubles count as they are written: how many there
are, and how often 0 is one, is decided modulo a prime, at random x. Where they are, eigenvalues say.
"""

from fractions import Fraction
from typing import Any

import flint
import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.exact.modular import multiplied, solved
from mbdlft.exact.numbers import Field
from mbdlft.robust.realization import AXIS
from mbdlft.synthesis.loop import Family


def fixed_poles(family: Family, scale: Array) -> NDArray[np.complex128]:
    """Poles (k,) on the right, or zero, of the loop at the first point with any values, of this scale."""
    polynomials = [_characteristic(family, seed) for seed in (0, 1)]
    common = polynomials[0].gcd(polynomials[1])
    draws = [np.random.default_rng(seed).standard_normal(len(scale)) * scale for seed in (2, 3)]
    loops = [closed for draw in draws if (closed := family.closed(draw)) is not None]
    if not common.degree() or len(loops) < 2:
        return np.zeros(0, dtype=np.complex128)
    here, there = (np.linalg.eigvals(loop.A[0]).astype(np.complex128) for loop in loops)
    moved = np.min(np.abs(here[:, None] - there), axis=1)
    poles = here[np.argsort(moved)[: common.degree()]]
    zeros = next(k for k in range(common.degree() + 1) if common[k] != 0)
    poles[np.argsort(np.abs(poles))[:zeros]] = 0.0
    return np.asarray(poles[(poles == 0.0) | (poles.real > AXIS * np.max(np.abs(here)))])


def _characteristic(family: Family, seed: int) -> Any:
    """det(s I - A(x)) modulo a prime, at random x."""
    n, field = family.states, Field(())

    def residues(values: Array) -> NDArray[np.int64]:
        of_each = [field.residue(Fraction(float(x))) for x in values.ravel()]
        return np.array([int(x) for x in of_each], dtype=np.int64).reshape(values.shape)

    p = field.prime
    x = np.random.default_rng(seed).integers(1, 2**59, len(family.moves))
    S = residues(family.base)
    for value, move in zip(x.tolist(), family.moves, strict=True):
        i, j = np.nonzero(move)
        S[i, j] = [
            (int(s) + value * int(m)) % p for s, m in zip(S[i, j], residues(move[i, j]), strict=True)
        ]
    L, R, D = residues(family.L[0, :n]), residues(family.R[0, :, :n]), residues(family.D22[0])
    inner = (np.eye(len(S), dtype=np.int64) - multiplied(S, D, p)) % p
    gain = solved(inner, multiplied(S, R, p), p)
    A = (residues(family.X[0, :n, :n]) + multiplied(L, gain, p)) % p
    return flint.nmod_mat(n, n, A.ravel().tolist(), p).charpoly()
