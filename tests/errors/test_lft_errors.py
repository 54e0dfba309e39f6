"""Errors of the algebra of LFTs and of the extraction: class and message."""

import casadi as ca
import numpy as np

from mbdlft import LFT, Parameter
from mbdlft.lft import lft as algebra
from mbdlft.lft.box_gain import gain_bound
from mbdlft.lft.determinant import values_at
from mbdlft.lft.lft import add, constant, delta, eliminate, fix, inverse, multiply
from mbdlft.lft.sampling import evaluate, evaluate_at
from mbdlft.order.degree import degree_bounds
from mbdlft.order.reduction import reduce_order
from mbdlft.problem.relations import LinearModel
from mbdlft.system.truncation import truncate_lft
from tests.errors.table import refused
from tests.extracted import extracted as in_doubles
from tests.laws.test_algebra import BLOCKS, mixed

D, HALF, MIXED = delta("mass"), np.array([[0.5]]), mixed(2)


def lft(n=1, blocks=(("a", 1),), shapes=None, fill=0.0):
    shapes = {"M11": (n, n), "M12": (n, 3), "M21": (2, n), "M22": (2, 3), **(shapes or {})}
    return LFT(*(np.full(shape, fill) for shape in shapes.values()), blocks=blocks)


test_messages = refused(
    r"""
> {} => StructureError:
lft(fill=np.nan) => LFT: M11 has an entry that is not finite.
LFT([[0.0]], [[np.inf]], [[0.0]], [[0.0]], (("a", 1),)) => LFT: M12 has an entry that is not finite.
lft(shapes={"M11": (1, 2)}) => LFT: M11 needs shape (1, 1), got (1, 2).
lft(shapes={"M12": (2, 3)}) => LFT: M12 needs shape (1, 3), got (2, 3).
lft(shapes={"M21": (3, 1)}) => LFT: M21 needs shape (2, 1), got (3, 1).
lft(2) => LFT: the sizes of the blocks add up to 1, M11 is 2 x 2.
lft(blocks=()) => LFT: the sizes of the blocks add up to 0, M11 is 1 x 1.
lft(1, (("a", -1), ("b", 2))) => LFT: a block has a negative size:
lft(2, (("b", 1), ("a", 1))) => LFT: blocks must be sorted by name, each name once; got b, a.
lft(2, (("a", 1), ("a", 1))) => LFT: blocks must be sorted by name, each name once; got a, a.
add(lft(), D) => LFT: cannot add shapes (2, 3) and (1, 1).
D - np.eye(2) => LFT: cannot add shapes (1, 1) and (2, 2).
multiply(lft(), D) => LFT: cannot multiply shapes (2, 3) and (1, 1).
np.eye(2) @ D => LFT: cannot multiply shapes (2, 2) and (1, 1).
inverse(lft()) => LFT: cannot invert shape (2, 3).
algebra.stack_rows(lft(), D) => LFT: cannot stack shapes (2, 3) and (1, 1) as rows.
algebra.stack_columns(lft(), D) => LFT: cannot stack shapes
fix(D, {"mas": 0.5}) => LFT: unknown delta 'mas'. Did you mean 'mass'?
evaluate(D, {"mas": 0.5}) => LFT: unknown delta 'mas'. Did you mean 'mass'?
evaluate(constant([[1.0]]), {"m": 0.5}) => unknown delta 'm'. Existing: none.
evaluate(D @ delta("x"), {"mass": np.zeros(2), "x": np.zeros(3)})
    => evaluate: the arrays of deltas have different lengths.
evaluate_at(D, [0.5]) => LFT: points need shape (N, 1), got (1,).
evaluate_at(D, [[0.5, 0.5]]) => LFT: points need shape (N, 1), got (1, 2).
inverse(D) => WellPosednessError: the inverse of an LFT: the matrix is singular to working precision.
inverse(constant([[1.0, 1.0], [1.0, 1.0 + 2.0**-52]]))
    => WellPosednessError: the inverse of an LFT: the matrix is singular to working precision.
inverse(D @ D)
    => WellPosednessError: the inverse of an LFT: the matrix is singular to working precision.
eliminate(constant([[1.0, 2.0, 0.0], [2.0, 4.0, 1.0]]), 2)
    => WellPosednessError: the relations to be solved: the matrix is singular to working precision.
fix(inverse(D + HALF), {"mass": -0.5})
    => WellPosednessError: an LFT with fixed deltas: the matrix is singular to working precision.
evaluate(inverse(D + HALF), {"mass": [0.0, -0.5]})
    => WellPosednessError: I - M11 Delta is singular at one of the points.
evaluate(D, {"mass": np.zeros((2, 2))}) => evaluate
D + np.zeros((1, 1, 1)) => LFT
MIXED + delta("c", 2) => c is a complex block here and a real one there.
MIXED + MIXED => the full block f stands twice, and it cannot be repeated.
algebra.transpose(MIXED) => the transpose of a full block is another block: f.
evaluate(MIXED, {"a": 1j}) => a is a real delta, got 1j.
evaluate(MIXED, {"f": np.eye(2)}) => f is a full block and needs shape (2, 3), got
evaluate(MIXED, {"f": "x"}) => f: expected a number, got 'x'.
evaluate_at(MIXED, np.zeros((1, 3))) => points have one real number for each block
reduce_order(MIXED) => the reduction holds for real entries and repeated real par
degree_bounds(MIXED) => c is a complex block, f is a full block.
degree_bounds(constant([[1j]])) => parameters only; an entry is complex.
gain_bound(MIXED) => the bound of the gain holds for real entries
truncate_lft(MIXED, 0.1) => truncation holds for real entries
values_at(MIXED, np.zeros((1, 3))) => the determinant at many points holds for
LFT(MIXED.M11, MIXED.M12, MIXED.M21, MIXED.M22, BLOCKS[:2]) => LFT: M11 needs shape (6, 6), got (6, 5).
> extracted({}) => NotRationalError:
ca.exp(P) * X + Z
    => OP_EXP at instruction 1 of 'relations' is not a rational operation (parameters: ratio; acts on a
        coefficient). Declare the whole function value as a parameter, or keep the equations implicit.
ca.fmin(P, 2) * X => OP_FMIN at instruction … parameters: ratio;
ca.sqrt(2 * P) * X => OP_SQRT at instruction … parameters: ratio;
ca.sin(X) + Z => OP_SIN at instruction … (parameters: none; acts on a signal).
X * Z => two signals are multiplied, so the relations are not linear in them.
X**2 => two signals are multiplied
P / X => a signal is a divisor, so the relations are not linear in the signals.
X + P => a signal and a coefficient are added, so the relations are not linear
Z - 3 => a signal and a coefficient are added
P * P
    => StructureError: row 0 of the relations does not vanish with the signals: it is not linear in
        them. Linearize around an equilibrium first.
X / (P - 1) - Z
    => WellPosednessError: a denominator vanishes at the nominal values of the parameters, so there is
        no linear fractional form around them. Move the nominal values.
"""
)


def test_well_posed_beside_the_singular_point():
    a = inverse(D + HALF)
    evaluate(a, {"mass": [0.0, -0.4]})
    fix(a, {"mass": -0.4})


P, X, Z = ca.SX.sym("p"), ca.SX.sym("x"), ca.SX.sym("z")


def extracted(residual: ca.SX) -> LFT:
    p = Parameter("ratio", 1.0, 0.5, 2.0)
    return in_doubles(LinearModel(residual, ca.SX(0, 1), X, Z, P, (p,)))


def test_extraction_of_a_rational_relation():
    extracted((P * P - 2) / (P + 3) * X - Z)
