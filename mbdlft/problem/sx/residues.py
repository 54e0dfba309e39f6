"""Values of expressions modulo a prime, with random residues for their symbols.

What is not zero there is no zero; what is zero there is zero for all values of the symbols, but for a
chance of about the degree of the expression times 1e-18.
"""

import operator
from typing import NamedTuple

import casadi as ca
import numpy as np

from mbdlft.exact.numbers import Field, constant_of
from mbdlft.problem.sx.constants import constants_in
from mbdlft.problem.sx.fold import fold, rules


class ModuloPrime(NamedTuple):
    """Residues of a matrix, as an array of whole numbers of its shape, and their prime."""

    residues: np.ndarray[tuple[int, ...], np.dtype[np.object_]]
    prime: int


def modulo_prime(matrix: ca.SX, seed: int) -> ModuloPrime:
    """Residues of a matrix (n, m) of rational expressions; constants count as they are written.

    Raises
    ------
    NotRationalError
        An operation is not rational.
    """
    dense = ca.densify(matrix)
    constants, numbers = constants_in(dense)
    known = {s.element_hash() for s in ca.vertsplit(constants)}
    free = [s for s in ca.symvar(dense) if s.element_hash() not in known]
    field = Field(numbers)
    function = ca.Function("matrix", [ca.vertcat(ca.SX(0, 1), *free), constants], [dense])
    table = rules(
        lambda value: field.residue(constant_of(value)),
        add=operator.add,
        mul=operator.mul,
        div=operator.truediv,
    )
    drawn = np.random.default_rng(seed).integers(1, 2**59, len(free))
    values = fold(
        function,
        table,
        [field.residue(int(x)) for x in drawn],
        [field.of(number).residue for number in numbers],
    )
    columns, rows = reversed(matrix.shape)
    found = np.array([int(x) for x in values[0]], dtype=object).reshape(columns, rows).T
    return ModuloPrime(found, field.prime)
